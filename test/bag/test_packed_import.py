# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Imports in format packed: the same rows, byte for byte, however often and in whatever parts."""

from __future__ import annotations

import random
import signal
import time

import pytest
from bag.test_import_export import counts_agree
from bag.test_import_process import spawn_import
from bag.truth import string_connection, string_wire
from nodes.children import await_true

from cassandra_ros.files.bag import importer
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.store.blocks.block_builder import BlockLimits
from cassandra_ros.store.tables import replacement

START = 1_700_000_000 * 10**9


def jumbled_bag(path, count, seed=1):
    """Write a bag of two publishers of a topic and one of another, with late and equal times."""
    chance = random.Random(seed)
    with BagWriter(path, chunk_bytes=50_000) as writer:
        numbers = [writer.connection(string_connection("/a", callerid=c)) for c in ("/x", "/y")]
        numbers.append(writer.connection(string_connection("/b")))
        for i in range(count):
            late = chance.choice([0] * 20 + [3_000_000, 2 * 10**9, 40 * 10**9])
            size = chance.choice([10, 10, 10, 40, 400])
            if i == count // 2:
                size = 70_000
            if i == count // 3:
                size = 700_000
            t = START + i // 2 * 1_000_000 - late
            writer.write(numbers[chance.choice([0, 0, 1, 2])], t, string_wire(f"{i}" + "x" * size))
    return path


def table_rows(rosCas, cql):
    """All rows of all tables of topics as they lie there, with each column."""
    query = "SELECT table_name FROM system_schema.tables WHERE keyspace_name = %s"
    known = {name for (name,) in cql.execute(query, (rosCas.keyspace,))}
    found = {}
    for topic in rosCas.getAllTopics():
        for table in topic.tables:
            for name in (table.name, table.name + "_c"):
                if name in known:
                    rows = cql.execute(f'SELECT * FROM {rosCas.keyspace}."{name}"')
                    found[topic.name, name[len(table.name) :]] = sorted(map(repr, rows))
    return found


@pytest.fixture
def small_blocks(monkeypatch):
    monkeypatch.setattr(importer, "limits_for", lambda connections: BlockLimits(100, 20_000))


def test_a_repeated_import_ends_in_the_same_rows(rosCas, cql, tmp_path, small_blocks):
    path = jumbled_bag(tmp_path / "a.bag", 4000)
    # First a part of it, then one that is interrupted, then all.
    import_bag(rosCas, path, format="packed", topics=["/b"])
    parts = table_rows(rosCas, cql)
    seen = []

    def stop(messages, size):
        seen.append(messages)
        if sum(seen) > 1500:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_bag(rosCas, path, format="packed", progress=stop)
    assert 0 < sum(counts_agree(rosCas, cql).values()) < 4000
    report = import_bag(rosCas, path, format="packed")
    assert report.messages == 4000
    rows = table_rows(rosCas, cql)
    assert rows["/b", ""] == parts["/b", ""] and len(rows["/a", ""]) > 30
    assert verify_bag(rosCas, path).equal
    assert sum(counts_agree(rosCas, cql).values()) == 4000
    assert import_bag(rosCas, path, format="packed") == report
    assert table_rows(rosCas, cql) == rows
    assert sum(counts_agree(rosCas, cql).values()) == 4000


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
def test_an_import_that_was_killed_is_completed_by_the_next(
    rosCas, cassandra, keyspace, cql, tmp_path
):
    count = 6000
    path = jumbled_bag(tmp_path / "a.bag", count)
    for killed_at in (0.4, 0.8):
        child = spawn_import(cassandra, keyspace, path, killed_at * count, "packed")
        child.communicate(timeout=300)
        assert child.returncode == -signal.SIGKILL
    import_bag(rosCas, path, format="packed")
    assert verify_bag(rosCas, path).equal
    assert sum(counts_agree(rosCas, cql).values()) == count
    rows = table_rows(rosCas, cql)
    import_bag(rosCas, path, format="packed")
    assert table_rows(rosCas, cql) == rows


@pytest.mark.parametrize("form", ["packed", "ros"])
@pytest.mark.parametrize("whole", [True, False])
def test_what_a_deletion_of_a_server_with_a_fast_clock_hides_is_told(
    rosCas, cql, tmp_path, form, whole
):
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        number = writer.connection(string_connection("/a"))
        for i in range(20):
            writer.write(number, START + i, string_wire(str(i)))
    import_bag(rosCas, path, format=form)
    (table,) = rosCas.getTopic("/a").tables
    rows = cql.execute(f'SELECT "_node", "_bucket", "_t", "_seq" FROM {table.qualified}').all()
    row = '"_node" = %s AND "_bucket" = %s AND "_t" = %s AND "_seq" = %s'
    # As that server would: the mark in the directory, and what it deletes an hour from now.
    assert rosCas.upkeep.delete(["/a"], START, START + (19 if whole else 2))["/a"] > 2
    later = time.time_ns() // 1000 + 3600 * 10**6
    for key in rows if whole or form == "packed" else rows[:3]:
        if whole or form == "ros":
            cql.execute(f"DELETE FROM {table.qualified} USING TIMESTAMP {later} WHERE {row}", key)
        else:
            marks = f'UPDATE {table.qualified} USING TIMESTAMP {later} SET "_gone" = "_gone" + '
            cql.execute(f"{marks}{{0, 1, 2}} WHERE {row}", key)
    report = import_bag(rosCas, path)
    hidden = 20 if whole else 3
    assert rosCas.getTopic("/a").countTopicData() == 20 - hidden == report.messages
    assert report.lost == {"/a": hidden}
    assert f"{hidden} messages of topic /a" in report.warnings[0] and "clock" in report.warnings[0]
    (run,) = rosCas.runs()
    assert (run.stored, run.lost) == ({"/a": 20 - hidden}, {"/a": hidden})


def test_a_deleted_message_is_there_again_after_the_import(rosCas, cql, tmp_path):
    path = jumbled_bag(tmp_path / "a.bag", 500)
    import_bag(rosCas, path, format="packed")
    rows, topic = table_rows(rosCas, cql), rosCas.getTopic("/b")
    key = next(iter(topic.items()))[0]
    topic.removeData(key)
    assert not verify_bag(rosCas, path).equal
    import_bag(rosCas, path, format="packed")
    assert verify_bag(rosCas, path).equal
    assert table_rows(rosCas, cql) == rows
    assert sum(counts_agree(rosCas, cql).values()) == 500


@pytest.mark.suite("all", "make test asks others of its kind")
def test_an_import_into_blocks_that_a_conversion_cut_doubles_nothing(
    rosCas, cql, tmp_path, monkeypatch
):
    monkeypatch.setattr(replacement, "SETTLE_SEC", 0.05)
    monkeypatch.setattr("cassandra_ros.store.tables.schema.CACHE_SEC", 0.03)
    # What is late makes blocks begin elsewhere than in the order of time.
    path = jumbled_bag(tmp_path / "a.bag", 2000)
    with rosCas.messageWriter(format="binary") as writer:  # others keep theirs
        handle = writer.connect(string_connection("/a"))
        writer.write(handle, START, 1, string_wire("another's"))
    import_bag(rosCas, path, format="binary")
    rosCas.convertTopic("/a", "packed")
    rosCas.convertTopic("/b", "packed")
    report = import_bag(rosCas, path)
    assert {topic.format for topic in report.topics.values()} == {"packed"}
    assert verify_bag(rosCas, path).equal
    expected = {name: topic.messages for name, topic in report.topics.items()}
    expected["/a"] += 1
    assert counts_agree(rosCas, cql) == expected
    assert sum(1 for _ in rosCas.getTopic("/a").items()) == expected["/a"]


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.parametrize(
    ("form", "remade"), [("packed", False), ("packed", True), ("binary", False)]
)
def test_an_import_whose_topic_is_removed_meanwhile_is_completed_by_the_next(
    rosCas, cql, tmp_path, small_blocks, form, remade
):
    path = tmp_path / "a.bag"
    with BagWriter(path, chunk_bytes=20_000) as writer:
        number = writer.connection(string_connection("/a"))
        for i in range(3000):
            writer.write(number, START + i * 1_000_000, string_wire(f"{i:020}"))
    seen, removed = [], []

    def remove(messages, size):
        seen.append(messages)
        if sum(seen) >= 1250 and not removed:
            removed.append(sum(seen))
            # On a busy machine nothing may be stored yet, and all would go into the successor.
            await_true(lambda: len(list(rosCas.getTopic("/a").rows())) >= 500)
            rosCas.removeTopic("/a")
            if remade:
                rosCas.addTopic("/a", format=form, msg_type="std_msgs/String")

    import_bag(rosCas, path, format=form, progress=remove)
    assert 0 < sum(counts_agree(rosCas, cql).values()) < 3000
    found = sorted(int(msg.data) for _, msg in rosCas.getTopic("/a").items())
    assert found == list(range(found[0], 3000)) and found[0] <= removed[0]
    import_bag(rosCas, path, format=form)
    assert sum(counts_agree(rosCas, cql).values()) == 3000
    assert [int(msg.data) for _, msg in rosCas.getTopic("/a").items()] == list(range(3000))
    assert verify_bag(rosCas, path).equal
