# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Who wants one row asks for one row: requests and rows are counted, and the answers compared."""

from __future__ import annotations

from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace

import pytest
from cassandra.cluster import ResponseFuture
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from std_msgs.msg import String, UInt32
from suites import search

from cassandra_ros.keys import Position
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.rows import reader, row_stream
from cassandra_ros.store.tables import directory as listing

SEC = 10**9
SLOT = 4096 * SEC
T0 = 390_625 * SLOT  # a slot begins, of buckets of a second


def is_about(future, keyspace):
    """Say whether a request reads a topic of a keyspace or its directory.

    Others ask in this process, too; and the list of tables is read again when it is 2 s old.
    """
    query = getattr(future.query, "prepared_statement", future.query)
    return f"{keyspace}." in (getattr(query, "query_string", None) or "")


def keyspace_of(topic):
    """Return the keyspace of a topic.

    It may be asked of the server, which the driver's own thread must not do: no answer would come.
    """
    return topic.tables[0].qualified.partition(".")[0]


@contextmanager
def metered(monkeypatch, topic):
    """Count the answers of the server that are about a topic, and their rows."""
    told, keyspace = SimpleNamespace(requests=0, rows=0), keyspace_of(topic)
    original = ResponseFuture._set_final_result

    def final(future, answer):
        if is_about(future, keyspace):
            told.requests += 1
            told.rows += len(answer) if isinstance(answer, list) else 0
        return original(future, answer)

    with monkeypatch.context() as patch:
        patch.setattr(ResponseFuture, "_set_final_result", final)
        yield told


def asked(monkeypatch, topic, ask):
    """Return what is found, and what it took."""
    with metered(monkeypatch, topic) as told:
        found = ask()
    return found, told


def write(rosCas, entries):
    """Write (t, node, whether of the second definition); return them with their positions."""
    kinds = [definition_of(UInt32), definition_of(String)]
    found = []
    for writer_id, node in enumerate(sorted({node for _, node, _ in entries}), 2):
        with rosCas.messageWriter(writer_id=writer_id, nodeID=node) as writer:
            handles = {
                second: writer.connect(api_connection("/a", kinds[second], "/x"), bucket_ns=SEC)
                for second in sorted({second for _, of, second in entries if of == node})
            }
            for n, (t, of, second) in enumerate(entries):
                if of == node:
                    msg = String(data=str(n)) if second else UInt32(data=n)
                    handle = handles[second]
                    seq = writer.write(handle, t, n, serialize(msg)).seq
                    found.append((Position(t, node, seq, handle.table.name), n))
    return sorted(found)


@pytest.fixture(scope="module")
def long(fresh):
    """A message in one of 100 seconds, over ten slots of the directory; by two nodes at the end."""
    with fresh() as rosCas:
        entries = [(T0 + n * 100 * SEC + n, "", 0) for n in range(410)]
        entries += [(T0 + n * 100 * SEC, "r1", 0) for n in range(400, 411)]
        yield rosCas.getTopic("/a") if write(rosCas, entries) else None


@pytest.mark.parametrize(
    ("ask", "wanted", "requests", "rows"),
    [
        (lambda a: [a.first().ns], [0], 3, 24),
        (lambda a: [a.last().ns], [410 * 100 * SEC], 4, 40),
        (lambda a: [k.ns for k, _ in a.items(limit=3)], [n * 100 * SEC + n for n in range(3)],
         5, 30),
        (lambda a: [k.ns for k, _ in a.items(reverse=True, limit=1)], [410 * 100 * SEC], 4, 40),
        (lambda a: [a.getRow(T0 + 15_000 * SEC, nearest="after").t], [150 * 100 * SEC + 150],
         4, 24),
        (lambda a: [a.getRow(T0 + 15_000 * SEC, nearest="before").t], [149 * 100 * SEC + 149],
         6, 24),
        (lambda a: [a.getRow(T0 + 15_000 * SEC, nearest="either").t], [150 * 100 * SEC + 150],
         9, 48),
    ],
)  # fmt: skip
def test_one_of_many_buckets_costs_little(long, monkeypatch, ask, wanted, requests, rows):
    ask(long)
    found, told = asked(monkeypatch, long, lambda: ask(long))
    assert [t - T0 * (t > T0 - 1) for t in found] == wanted
    assert 0 < told.requests <= requests
    assert told.rows <= rows


def test_what_was_stored_meanwhile_before_the_first_slot_hides_nothing(rosCas):
    write(rosCas, [(T0 + n * SEC, "", 0) for n in range(20)])
    topic = rosCas.getTopic("/a")
    assert topic.first().ns == T0  # where the topic begins is remembered
    write(rosCas, [(T0 - SLOT, "", 0)])
    wanted = [T0 - SLOT, *(T0 + n * SEC for n in range(20))]
    assert [key.ns for key, _ in topic.items(limit=30)] == wanted


@contextmanager
def counted_before_an_answer(monkeypatch, topic):
    """Count the requests about a topic that are sent before the first answer is waited for."""
    told, keyspace = SimpleNamespace(sent=0, waited=False), keyspace_of(topic)
    send, result = ResponseFuture.send_request, ResponseFuture.result

    def sending(future, *args, **kwargs):
        told.sent += not told.waited and is_about(future, keyspace)
        return send(future, *args, **kwargs)

    def waiting(future):
        told.waited |= is_about(future, keyspace)
        return result(future)

    with monkeypatch.context() as patch:
        patch.setattr(ResponseFuture, "send_request", sending)
        patch.setattr(ResponseFuture, "result", waiting)
        yield told


READS = [
    lambda topic, select: [row.t for row in topic.rows(limit=4)],
    lambda topic, select: [row.t for row in topic.rows(limit=4, reverse=True)],
    lambda topic, select: [k.ns for (k,) in select("select KEY from a limit 4")],
    lambda topic, select: [k.ns for (k,) in select("select KEY from a order by KEY desc limit 4")],
]


@pytest.mark.parametrize("format_name", ["ros", "packed"])
def test_rows_are_asked_for_beside_the_directory_and_it_has_the_last_word(
    rosCas, monkeypatch, format_name
):
    kind = api_connection("/a", definition_of(UInt32), "/x")

    def add(times, node="", writer_id=2):
        with rosCas.messageWriter(writer_id=writer_id, nodeID=node, format=format_name) as writer:
            handle = writer.connect(kind, bucket_ns=SEC)
            for n, t in enumerate(times):
                writer.write(handle, T0 + t, writer_id << 16 | n, serialize(UInt32(data=n)))

    def check(*wanted):
        every = [T0 + t for t in sorted(wanted)]
        for ask, ordered in zip(READS, (every, every[::-1]) * 2):
            assert ask(topic, rosCas.executeCQL) == ordered[:4]

    add(range(0, 10))
    topic = rosCas.getTopic("/a")
    check(*range(10))
    for ask in READS:  # nodes, buckets, and the rows (of blocks their headers besides)
        with counted_before_an_answer(monkeypatch, topic) as told:
            ask(topic, rosCas.executeCQL)
        assert told.sent == 3 + (format_name == "packed")
    add([-SEC, 5 * SEC], writer_id=3)  # buckets before and behind the ones that are expected
    check(-SEC, *range(10), 5 * SEC)
    add([-SEC + 1, -SEC + 2], node="r1", writer_id=4)  # another node in an expected one
    check(-SEC, -SEC + 1, -SEC + 2, *range(10), 5 * SEC)
    topic.removeData(T0 - SEC, T0 + 3)
    check(*range(4, 10), 5 * SEC)
    assert [row.t - T0 for row in topic.rows(T0 + 7, T0 + 2 * SEC, limit=4)] == [7, 8, 9]
    rosCas.truncateTopic("/a")
    assert [ask(topic, rosCas.executeCQL) for ask in READS] == [[]] * 4
    add([2, 1])
    check(1, 2)


def test_of_a_full_bucket_a_row_is_read(rosCas, monkeypatch):
    write(rosCas, [(T0 + n, "", 0) for n in range(3000)])
    topic = rosCas.getTopic("/a")
    select = rosCas.executeCQL
    asks = {
        lambda: topic.first().ns: 10,
        lambda: topic.last().ns: 10,
        lambda: topic.getRow(T0 + 1500, nearest="either").t: 20,
        lambda: len(list(topic.items(limit=10))): 20,
        lambda: len(select("select * from a limit 10")): 20,
        lambda: len(select("select KEY from a order by KEY desc limit 1")): 10,
        lambda: len(select("select KEY from a where NODE != 'x' limit 10")): 20,
    }
    for ask, rows in asks.items():
        ask()
        with metered(monkeypatch, topic) as told:
            assert ask() in (10, 1, T0, T0 + 2999, T0 + 1500)
        assert 0 < told.requests <= 7
        assert told.rows <= rows


def test_pages_grow_where_more_is_taken(rosCas, monkeypatch):
    write(rosCas, [(T0 + n, "", 0) for n in range(2000)])
    topic = rosCas.getTopic("/a")
    list(topic.rows(wanted=1))
    with metered(monkeypatch, topic) as told:
        assert [row.t - T0 for row in topic.rows(wanted=1)] == list(range(2000))
    assert 0 < told.requests < 12
    statement = "select KEY from a where NODE like 'x%' limit 1"
    assert rosCas.executeCQL(statement) == []


def test_what_matches_in_numbers_is_not_fetched_by_its_keys(rosCas, monkeypatch):
    with rosCas.messageWriter(writer_id=2, format="ros") as writer:
        kind = api_connection("/a", definition_of(UInt32), "/x")
        handle = writer.connect(kind, bucket_ns=SEC, format="ros")
        for n in range(3000):
            writer.write(handle, T0 + n * SEC // 1000, n, serialize(UInt32(data=n % 1000)))
    topic = rosCas.getTopic("/a")
    for least in (0, 500, 900, 999):
        for what in ("KEY, data", "*", "count(*)"):
            statement = f"select {what} from a where data >= {least}"
            rosCas.executeCQL(statement)
            ask = partial(rosCas.executeCQL, statement)
            found, told = asked(monkeypatch, topic, ask)
            assert (found[0][0] if what == "count(*)" else len(found)) == 3 * (1000 - least)
            assert 0 < told.requests <= 12
            # Each row once, and once the keys of the buckets that were begun before the first had
            # been read: on a busy machine all three.
            assert told.rows <= 6 * (1000 - least) + 20
    # Also where a page holds few of a bucket's rows: its share counts, not its size.
    monkeypatch.setattr(reader, "PAGE_BYTES", 150 * 68)
    monkeypatch.setattr(row_stream, "KEYED_SHARE", 0.4)
    ask = partial(rosCas.executeCQL, "select KEY from a where data >= 0")
    found, told = asked(monkeypatch, topic, ask)
    assert len(found) == 3000
    assert told.rows <= 4200


ENTRIES = st.lists(
    st.tuples(
        st.one_of(st.integers(0, 40), st.sampled_from([4094, 4095, 4096, 12_000])),
        st.sampled_from(["", "r1", "r2"]),
        st.booleans(),
    ),
    min_size=1,
    max_size=40,
)


@pytest.mark.suite("all", "a search; make test asks some of its cases")
@search(40, suppress_health_check=list(HealthCheck))
@given(data=st.data(), entries=ENTRIES, unit=st.sampled_from([SEC, SEC // 4]))
def test_small_reads_give_what_a_plain_list_gives(fresh, data, entries, unit):
    with pytest.MonkeyPatch.context() as patch, fresh() as rosCas:
        for module, name, values in (
            (listing, "FEW_BUCKETS", (1, 2, 8)), (listing, "FEW_SLOTS", (1, 2, 64)),
            (reader, "PAGE_BYTES", (100, 10**6)), (reader, "FILTERED_BUCKETS_AHEAD", (1, 16)),
        ):  # fmt: skip
            patch.setattr(module, name, data.draw(st.sampled_from(values), name))
        entries = [(T0 + t * unit, node, second) for t, node, second in entries]
        every = write(rosCas, entries)
        topic = rosCas.getTopic("/a")
        for low, high in data.draw(st.lists(st.tuples(*[st.integers(0, 50)] * 2), max_size=2)):
            low, high = T0 + low * unit, T0 + high * unit
            topic.removeData(low, high)
            every = [entry for entry in every if not low <= entry[0].t <= high]
        if data.draw(st.booleans(), "settled"):
            rosCas.info()
        _compare(data, topic, [position for position, _ in every], unit)


def _compare(data, topic, every, unit):
    """Compare every small read with a list of the positions that are there."""
    node = data.draw(st.sampled_from([None, "", "r1"]), "node")
    mine = [p for p in every if node in (None, p.node)]
    writer = data.draw(st.sampled_from([None, 2, 3]), "run")
    mine = [p for p in mine if writer is None or p.seq >> 32 == writer]
    whose = {"nodeID": node, "run": None if writer is None else frozenset([writer])}
    limit = data.draw(st.integers(0, 12), "limit")
    for reverse in (False, True):
        wanted = mine[::-1] if reverse else mine
        found = [r.position for r in topic.rows(limit=limit, reverse=reverse, **whose)]
        assert found == wanted[:limit]
        found = [r.position for r in topic.rows(wanted=limit, reverse=reverse, **whose)]
        assert found == wanted
        end = topic.last(**whose) if reverse else topic.first(**whose)
        assert (end and (end.ns, end.node, end.seq)) == (wanted[0][:3] if wanted else None)
        for after in wanted[:: max(1, len(wanted) // 3)]:
            found = topic.rows(limit=2, after=after, reverse=reverse, **whose)
            rest = wanted[wanted.index(after) + 1 :]
            assert [r.position for r in found] == rest[:2]
    for t in data.draw(st.lists(st.integers(0, 4100), min_size=1, max_size=4), "near"):
        t = T0 + t * unit + data.draw(st.integers(-1, 1))
        before = [p.t for p in mine if p.t <= t][-1:]
        after = [p.t for p in mine if p.t >= t][:1]
        either = sorted(before + after, key=lambda near: (abs(near - t), near))[:1]
        for how, times in (("before", before), ("after", after), ("either", either)):
            row = topic.getRow(t, nearest=how, **whose)
            wanted = [p for p in mine if [p.t] == times][:1]
            assert ([] if row is None else [row.position]) == wanted


@pytest.mark.parametrize("wanted", [1, None])
@pytest.mark.parametrize("reverse", [False, True])
def test_a_stretch_that_ends_slots_before_it_begins_is_empty(long, wanted, reverse):
    ends = T0 + 9 * SLOT, T0
    assert list(long.rows(*ends, wanted=wanted, reverse=reverse)) == []
    behind = Position(T0 - SLOT if reverse else T0 + 20 * SLOT, "", 0, long.tables[0].name)
    between = long.rows(T0, T0 + SLOT, wanted=wanted, reverse=reverse, after=behind)
    assert list(between) == []
    assert list(long.items(*ends, reverse=reverse)) == []
