# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Clients in processes of their own on one topic: it is made, dropped and made anew meanwhile."""

from __future__ import annotations

import json
import time

import pytest
from std_msgs.msg import String
from suites import sparing
from topics.clients import children

from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of

SEC = 10**9


@pytest.mark.suite("all", "it starts many programs")
@pytest.mark.fault
def test_two_processes_make_a_topic_at_once(rosCas, cassandra, keyspace, cql):
    with children(2, cassandra, keyspace) as pair:
        for number in range(20):
            for name, child in zip("ab", pair):
                child.say("make", f"/t{number}", name)
            answers = [child.answer() for child in pair]
            assert not any("error" in answer for answer in answers), answers
    for number in range(20):
        tables = [
            name
            for name, comment in cql.execute(
                "SELECT table_name, comment FROM system_schema.tables WHERE keyspace_name = %s",
                (keyspace,),
            )
            if f'"topic": "/t{number}"' in comment
        ]
        assert len(tables) == 1
        topic = rosCas.getTopic(f"/t{number}")
        assert sorted(m.data for _, m in topic.items()) == ["a", "b"]
        assert topic.countTopicData() == 2


def drop_and_make(rosCas, times):
    """Drop the topic and make it again, each time with buckets of another length.

    Returns:
        When that had ended, as time.time_ns().
    """
    for number in range(times):
        time.sleep(0.3)
        rosCas.removeTopic("/t")
        if number % 2:
            time.sleep(0.2)  # the writer makes it itself
        with rosCas.messageWriter(nodeID="other") as writer:
            handle = writer.connect(
                api_connection("/t", definition_of(String), "/d"), bucket_ns=(number % 3 + 1) * SEC
            )
            writer.write(handle, 5 * SEC, number, b"\5\0\0\0other")
    return time.time_ns()


def rows_of_the_last_table(cql, keyspace):
    """Read the one table as it lies there: its name, comment, and (bucket, t, text) of the rows."""
    tables = [
        (name, json.loads(comment)["cassandra_ros"])
        for name, comment in cql.execute(
            "SELECT table_name, comment FROM system_schema.tables WHERE keyspace_name = %s",
            (keyspace,),
        )
        if comment.startswith('{"cassandra_ros"')
    ]
    assert len(tables) == 1
    ((name, comment),) = tables
    found = cql.execute(f'SELECT "_node", "_bucket", "_t", "data" FROM {keyspace}."{name}"')
    return name, comment, [tuple(row) for row in found]


@pytest.mark.suite("all", "it starts many programs")
@pytest.mark.parametrize("how", sparing(["addData", "messageWriter"], kept=["messageWriter"]))
@pytest.mark.fault
def test_a_writer_goes_on_while_its_topic_is_dropped_and_made_anew(
    rosCas, cassandra, keyspace, cql, how
):
    rosCas.addTopic("/t", msg_type="std_msgs/String")
    with children(1, cassandra, keyspace) as (child,):
        child.say("write", how, "/t")
        child.answer()
        ended = drop_and_make(rosCas, 4)
        time.sleep(0.3)
        child.say("end")
        told = child.answer()
    name, comment, rows = rows_of_the_last_table(cql, keyspace)
    assert told["failure"] == ""
    assert all(t // comment["bucket_ns"] == bucket for _, bucket, t, _ in rows)
    rosCas.catalog.keyspace.schema.tables(fresh=True)
    assert rosCas.getTopic("/t").countTopicData() == len(rows)

    stored = {int(text) for node, _, _, text in rows if node != "other"}
    assert len(stored) == sum(node != "other" for node, *_ in rows)  # nothing twice
    after = {number for number, begun, _, _, _ in told["written"] if begun > ended}
    assert len(after) >= 50
    if how == "addData":
        acknowledged = {n for n, _, _, table, error in told["written"] if table == name}
        assert acknowledged == stored
        errors = [error for *_, error in told["written"] if error]
        assert after <= stored, errors
    else:
        assert told["ours"], told["causes"]
        # What an older table had acknowledged went with it; all else went on into the next.
        assert told["stats_stored"] == len(told["written"])
        assert told["stats_lost"] == told["lost"] == 0, told["causes"]
        assert after <= stored
        assert set(range(told["flushed"], len(told["written"]))) <= stored
