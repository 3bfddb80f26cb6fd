# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag delete as it is typed: by topic, time, robot, run and condition."""

from __future__ import annotations

import json
import sys

import pytest
from cli.test_upkeep import Terminal
from std_msgs.msg import Int64
from topics.test_run_states import T0, add, begin

from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.store.connection.cql_names import quote_text
from cassandra_ros.store.tables.registry import Loss, LossKind, Run


@pytest.fixture
def store(rosCas):
    """/n and, in blocks, /p: five messages a second apart of each of two runs; and a map."""
    rosCas.addTopic("/p", format="packed", msg_type="std_msgs/Int64")
    for writer_id, name in ((7, "corridor"), (8, "yard")):
        with begin(rosCas, writer_id, name) as writer:
            add(writer, 5, "/p")
    rosCas.addTopic("/maps", key_format="manual", nodeID="husky").addData(Int64(0), key="kitchen")
    rosCas.catalog.keyspace.registry.put_loss(
        Loss("/n", "husky", 7, LossKind.BUFFER_FULL, T0, T0, 4)
    )
    return rosCas


def counts(store):
    return {topic.name: topic.countTopicData() for topic in store.getAllTopics()}


@pytest.mark.suite("test", "each way to say what is deleted")
def test_delete(store, call, type_in, monkeypatch):
    def end(n):
        return f"{T0 // SECOND_NS + n}"

    assert counts(store) == {"/maps": 1, "/n": 10, "/p": 10}
    assert call("delete")[0] == 2
    with pytest.raises(InvalidOption, match="removeTopic and truncateTopic"):
        store.upkeep.delete(["/n"])

    # By time: first a dry run, then refused without a terminal, then deleted.
    by_time = ("delete", "-e", "/[np]", "--end", end(1))
    status, out, err = call(*by_time, "--dry-run")
    assert (status, err) == (0, "")
    assert [line.split() for line in out.splitlines()[1:3]] == [["/n", "4"], ["/p", "4"]]
    assert out.endswith("8 messages of 2 topics would be deleted\n")
    assert json.loads(call(*by_time, "--dry-run", "--json")[1])["deleted"] == {"/n": 4, "/p": 4}
    status, out, err = type_in(*by_time)
    assert (status, out) == (1, "")
    assert err.startswith("cassandra_bag: ")
    assert (
        "Delete 8 messages of 2 topics? There is no terminal to ask on; confirm it with --yes"
        in err
    )
    monkeypatch.setattr(sys, "stdin", Terminal("no\n"))
    assert call(*by_time)[0] == 1
    assert counts(store) == {"/maps": 1, "/n": 10, "/p": 10}
    monkeypatch.setattr(sys, "stdin", Terminal("yes\n"))
    assert call(*by_time, "--json")[0] == 0
    assert counts(store) == {"/maps": 1, "/n": 6, "/p": 6}

    # By condition: a topic without one loses nothing, and one that is named needs one.
    status, _, err = call("delete", "/n", "/p", "--where", "/n: data = 2", "-y")
    assert (status, err.count("\n")) == (1, 1) and "no condition for topic /p" in err
    status, out, err = call("delete", "--where", "/n: data = 2", "--where", "p: data > 3", "-y")
    assert (status, err) == (0, "") and out.endswith("4 messages of 2 topics are deleted\n")
    assert counts(store) == {"/maps": 1, "/n": 4, "/p": 4}
    assert call("delete", "--where", "/n: data > 7", "--run", "yard", "-y")[1].startswith("0 mess")

    # By run: all of it, and it is not listed any more, nor what it lost.
    assert call("delete", "--run", "nobody", "-y")[0] == 1
    assert call("delete", "--run", "corridor", "/n", "-y")[0] == 0
    assert counts(store) == {"/maps": 1, "/n": 2, "/p": 4}
    assert [run.name for run in store.runs()] == ["corridor", "yard"]
    assert call("delete", "--run", "corridor", "--yes", "-q") == (0, "", "")
    assert counts(store) == {"/maps": 1, "/n": 2, "/p": 2}
    assert [run.name for run in store.runs()] == ["yard"]
    assert store.losses() == []
    with begin(store, 9, "now") as writer:
        status, _, err = call("delete", "--run", "now", "-y")
        assert (status, err.count("\n")) == (1, 1) and "run now goes on" in err
        writer.flush()
    assert counts(store)["/n"] == 7

    # By robot, whatever finds a message; then the topics themselves.
    assert call("delete", "--node-id", "nobody", "-y")[1].startswith("0 messages")
    assert call("delete", "--node-id", "husky", "/maps", "-y")[0] == 0
    assert counts(store) == {"/maps": 0, "/n": 7, "/p": 2}
    status, out, err = call("delete", "maps", "/n", "-y")
    assert (status, err) == (0, "") and out.endswith("2 topics with their 7 messages are deleted\n")
    assert counts(store) == {"/p": 2}
    status, _, err = call("delete", "/n", "-y")
    assert (status, err.count("\n")) == (1, 1)


def test_a_dry_run_of_a_run_leaves_it_listed(store, call):
    out = call("delete", "--run", "corridor", "--dry-run")[1]
    assert out.endswith("10 messages of 2 topics would be deleted\n")
    assert counts(store) == {"/maps": 1, "/n": 10, "/p": 10}
    assert [run.name for run in store.runs()] == ["corridor", "yard"]
    assert [loss.count for loss in store.losses()] == [4]


def test_the_run_of_one_robot_goes_and_that_of_the_other_stays(store, call):
    """Two robots recorded runs of one name."""
    run = Run("jackal", 9, "recording", name="corridor")
    with store.messageWriter(writer_id=9, run=run, nodeID="jackal") as writer:
        add(writer, 3)
    store.catalog.keyspace.registry.put_loss(
        Loss("/n", "jackal", 9, LossKind.BUFFER_FULL, T0, T0, 2)
    )
    command = ("delete", "--run", "corridor", "--node-id", "husky", "-y")
    assert call(*command)[1].endswith("10 messages of 2 topics are deleted\n")
    assert counts(store) == {"/maps": 1, "/n": 8, "/p": 5}
    listed = [(run.name, run.node) for run in store.runs()]
    assert sorted(listed) == [("corridor", "jackal"), ("yard", "husky")]
    assert [(loss.node, loss.count) for loss in store.losses()] == [("jackal", 2)]


@pytest.mark.parametrize("words", [["--run", ""], ["--event", ""], ["--run="], ["--event="]])
def test_an_empty_value_deletes_nothing(store, call, words):
    """A variable of a script that is not set."""
    for topic in (["/n"], []):
        status, _, err = call("delete", *topic, *words, "--yes")
        assert (status, err.startswith("cassandra_bag: ")) == (1, True)
    assert counts(store) == {"/maps": 1, "/n": 10, "/p": 10}


def test_a_topic_that_cannot_be_read_here_is_deleted(store, call, cql):
    (table,) = store.getTopic("/n").tables
    comment = quote_text(table.metadata.with_(definition="what is this").to_comment())
    cql.execute(f'ALTER TABLE {store.keyspace}."{table.name}" WITH comment = {comment}')
    assert call("info", "/n")[0] == 1
    assert call("delete", "/n", "-y")[0] == 0
    assert counts(store) == {"/maps": 1, "/p": 10}
