# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Retention: what the rules drop, and what stays, against a model in Python."""

from __future__ import annotations

import json
import re
import sys
from datetime import timedelta

import pytest
from cli.test_upkeep import Terminal
from hypothesis import given
from hypothesis import strategies as st
from std_msgs.msg import Float64, Int64
from topics.test_run_states import T0

from cassandra_ros.cli import cassandra_bag
from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.places.paths import subtract_ranges
from cassandra_ros.read import TimeRange
from cassandra_ros.store.tables.registry import Run

COUNT = 200
STEP = SECOND_NS // 2
NOW = T0 + COUNT * STEP


def write(store, topic, messages, fmt, writer_id, latching=False, bucket_sec=10, node="r"):
    """Store (time, message), by one publisher."""
    kind = type(messages[0][1])
    header = {"type": kind._type, "md5sum": kind._md5sum, "message_definition": kind._full_text}
    header.update({"latching": "1"} if latching else {})
    run = Run(node, writer_id, "recording", name=f"run{writer_id}")
    with store.messageWriter(writer_id=writer_id, run=run, nodeID=node, format=fmt) as writer:
        handle = writer.connect(live_connection(topic, header), bucket_ns=bucket_sec * SECOND_NS)
        for n, (t, msg) in enumerate(messages):
            writer.write(handle, t, n, serialize(msg))


@pytest.fixture(scope="module")
def store(keyspaces, connect):
    """/rows and, in blocks, /blocks: two a second; a battery that is low at second 40; and more."""
    with keyspaces.lend() as name, connect(keyspace=name) as store:
        yield store


@pytest.fixture
def topics(store):
    # What an earlier test dropped comes again, as by an import that is repeated.
    every = [(T0 + n * STEP, Int64(n)) for n in range(COUNT)]
    write(store, "/rows", every, "binary", 1)
    write(store, "/blocks", every, "packed", 2)
    volts = [(T0 + n * SECOND_NS, Float64(10.5 if n == 40 else 12.0)) for n in range(100)]
    write(store, "/battery", volts, "ros", 3)
    write(store, "/static", [(T0 + n, Int64(n)) for n in range(3)], "ros", 1, latching=True)
    return store


def left(store, topic):
    return [round((key.ns - T0) / SECOND_NS, 1) for key, _ in store.getTopic(topic).items()]


def seconds(first, last, step=0.5):
    return [first + n * step for n in range(int((last - first) / step) + 1)]


TIMES = st.integers(0, 40)


@given(st.lists(st.tuples(TIMES, TIMES)), TIMES, TIMES)
def test_gaps_are_all_that_is_not_pinned(pins, low, high):
    time_ranges = sorted(TimeRange(min(pin), max(pin)) for pin in pins)
    gaps = list(subtract_ranges([(low, high)], time_ranges))
    covered = [t for gap in gaps for t in range(gap.low, gap.high + 1)]
    pinned = {t for pin in time_ranges for t in range(pin.low, pin.high + 1)}
    assert covered == [t for t in range(low, high + 1) if t not in pinned]


def test_by_age_and_again(topics):
    keep = {"/battery": "data < 11"}
    options = {"max_age": 30, "keep": keep, "before": 2, "after": timedelta(seconds=3), "now": NOW}
    said = topics.upkeep.retain(**options, dry_run=True)
    assert left(topics, "/rows") == seconds(0, 99.5)
    done = topics.upkeep.retain(**options)
    assert said == done
    found = {each.topic: (each.messages, each.dropped, each.thinned, each.left) for each in done}
    wanted = seconds(38, 43) + seconds(70, 99.5)
    for topic in ("/rows", "/blocks"):
        assert left(topics, topic) == wanted
        assert found[topic] == (COUNT, COUNT - len(wanted), 0, len(wanted))
    assert left(topics, "/battery") == seconds(38, 43, 1) + seconds(70, 99, 1)
    # The last message that was latched before the kept time range stays: it is still in force.
    assert [msg.data for _, msg in topics.getTopic("/static").items()] == [2]
    assert [each.dropped for each in topics.upkeep.retain(**options)] == [0, 0, 0, 0]
    (note,) = [e for e in topics.upkeep.retain("/rows", max_age=0, now=NOW + 1) if e.dropped]
    assert (note.topic, note.left) == ("/rows", 0)
    assert left(topics, "/blocks") == wanted


def test_thinned_to_a_rate(topics):
    rules = {"thin": 0.5, "thin_after": 20, "now": NOW, "keep": {"/battery": ("data < ?", [11])}}
    topics.upkeep.retain(["/rows", "/blocks", "/static"], **rules, before=1, after=1)
    # Outside the kept time ranges the first message of each interval stays.
    old = sorted({*seconds(0, 79.5, 2), *seconds(39, 41.5)})
    for topic in ("/rows", "/blocks"):
        assert left(topics, topic) == old + seconds(80, 99.5)
    assert len(left(topics, "/static")) == 3  # each holds until the next one comes
    again = topics.upkeep.retain(["/rows", "/blocks"], **rules, before=1, after=1)
    assert [each.thinned for each in again] == [0, 0]


def test_thinning_leaves_few_tombstones(topics, cql):
    """Cassandra refuses to read a bucket with 100,000 of them."""
    both = [(T0 + n * STEP + 1, Int64(n)) for n in range(0, COUNT, 50)]
    write(
        topics, "/much", [(T0 + n * STEP, Int64(n)) for n in range(COUNT)], "binary", 6, False, 600
    )
    write(topics, "/much", both, "binary", 7, True, 600)  # its own publisher, which latches
    pinned = {"/battery": "data < 11"}
    options = {"thin": 0.05, "now": NOW, "keep": pinned, "before": 0, "after": 0}
    (said,) = topics.upkeep.retain("/much", **options, dry_run=True)
    (done,) = topics.upkeep.retain("/much", **options)
    kept = sorted({*seconds(0, 80, 20), 40.5, *(n / 2 for n in range(0, COUNT, 50))})
    assert said == done and done.left == 6 + 4
    assert sorted(set(left(topics, "/much"))) == kept
    assert topics.getTopic("/much").countTopicData() == 10
    table = topics.getTopic("/much").tables[0].qualified
    asked = cql.execute_async(f"SELECT * FROM {table}", trace=True)
    asked.result()
    told = " ".join(event.description for event in asked.get_query_trace().events)
    found = re.findall(r"Read (\d+) live rows and (\d+) tombstone", told)
    assert found and sum(int(dead) for _, dead in found) <= 50


def test_by_size(topics):
    size = len(serialize(Int64()))
    for most in (100 * size, 100 * size + size - 1):
        topics.upkeep.retain(["/rows", "/blocks"], max_bytes=most, now=NOW)
        for topic in ("/rows", "/blocks"):  # as much of both: the oldest goes first
            assert left(topics, topic) == seconds(75, 99.5)
    # Half of a bucket of each, where one of them is long.
    every = [(T0 + n * 10 * STEP, Int64(n)) for n in range(20)]
    write(topics, "/long", every, "binary", 4, bucket_sec=3600)
    write(topics, "/short", [(T0 + n * STEP, Int64(n)) for n in range(COUNT)], "packed", 5)
    topics.upkeep.retain(["/short", "/long"], max_bytes=100 * size, now=NOW)
    assert left(topics, "/short") == seconds(54.5, 99.5)
    assert left(topics, "/long") == seconds(55, 95, 5)
    topics.upkeep.retain("/rows", max_bytes=30 * size, max_age=1e6, now=NOW)
    assert left(topics, "/rows") == seconds(85, 99.5)
    topics.upkeep.retain("/rows", max_bytes=0)
    assert (left(topics, "/rows"), left(topics, "/blocks")) == ([], seconds(75, 99.5))


@pytest.mark.parametrize("fmt", ["binary", "packed"])
def test_a_bucket_that_begins_where_another_ends_counts_once(store, fmt):
    """The first and the last nanosecond of three buckets have a message each."""
    times = [T0 + n * SECOND_NS + inside for n in range(3) for inside in (0, SECOND_NS - 1)]
    messages = [(t, Int64(t)) for t in times]
    write(store, f"/ends_{fmt}", messages, fmt, 6, bucket_sec=1)
    store.upkeep.retain(f"/ends_{fmt}", max_bytes=3 * len(serialize(Int64())), now=NOW)
    assert [msg.data for _, msg in store.getTopic(f"/ends_{fmt}").items()] == times[3:]


def test_what_cannot_be_asked(store):
    store.addTopic("/maps", key_format="manual").addData(Int64(1), key="kitchen")
    with pytest.raises(InvalidOption, match="nothing says what is to be dropped"):
        store.upkeep.retain(keep={"/battery": "data < 11"})
    with pytest.raises(InvalidOption, match="kept under names"):
        store.upkeep.retain("/maps", max_age=1)
    with pytest.raises(InvalidOption, match="is not a rate"):
        store.upkeep.retain(thin=0)
    assert all(each.topic != "/maps" for each in store.upkeep.retain(max_age=1e9, now=NOW))


def test_as_it_is_typed(topics, cassandra, capsys, monkeypatch):
    def call(*words):
        place = ["--host", cassandra.host, "--port", str(cassandra.port)]
        try:
            status = cassandra_bag.main(
                ["retention", *words, *place, "--keyspace", topics.keyspace]
            )
        except SystemExit as exc:
            status = exc.code
        return (status, *capsys.readouterr())

    rule = ("-e", "/(rows|blocks)", "--max-age", "0.5m", "--now", str(NOW // SECOND_NS))
    keep = ("--keep", "/battery: data < 11", "--before", "0", "--after", "0", "--thin", "1")
    status, out, err = call(*rule, *keep, "--thin-after", "10s", "--dry-run")
    assert (status, err) == (0, "")
    assert [line.split() for line in out.splitlines()[:2]] == [
        ["topic", "messages", "dropped", "thinned", "left"],
        ["/blocks", "200", "139", "20", "41"],
    ]
    assert out.endswith("318 messages would be dropped\n")
    monkeypatch.setattr(sys, "stdin", Terminal("n\n"))
    status, out, err = call(*rule)
    assert (status, out) == (1, "") and "Drop 280 messages?" in err
    assert len(left(topics, "/rows")) == COUNT
    answer = json.loads(call(*rule, *keep, "--thin-after", "10s", "--yes", "--json")[1])
    assert answer["topics"][1] == {
        **{"topic": "/rows", "messages": 200, "dropped": 139, "thinned": 20, "left": 41},
    }
    assert left(topics, "/rows") == [40.0, *seconds(70, 89, 1), *seconds(90, 99.5)]
    assert call("--max-age", "1e9")[0] == call("--keep", "/a: b = 1")[0] == call()[0] == 2
    assert call("--max-size", "1T", "--yes", "-q") == (0, "", "")


def test_a_hit_behind_the_cutoff_keeps_what_lies_before_it(topics):
    """The battery is low at second 40, one second behind what is dropped."""
    keep = {"/battery": "data < 11"}
    topics.upkeep.retain("/rows", max_age=61, keep=keep, before=3, after=0, now=NOW)
    assert left(topics, "/rows") == seconds(37, 99.5)


def test_each_robot_is_thinned_by_itself(topics):
    """Both publish over the same connection header, one a quarter of a second after the other."""
    for node, writer, late in (("a", 11, 0), ("b", 12, STEP // 2)):
        every = [(T0 + n * STEP + late, Int64(n)) for n in range(40)]
        write(topics, "/both", every, "binary", writer, node=node)
    topics.upkeep.retain("/both", thin=0.5, now=NOW)
    for node in "ab":
        rows = topics.getTopic("/both").items(nodeID=node)
        assert [msg.data for _, msg in rows] == list(range(0, 40, 4))
