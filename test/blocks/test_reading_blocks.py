# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Whatever blocks are stored, they read as the plain sorted list of their messages."""

from __future__ import annotations

import itertools

import pytest
from blocks.stored_blocks import MS, T0, list_blocks, make_table, put_block
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from suites import examples

from cassandra_ros.keys import Position, writer_of
from cassandra_ros.read import Read, TimeRange, Whose
from cassandra_ros.store.blocks import block_stream as streams
from cassandra_ros.store.blocks.block_stream import BucketRead, WaitingRows, stream
from cassandra_ros.store.rows import reader
from cassandra_ros.store.rows.fetch import RowKey, fetch_rows, first_at
from cassandra_ros.store.rows.layouts import layout_of
from cassandra_ros.store.rows.reader import read_rows
from cassandra_ros.store.tables import directory as listing
from cassandra_ros.topics.removal import delete_rows, delete_time_range
from cassandra_ros.topics.row_finder import Finder
from cassandra_ros.topics.stored_totals import count_rows

RUNS = itertools.count()
WRITERS = (1, 7)
LAST_MS = 260
"""The messages lie in three buckets of 100 ms."""
BUCKET_MS, SPAN_MS = 100, 20
EVERY = (0, T0 + 10**12)


@pytest.fixture(scope="module")
def stored(fresh):
    """A store and two tables with blocks of 20 ms at most, in buckets of 100."""
    with fresh() as rosCas:
        made = [make_table(rosCas, topic) for topic in ("/p", "/q")]
        yield rosCas, [table for table, _ in made], made[0][1]


@st.composite
def feeds(draw):
    """What each connection of each writer sends: table, node, writer, and its blocks.

    A block is a list of (ms, size): begins anywhere, and ends where the bucket or the span does.
    """
    found = []
    sources = st.tuples(st.integers(0, 1), st.sampled_from("ab"), st.sampled_from(WRITERS))
    for table, node, writer in draw(st.lists(sources, min_size=1, max_size=4)):
        begins = draw(st.lists(st.integers(0, LAST_MS), min_size=1, max_size=5))
        blocks = []
        for begin in begins:
            most = min(SPAN_MS, BUCKET_MS - 1 - begin % BUCKET_MS)
            message = st.tuples(st.integers(0, most), st.integers(0, 3))
            blocks.append([(begin + ms, n) for ms, n in draw(st.lists(message, max_size=24))])
            blocks[-1].append((begin, 2))
        found.append((table, node, writer, blocks))
    return found


class Model:
    """The messages of one example, stored under nodeIDs of its own."""

    def __init__(self, stored, found):
        self.rosCas, self.tables, conn = stored
        number = next(RUNS)
        counters = dict.fromkeys(WRITERS, 0)
        self.messages = {}
        self.nodes = [f"{number}a", f"{number}b"]
        listed = {}
        for place, node, writer, blocks in found:
            table, node = self.tables[place], f"{number}{node}"
            for block in blocks:
                made = []
                for ms, size in block:
                    counters[writer] += 1
                    seq = writer << 32 | counters[writer]
                    made.append((T0 + ms * MS, seq, bytes([counters[writer] % 256]) * size))
                made.sort()
                put_block(self.rosCas, table, node, conn, made)
                listed.setdefault((table.name, node), (table, []))[1].append(made)
                for t, seq, wire in made:
                    self.messages[Position(t, node, seq, table.name)] = wire
        for (_, node), (table, blocks) in listed.items():
            list_blocks(self.rosCas, table, node, blocks)
        self.whose = Whose(tuple(self.nodes))
        self.finder = Finder(self.rosCas.catalog.keyspace, "/p", "time", self.tables, self.whose)

    def inside(self, low, high, after=None, writers=None, reverse=False):
        every = sorted(self.messages, reverse=reverse)
        return [
            p
            for p in every
            if low <= p.t <= high
            and (writers is None or writer_of(p.seq) in writers)
            and (after is None or (p < after if reverse else p > after))
        ]

    def read(self, low, high, after=None, writers=None, reverse=False, columns=None, few=None):
        read = Read(
            TimeRange(low, high),
            Whose(self.nodes, writers),
            after=after,
            reverse=reverse,
            columns=columns,
            wanted=few,
        )
        return list(read_rows(self.rosCas.catalog.keyspace.directory, self.tables, read))

    def count(self, low, high, writers=None):
        read = Read(TimeRange(low, high), Whose(tuple(self.nodes), writers))
        return count_rows(self.rosCas.catalog.keyspace.directory, self.tables, read)

    def forget(self, positions):
        for position in positions:
            del self.messages[position]


def check(model, rand):
    times = [p.t for p in model.messages] or [T0]
    edges = [rand.choice(times) + rand.choice((-1, 0, 1)) for _ in range(4)]
    low, high = min(edges), max(edges)
    after = rand.choice([None, *model.messages])
    writers = rand.choice([None, frozenset([7]), frozenset(WRITERS)])
    for reverse in (False, True):
        for asked in (EVERY, (low, high, after, writers), (low, high), (*EVERY, after)):
            wanted = model.inside(*asked, *[None] * (4 - len(asked)), reverse)
            few = rand.choice((None, 1, 5))  # who takes more than he said is given all the same
            rows = model.read(*asked, *[None] * (4 - len(asked)), reverse, few=few)
            assert [row.position for row in rows] == wanted
            assert [row.columns[0] for row in rows] == [model.messages[p] for p in wanted]
        bare = model.read(low, high, None, None, reverse, lambda table: ())
        assert [(r.position, r.columns) for r in bare] == [
            (p, ()) for p in model.inside(low, high, reverse=reverse)
        ]
    check_single(model, rand, edges)
    assert model.count(*EVERY, writers) == len(model.inside(*EVERY, None, writers))
    assert model.count(low, high, writers) == len(model.inside(low, high, None, writers))


def check_single(model, rand, edges):
    by_name = {table.name: table for table in model.tables}
    some = [rand.choice(list(model.messages)) for _ in range(6 if model.messages else 0)]
    rows = fetch_rows([RowKey(by_name[p.table], p) for p in some])
    assert [(r.position, r.columns[0]) for r in rows] == [(p, model.messages[p]) for p in some]
    for p in some:
        absent = p._replace(seq=p.seq + 2**20)
        assert not list(fetch_rows([RowKey(by_name[p.table], absent)]))
    every = sorted(model.messages)
    for t in edges:
        at = first_at(model.rosCas.catalog.keyspace.directory, model.tables, t, model.nodes)
        assert (at and at.position) == next((p for p in every if p.t == t), None)
        before = max((p.t for p in every if p.t <= t), default=None)
        after = min((p.t for p in every if p.t >= t), default=None)
        near = min(
            [n for n in (before, after) if n is not None], key=lambda n: abs(n - t), default=0
        )
        for kind, wanted in (("before", before), ("after", after)):
            found = model.finder.find(t, kind)
            first = next((p for p in every if p.t == wanted), None)
            assert (found and found.position) == first
        found = model.finder.find(t, "either")
        assert found is None if not every else abs(found.t - t) == abs(near - t)


def check_streams(model, rand):
    """The streams of single buckets, asked for few messages."""
    for p in [rand.choice(list(model.messages)) for _ in range(2 if model.messages else 0)]:
        table = next(table for table in model.tables if table.name == p.table)
        bucket = table.bucket_of(p.t)
        mine = sorted(
            (q.t, q.seq)
            for q in model.messages
            if (q.node, q.table, table.bucket_of(q.t)) == (p.node, p.table, bucket)
        )
        for reverse in (False, True):
            ends = ((p.t, p.seq), (2**62, 0)) if not reverse else ((0, 0), (p.t, p.seq))
            wanted = [each for each in mine if ends[0] <= each <= ends[1]]
            asked = BucketRead(table, p.node, bucket, ends, reverse, wanted=rand.choice((1, 5)))
            rows = stream(asked)
            assert [(r.t, r.seq) for r in rows] == (wanted[::-1] if reverse else wanted)


def settle_counts(model):
    """What is counted block by block agrees with the messages, bucket by bucket."""
    for table in model.tables:
        for node in model.nodes:
            for bucket in {table.bucket_of(p.t) for p in model.messages}:
                mine = [
                    p
                    for p in model.messages
                    if (p.table, p.node, table.bucket_of(p.t)) == (table.name, node, bucket)
                ]
                counted = layout_of(table).recount(node, bucket)
                for writer, totals in counted.items():
                    own = [p for p in mine if writer_of(p.seq) == writer]
                    assert totals.rows == len(own)
                    assert totals.bytes == sum(len(model.messages[p]) for p in own)
                    assert (totals.t_min, totals.t_max) == (
                        min(p.t for p in own),
                        max(p.t for p in own),
                    )
                assert sum(totals.rows for totals in counted.values()) == len(mine)


# An example takes a tenth of a second: to make a failing one smaller would take minutes.
@pytest.mark.suite("all", "a search over random reads")
@settings(max_examples=examples(40), phases=[Phase.explicit, Phase.generate])
@given(feeds(), st.randoms(use_true_random=False))
def test_blocks_read_as_a_sorted_list(stored, found, rand):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reader, "PAGE_BYTES", rand.choice((1, 40, 10**6)))
        patch.setattr(streams, "BLOCK_BYTES", rand.choice((1, 20, 2**18)))
        patch.setattr(streams, "FIRST_HEADERS", rand.choice((1, 2, 64)))
        patch.setattr(streams, "KEYED_BLOCKS_AT_ONCE", rand.choice((1, 3, 100)))
        patch.setattr(streams, "MIN_BLOCK_ROWS", rand.choice((1, 8)))
        patch.setattr(listing, "FEW_BUCKETS", rand.choice((1, 2, 8)))
        patch.setattr(listing, "FEW_SLOTS", rand.choice((1, 2, 64)))
        model = Model(stored, found)
        check(model, rand)
        check_streams(model, rand)
        delete(model, rand)
        check(model, rand)
        check_streams(model, rand)
        settle_counts(model)


def delete(model, rand):
    """Delete a stretch, a stretch of one writer, single messages, and whole blocks one by one."""
    low, high = sorted(T0 + rand.randrange(LAST_MS + 30) * MS for _ in range(2))
    for writers in (frozenset([rand.choice(WRITERS)]), None):
        gone = model.inside(low, high, None, writers)
        whose = Whose(tuple(model.nodes), writers)
        count = delete_time_range(
            model.rosCas.catalog.keyspace, model.tables, Read(TimeRange(low, high), whose)
        )
        assert count == len(gone)
        model.forget(gone)
        low, high = high, high + rand.randrange(40) * MS
    share = rand.choice((0.1, 0.5, 1))
    gone = [p for p in sorted(model.messages) if rand.random() < share and p.t > T0 + 50 * MS]
    rows = model.rosCas.catalog.keyspace.rows.read(
        model.tables, Read(TimeRange(*EVERY), model.whose)
    )
    assert delete_rows(
        model.rosCas.catalog.keyspace, (r for r in rows if r.position in set(gone))
    ) == len(gone)
    model.forget(gone)


@pytest.fixture(scope="module")
def crowded(fresh):
    """Twenty connections of a writer, whose blocks overlap."""
    with fresh() as rosCas:
        table, conn = make_table(rosCas)
        blocks = []
        for n in range(20):
            times = [T0 + n, T0 + 10 * MS + n]
            if n in (0, 19):
                times[1:1] = range(T0 + 10 * MS - 50 + n % 2, T0 + 10 * MS, 2)
            seqs = range(1 << 32 | n * 100, 1 << 32 | n * 100 + 99)
            blocks.append([(t, seq, bytes([n])) for t, seq in zip(times, seqs)])
            put_block(rosCas, table, "", conn, blocks[-1])
        list_blocks(rosCas, table, "", blocks)
        yield table, sorted(message for block in blocks for message in block)


@pytest.mark.parametrize("low", [T0, T0 + 20, T0 + 10 * MS - 60, T0 + 10 * MS - 20])
def test_what_is_left_of_a_block_waits_for_those_whose_headers_are_not_read(crowded, low):
    table, every = crowded
    for wanted in (1, 3, 40):
        ends = (low, 0), (2**62, 0)
        rows = stream(BucketRead(table, "", table.bucket_of(T0), ends, wanted=wanted))
        assert [(r.t, r.seq) for r in rows] == [m[:2] for m in every if m[0] >= low]


@pytest.mark.parametrize("wanted", [0, 1, 3, 40])
def test_blocks_that_overlap_are_read_newest_first(crowded, wanted):
    """The blocks of the second page of headers end later than most of the first page begin."""
    table, every = crowded
    rows = stream(BucketRead(table, "", table.bucket_of(T0), reverse=True, wanted=wanted))
    assert [(r.t, r.seq) for r in rows] == [m[:2] for m in reversed(every)]


def test_rows_of_three_blocks_are_sorted_if_only_two_overlap():
    held = WaitingRows()
    for times in ([0, 10], [5, 6], [20]):
        held.add([(t,) for t in times])
    assert held.rest() == [(0,), (5,), (6,), (10,), (20,)]


def test_the_first_of_equal_stamps_may_be_in_a_later_block(rosCas):
    table, conn = make_table(rosCas)
    late, early = 7 << 32, 1 << 32
    blocks = [
        [(T0, late, b"a"), (T0 + 5, late + 1, b"b")],
        [(T0 + 1, early, b"c"), (T0 + 5, early + 1, b"d")],
    ]
    for block in blocks:
        put_block(rosCas, table, "", conn, block)
    list_blocks(rosCas, table, "", blocks)
    assert rosCas.getTopic("/p").getRow(T0 + 5).seq == early + 1


def test_a_message_is_found_under_more_blocks_than_are_kept(crowded):
    table, every = crowded
    for t, seq, wire in every:
        (row,) = fetch_rows([RowKey(table, Position(t, "", seq, table.name))])
        assert (row.t, row.seq, row.columns[0]) == (t, seq, wire)
