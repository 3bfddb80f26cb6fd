# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""copy, copies and verify --with at a terminal."""

from __future__ import annotations

import json

import pytest
from bag.truth import string_connection, string_wire
from copying.test_replicator import directory, facts, rows_of
from std_msgs.msg import Int64, String

from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.mcap_writer import McapWriter
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.store.tables.context_blob import NodeGraph, RunContext
from cassandra_ros.store.tables.registry import Loss, LossKind, Run

T0 = 1_500_000_000 * 10**9


@pytest.fixture
def place(cassandra, keyspaces):
    """Another keyspace of the server, as --to names it."""
    with keyspaces.lend() as name:
        yield f"{cassandra.host}:{cassandra.port}/{name}"


@pytest.fixture
def filled(rosCas):
    for n in range(5):
        rosCas.addTopic("/a").addData(String(str(n)), key=T0 + n)
    rosCas.addTopic("/b").addData(Int64(1), key=T0)
    rosCas.catalog.adder.close()
    return rosCas


def test_copies_topics_and_tells_of_each(call, filled, place):
    status, out, err = call("copy", "--to", place)
    assert (status, err) == (0, "")
    assert "/a" in out and f"6 messages copied to {place}" in out
    status, out, _ = call("copy", "/a", "--to", place, "--json")
    answer = json.loads(out)
    assert (status, answer["complete"], answer["to"]) == (0, True, place)
    assert [(t["topic"], t["messages"]) for t in answer["topics"]] == [("/a", 0)]


def test_the_books_are_shown_and_set_the_exit_status(call, filled, place):
    status, out, _ = call("copy", "--status")
    assert (status, out) == (
        1,
        "nothing was copied to another store; see 'cassandra_bag copy --help'\n",
    )
    assert call("copy", "/a", "--to", place, "-q") == (0, "", "")
    status, out, _ = call("copy", "--status", "--json")
    found = {each["topic"]: (each["copied"], each["waiting"]) for each in json.loads(out)}
    assert (status, found) == (1, {"/a": (5, 0), "/b": (0, 1)})
    assert call("copy", "--status", "/a", "-q") == (0, "", "")
    assert call("copy", "--to", place, "-q")[0] == 0
    status, out, _ = call("copy", "--status")
    assert status == 0
    assert place in out


@pytest.mark.parametrize(
    "words",
    [["--to", "home"], ["--start", "5"], ["--rate", "2M"], ["--with-deletions"]],
    ids=" ".join,
)
def test_status_goes_without_what_says_how_to_copy(call, words):
    status, _, err = call("copy", "--status", *words)
    assert (status, f"{words[0]} says how to copy" in err) == (2, True)


def test_stores_are_compared(call, filled, place, connect):
    status, out, _ = call("verify", "--with", place)
    assert status == 1
    assert out.count("different: ") == 2
    status, out, _ = call("verify", "--with", place, "--repair")
    assert (status, out) == (
        0,
        f"equal: keyspace {filled.keyspace} and {place}, 6 messages in 2 buckets\n",
    )
    with connect(keyspace=place.rpartition("/")[2]) as home:
        home.getTopic("/a").removeData(T0, T0 + 1)
    status, out, _ = call("verify", "--with", place, "--json")
    answer = json.loads(out)
    assert (status, answer["equal"]) == (1, False)
    assert [each["here"]["messages"] for each in answer["differences"]] == [5]


def test_a_refused_topic_is_told_and_the_others_are_copied(call, filled, place, connect):
    with connect(keyspace=place.rpartition("/")[2]) as home:
        home.addTopic("/b", msg_type="std_msgs/String")
    status, out, _ = call("copy", "--to", place)
    assert status == 1
    assert "refused: topic /b is not copied: it has type std_msgs/Int64" in out
    assert "5 messages copied" in out


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["copy"], "--to HOST[:PORT][/KEYSPACE]"),
        (["copy", "--to", "a:b:c"], "is not the place of a store"),
        (["copy", "--to", "a:99999"], "is not a port"),
        (["verify"], "give FILE.bag, or --with another store"),
        (["verify", "x.bag", "--repair"], "--repair goes with --with"),
        (["verify", "--with", "127.0.0.1", "--content"], "--content goes with FILE.bag"),
    ],
)
def test_wrong_usage_is_told(call, words, text):
    status, _, err = call(*words)
    assert status
    assert text in err


def test_a_store_is_not_copied_into_itself(call, filled, cassandra):
    place = f"{cassandra.host}:{cassandra.port}"
    status, _, err = call("copy", "--to", place)
    assert status == 1
    assert "is the store itself" in err


def test_retention_deletes_what_is_copied(call, filled, place):
    assert call("copy", "/a", "--to", place, "-q")[0] == 0
    words = ("retention", "--max-size", "9", "--copied", "only", "-y", "--json")
    status, out, _ = call(*words, "--dry-run")
    topics = {each["topic"]: each["dropped"] for each in json.loads(out)["topics"]}
    assert (status, topics) == (0, {"/a": 5, "/b": 0})
    assert call(*words)[0] == 0
    assert filled.getTopic("/a").countTopicData() == 0
    assert filled.getTopic("/b").countTopicData() == 1
    status, _, err = call("retention", "--max-age", "1d", "--copied", "only")
    assert (status, "--copied goes with --max-size" in err) == (2, True)


def test_rules_are_taken_from_a_file(call, filled, place, tmp_path):
    rules = tmp_path / "rules.yaml"
    rules.write_text("topics: [{pattern: /a}, {pattern: /never}]")
    status, out, err = call("copy", "--to", place, "--rules", rules)
    assert status == 0
    assert "5 messages copied" in out
    assert "no topic matches '/never'" in err
    status, _, err = call("copy", "--to", place, "--rules", tmp_path / "none.yaml")
    assert (status, "cannot be read" in err) == (1, True)


def fill(store, tmp_path):
    """Store something of everything that a store keeps."""
    path = tmp_path / "drive.mcap"
    with McapWriter(path) as writer:
        number = writer.connection(string_connection("/chatter", callerid="/talker"))
        for n in range(20):
            writer.write(number, T0 + n, string_wire(f"{n}"), delay_ns=-n, sequence=n)
    for node in ("husky", "jackal"):
        import_bag(store, path, nodeID=node)
    run = Run("husky", 77, "recording", name="patrol", labels={"site": "lab"})
    with store.messageWriter(writer_id=77, nodeID="husky", run=run) as writer:
        handle = writer.connect(string_connection("/live", callerid="/node", latching="1"))
        writer.write(handle, T0, 0, string_wire("live"))
    registry = store.catalog.keyspace.registry
    registry.put_context(77, "husky", RunContext({"a": 1}, NodeGraph({}, {}, {}, {})))
    registry.put_loss(Loss("/live", "husky", 77, LossKind.BUFFER_FULL, T0, T0 + 5, 3))
    registry.put_loss(Loss("/never", "husky", 77, LossKind.UNHEARD, T0, T0, 0))
    for name in FORMAT_NAMES:
        topic = store.addTopic(f"/{name}", name, msg_type="std_msgs/Int64", comment="mine")
        topic.addData(Int64(5), key=T0)
    manual = store.addTopic("/map", key_format="manual", msg_type="std_msgs/String")
    manual.addData(String("old"), key="hall")
    manual.addData(String("new"), key="hall")
    store.addTopic("/ttl", msg_type="std_msgs/Int64", ttl=10**7).addData(Int64(1), key=T0)
    store.addTopic("/silent", msg_type="std_msgs/Int64")
    store.getTopic("/ros").createIndex("data")
    store.getTopic("/ros").setMeta(place="roof")
    store.renameTopic("/live", "/renamed")
    event = store.addEvent("bump", T0, T0 + 5, nodeID="husky", run="patrol", labels={"at": "door"})
    store.addEvent("brake", T0, values={"v": 1.5})
    assert event.writer == 77
    store.catalog.adder.close()


def all_of(store, cql):
    """All that a store keeps, but the names of its tables."""
    registry = store.catalog.keyspace.registry
    topics = store.catalog.all(None)
    names = {t.name: (t.metadata.topic, t.metadata.format) for t in store.catalog.tables(None)}
    sent = cql.execute(f"SELECT writer, node, stripe, sent FROM {store.keyspace}.cr_sent")
    return {
        "rows": {topic: rows for topic, rows in rows_of(cql, store).items() if topic[0] != "/ttl"},
        "facts": sorted(facts(store)),
        "directory": directory(store),
        "headers": sorted((names[t], conn, row) for t, conn, row in registry.headers(names)),
        "runs": sorted(store.runs(), key=lambda run: run.writer),
        "contexts": [store.runContext("patrol")],
        "losses": store.losses(),
        "events": list(store.events()),
        # The date is that of the table.
        "topics": [(t.name, {**t.getMeta, "date": ""}) for t in topics],
        "indexes": [t.name for t in topics if t.hasIndex("data")],
        "sent": sorted(map(tuple, sent)),
    }


@pytest.mark.suite("test", "the promise of doc/operations.md: one way of backup keeps all")
def test_what_was_copied_and_wiped_comes_back_equal(
    call, rosCas, connect, keyspaces, cassandra, cql, tmp_path
):
    fill(rosCas, tmp_path)
    before, name = all_of(rosCas, cql), rosCas.keyspace
    here = f"{cassandra.host}:{cassandra.port}"
    with keyspaces.lend() as kept:
        assert call("copy", "--to", f"{here}/{kept}", "-q") == (0, "", "")
        assert call("verify", "--with", f"{here}/{kept}", "-q") == (0, "", "")
        cql.execute(f"DROP KEYSPACE {name}")
        assert call("copy", "--to", f"{here}/{name}", "-q", keyspace=kept)[0] == 0
        with connect(keyspace=name) as restored:
            after = all_of(restored, cql)
    for what, value in before.items():
        assert after[what] == value, what
