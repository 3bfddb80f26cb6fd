# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Store 100 to 1,000,000 of the paper's messages: bytes on disk, time of a write (fig. 5).

What is stored stays for the lookups and the WHERE clauses.
"""

from __future__ import annotations

import functools
import time
from pathlib import Path

from suite.contenders import FORMAT_NAMES, Contender, Make, Mcap, Rosbag, Sqlite, Store, verify
from suite.context import Context
from suite.messages import Batch, paper
from suite.server import Server

SLICES = 50
INDEXED = "ros, indexes"
INDEXED_FIELDS = ("a", "b", "c", "d")
INDEXED_MOST = 10_000
"""More messages are not written with four indexes: it would take minutes."""


class IndexedStore(Store):
    """Format ros with an index on each field that is not an array."""

    def __init__(self, batch: Batch, folder: Path, server: Server) -> None:
        super().__init__(batch, folder, server, "ros")
        self.name = INDEXED

    def open(self) -> None:
        super().open()
        for field in INDEXED_FIELDS:
            self.topic.createIndex(field)


class Grown:
    """What is stored: a contender for each of its names and number of messages."""

    def __init__(self, batch: Batch) -> None:
        self.batch = batch
        self.stored: dict[tuple[str, int], Contender] = {}

    def of(self, name: str) -> dict[int, Contender]:
        """Return what one has stored, by number of messages."""
        return {n: one for (other, n), one in self.stored.items() if other == name}


def grown(context: Context) -> Grown:
    """Return what is stored; store it when first asked for."""
    if "grown" not in context.shared:
        before, context.experiment = context.experiment, "growth"
        try:
            context.shared["grown"] = _grow(context)
        finally:
            context.experiment = before
    found: Grown = context.shared["grown"]
    return found


def run(context: Context) -> None:
    """Store and measure."""
    grown(context)


def _grow(context: Context) -> Grown:
    steps, server = context.size.steps, context.server
    found = Grown(paper(steps[-1]))
    makers: dict[str, Make] = {"rosbag": Rosbag, "mcap": Mcap, "sqlite": Sqlite}
    for name in FORMAT_NAMES:
        makers[name] = functools.partial(Store, server=server, format=name)
    makers[INDEXED] = functools.partial(IndexedStore, server=server)
    for count in steps:
        for name, make in makers.items():
            if name == INDEXED and count > INDEXED_MOST:
                continue
            folder = context.folder / f"grown_{name.replace(', ', '_')}_{count}"
            folder.mkdir()
            batch = found.batch.first(count, f"/paper_{folder.name}")
            with context.part(f"{name}, {count:,} messages"):
                found.stored[name, count] = _store(context, name, make(batch, folder))
    if server.ours:
        server.stop()  # drained: everything is in the files of the tables
    for (name, count), one in found.stored.items():
        with context.part(f"size of {name}, {count:,} messages"):
            size = one.size()
            if size is not None:
                context.add("size", name, size / count, "B/msg", x=count)
    server.start()
    return found


def _store(context: Context, name: str, contender: Contender) -> Contender:
    batch, count = contender.batch, len(contender.batch)
    contender.open()
    marks, slices = [time.perf_counter()], min(SLICES, count)
    for i in range(slices):
        contender.extend(i * count // slices, (i + 1) * count // slices)
        marks.append(time.perf_counter())
    contender.finish()
    seconds = time.perf_counter() - marks[0]
    context.add("write all", name, seconds / count * 1e6, "µs/msg", x=count)
    if count == context.size.steps[-1]:
        every: list[float] = [
            (after - before) / (count / slices) * 1e6 for before, after in zip(marks, marks[1:])
        ]
        context.add("write, by part of all", name, every, "µs/msg", x=count)
    verify(contender, batch)
    contender.close()
    return contender
