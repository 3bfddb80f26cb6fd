# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The buckets of a read, found by reading only as much of the directory as needed.

A topic that was recorded for a year has half a million buckets of a minute, and a read of its last
message needs one of them. So the directory is read slot by slot, in windows that grow. A read of
all rows gets a whole slot at once.

A read of few rows requests the buckets in which the last read of its tables began at the same time
as the directory. It uses the answer only if the directory names the same buckets. That saves one
round trip and never changes the result.
"""

from __future__ import annotations

from itertools import chain, groupby
from typing import (
    Callable,
    Collection,
    Iterable,
    Iterator,
    List,
    NamedTuple,
    Sequence,
    Tuple,
)

from cassandra_ros.connection.cassandra import AT_ONCE
from cassandra_ros.connection.paging import sent_ahead
from cassandra_ros.read import Read
from cassandra_ros.tables.directory import (
    ALL_ROWS,
    SLOT_BUCKETS,
    BucketRow,
    Directory,
    slot_of,
)
from cassandra_ros.tables.row_table import MAX_SEQ, MIN_SEQ, Order, RowTable

FEW_BUCKETS = 8
"""Number of rows in the first window of buckets, for each node."""
FEW_SLOTS = 64
"""Number of rows in the first window of slots and their nodes."""
MANY_SLOTS = 1024
"""Maximum number of directory slots cached for one table."""
WIDER = 4
"""Ratio between the sizes of two consecutive windows."""
FEW_ROWS = 5000
"""Maximum number of wanted rows for which the first pages are smaller than whole ones."""
MOST_FIRST = 8
"""Maximum number of buckets requested before the directory has answered. If a read begins in more
buckets, the directory is read first."""

Group = List[BucketRow]
"""Rows of the directory of all writers for one bucket and node."""
BucketGroup = Tuple[int, Group]
"""A bucket and its group. An empty group means that the directory was read up to here."""
_Slot = Tuple[int, Tuple[str, ...]]
"""A slot, and the nodes that have buckets in it."""
_Answers = Iterator[Callable[[], List[BucketRow]]]
"""Functions that wait for the buckets of one node each."""


def takes_few(read: Read) -> bool:
    """Return whether probably less than a page of rows will be taken."""
    return read.wanted is not None and read.wanted <= FEW_ROWS


def first_and_last(read: Read, table: RowTable) -> tuple[int, int]:
    """Return the first and the last bucket of a table that may hold rows of a read."""
    low, high = read.time_range
    if read.after is not None and read.reverse:
        high = min(high, read.after.t)
    elif read.after is not None:
        low = max(low, read.after.t)
    return table.bucket_of(low), table.bucket_of(high)


def may_hold(read: Read, bucket: Sequence[BucketRow]) -> bool:
    """Return whether a bucket may hold rows of a read: the directory may list too many."""
    writers = read.whose.writers
    if writers is not None and not any(row.writer in writers for row in bucket):
        return False
    low, high = read.time_range
    return any(
        not row.closed or (row.rows and row.t_min <= high and row.t_max >= low) for row in bucket
    )


class BucketPart(NamedTuple):
    """A bucket of a read, with the sizes of its pages."""

    start: int
    """Time at which it begins, in the direction of reading, ns."""
    table: RowTable
    node: str
    bucket: int
    rows: Sequence[BucketRow]
    """Rows of its writers in the directory; empty = no bucket, but the place up to which the
    directory was read."""
    page_rows: int = 0
    page_bytes: int = 0
    """Approximate maximum size of its messages in memory, bytes."""
    first_rows: int = 0
    """Number of rows of its first page, from which pages grow; 0 = page_rows."""

    @property
    def listed(self) -> int:
        """Number of rows by the directory, which is exact for a closed bucket."""
        return sum(row.rows for row in self.rows)

    def listed_in(self, span_ns: int) -> float:
        """Return the number of rows in a time range of this length, if they are evenly spread."""
        ends = [(row.t_min, row.t_max) for row in self.rows if row.rows]
        length = max(last for _, last in ends) - min(first for first, _ in ends) if ends else 0
        return self.listed * min(1.0, span_ns / max(1, length))


def ends_of(piece: BucketPart, read: Read) -> tuple[Order, Order]:
    """Return the first and the last row key in a bucket that the read includes."""
    first, last = read.time_range
    low, high = (first, MIN_SEQ), (last, MAX_SEQ)
    if read.after is None:
        return low, high
    t, node, seq, table, _ = read.after
    if read.reverse and t <= last:
        high = (t - (piece.node > node), MAX_SEQ)
        if piece.node == node:
            high = (t, seq - (piece.table.name >= table))
    elif not read.reverse and t >= first:
        low = (t + (piece.node < node), MIN_SEQ)
        if piece.node == node and piece.table.name > table:
            low = (t, seq)
        elif piece.node == node:
            low = (t, seq + 1) if seq < MAX_SEQ else (t + 1, MIN_SEQ)
    return low, high


class BucketWalk:
    """The buckets of one table in [first, last], in order of time, or newest first.

    Args:
        nodes: nodeIDs to read; None = all.
        ttl: Lifetime of the table's rows, seconds; expired buckets are left out.
        few: Whether probably only few of the buckets are needed.

    Attributes:
        met: Nodes found so far that have buckets.
    """

    def __init__(
        self,
        directory: Directory,
        table: str,
        first: int,
        last: int,
        nodes: Sequence[str] | None = None,
        ttl: int = 0,
        *,
        reverse: bool = False,
        few: bool = False,
    ) -> None:
        self._directory = directory
        self._table = table
        self._ends = first, last
        self._nodes = nodes
        self._ttl = ttl
        self._reverse = reverse
        self._few = few
        self.met: set[str] = set()

    def groups(self) -> Iterator[BucketGroup]:
        """Yield the buckets of all nodes in order of time.

        If few are needed, an empty group is yielded before each further request.
        """
        limit = FEW_BUCKETS if self._few else ALL_ROWS
        slots = self._slots()
        next(slots, None)  # sends the request; an empty range has no slots
        # The first slot is mostly the same as last time: its buckets are requested at once.
        expected = self._expected()
        early = None if expected is None else self._ask(expected, self._inside(expected), limit)
        begun = False
        for slot in slots:
            if slot is None:
                continue
            low, high = self._inside(slot)
            # Only for the first slot: later ones need a larger window.
            asked = early if slot == expected and not begun else None
            while low <= high:
                if begun and self._few:
                    yield (high if self._reverse else low), []
                asked = self._ask(slot, (low, high), limit) if asked is None else asked
                found, end = self._window(asked, low, high, limit)
                yield from ((group[0].bucket, group) for group in found)
                low, high = (low, end - 1) if self._reverse else (end + 1, high)
                limit, asked, begun = min(ALL_ROWS, WIDER * limit), None, True

    def _inside(self, slot: _Slot) -> tuple[int, int]:
        """Return the first and the last bucket of a slot in the range of this walk."""
        begin = slot[0] * SLOT_BUCKETS
        return max(self._ends[0], begin), min(self._ends[1], begin + SLOT_BUCKETS - 1)

    def _slots(self) -> Iterator[_Slot | None]:
        """Yield None when the request was sent, then the slots in which the nodes have buckets."""
        first, last = slot_of(self._ends[0]), slot_of(self._ends[1])
        limit = FEW_SLOTS if self._few else ALL_ROWS
        while first <= last:
            ask = self._directory.begin_nodes
            answer = ask(self._table, (first, last), limit, reverse=self._reverse)
            yield None
            asked, listed = range(first, last + 1), answer()
            slots = [(s, tuple(n for _, n in g)) for s, g in groupby(listed, lambda row: row[0])]
            if len(listed) < limit:
                first, last = 1, 0
            else:
                cut = slots.pop()[0]  # further nodes of this slot may follow
                first, last = (first, cut) if self._reverse else (cut, last)
                limit = min(ALL_ROWS, WIDER * limit)
            if self._few:
                note(self._directory, self._table, asked, slots)
            yield from [kept for kept in map(self._kept, slots) if kept is not None]

    def _kept(self, slot: _Slot) -> _Slot | None:
        """Leave out the nodes that are not to be read; return None if there are no others."""
        nodes = tuple(n for n in slot[1] if self._nodes is None or n in self._nodes)
        self.met.update(nodes)
        return (slot[0], nodes) if nodes else None

    def _expected(self) -> _Slot | None:
        """Return the slot that is probably the first; None = unknown, or too many nodes to try."""
        first, last = slot_of(self._ends[0]), slot_of(self._ends[1])
        known = self._directory.seen.get(self._table, {}) if self._few else {}
        inside = [(s, nodes) for s, nodes in known.items() if first <= s <= last]
        if not inside:
            return None
        slot = self._kept(max(inside) if self._reverse else min(inside))
        return slot if slot is not None and len(slot[1]) <= AT_ONCE else None

    def _ask(self, slot: _Slot, ends: tuple[int, int], limit: int) -> _Answers:
        """Request the buckets of the nodes of a slot, several at once."""
        params = [(self._table, node, slot[0], *ends) for node in slot[1]]
        asked = sent_ahead(
            self._directory.begin_buckets(params, limit, reverse=self._reverse), AT_ONCE
        )
        first = next(asked, None)  # sends the requests
        return iter(()) if first is None else chain((first,), asked)

    def _window(self, asked: _Answers, low: int, high: int, limit: int) -> tuple[list[Group], int]:
        """Return the next buckets, and the last bucket (included) up to which they are complete."""
        end = low if self._reverse else high
        found: list[BucketRow] = []
        for answer in asked:
            rows = answer()
            found += rows
            if len(rows) == limit:
                cut = rows[-1].bucket  # further writers of this bucket may follow
                end = max(end, cut + 1) if self._reverse else min(end, cut - 1)
        groups: dict[tuple[int, str], Group] = {}
        for row in found:
            inside = row.bucket >= end if self._reverse else row.bucket <= end
            if inside and not (self._ttl and row.expired(self._ttl)):
                groups.setdefault((row.bucket, row.node), []).append(row)
        return [groups[key] for key in sorted(groups, reverse=self._reverse)], end


def note(directory: Directory, table: str, asked: range, slots: Sequence[_Slot]) -> None:
    """Cache the listed nodes of some slots for the next read."""
    kept = {s: n for s, n in directory.seen.get(table, {}).items() if s not in asked}
    directory.seen[table] = {**(kept if len(kept) < MANY_SLOTS else {}), **dict(slots)}


def begin_slot(
    directory: Directory, table: str, slot: int
) -> tuple[tuple[str, ...], Callable[[], tuple[str, ...]]]:
    """Request the nodes of a slot.

    Return the cached ones, and a function that waits for the answer.
    """
    answer = directory.begin_nodes(table, (slot, slot))

    def nodes() -> tuple[str, ...]:
        found = tuple(node for _, node in answer())
        note(directory, table, range(slot, slot + 1), [(slot, found)] if found else [])
        return found

    return directory.seen.get(table, {}).get(slot, ()), nodes


def foresee(
    directory: Directory, tables: Sequence[RowTable], read: Read
) -> tuple[list[BucketPart], int]:
    """Return the buckets in which a read probably begins, and the number of nodes of its tables."""
    found: list[BucketPart] = []
    streams = 0
    for table in tables:
        known, groups = directory.first.get((table.name, read.reverse), ((), ()))
        nodes = [node for node in known if read.whose.nodes is None or node in read.whose.nodes]
        streams += len(nodes)
        low, high = first_and_last(read, table)
        found += [
            BucketPart(0, table, group[0].node, group[0].bucket, group)
            for group in groups
            if group[0].node in nodes and low <= group[0].bucket <= high and may_hold(read, group)
        ]
    return (found if len(found) <= MOST_FIRST else []), streams


def note_first(
    directory: Directory,
    walks: Iterable[tuple[RowTable, Collection[str]]],
    begun: Iterable[BucketPart],
    read: Read,
) -> None:
    """Cache the buckets in which a read began, and the nodes that were found in each table."""
    groups: dict[str, list[Sequence[BucketRow]]] = {}
    for piece in begun:
        if piece.rows:
            groups.setdefault(piece.table.name, []).append(piece.rows)
    for table, met in walks:
        if table.name in groups:
            directory.first[table.name, read.reverse] = tuple(met), groups[table.name]
