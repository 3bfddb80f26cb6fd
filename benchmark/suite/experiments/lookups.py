# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Look up messages by their keys, among 100 to 1,000,000 (fig. 6), and read or the nearest."""

from __future__ import annotations

import contextlib
import random
import time
from typing import Any, Callable, Iterator

from cassandra.cluster import Session

from suite.contenders import FORMAT_NAMES, Contender, Store
from suite.contenders.bare import bare_cluster
from suite.context import Context
from suite.experiments.growth import Grown, grown
from suite.messages import serialized

WARM = 100
"""Lookups that do not count."""
ENOUGH_SEC = 12.0
"""Maximum time of the lookups of one contender, s; it makes fewer of them if they take longer."""


def run(context: Context) -> None:
    """Measure for each number of messages."""
    data = grown(context)
    with bare_session(context) as session:
        for count in context.size.steps:
            rand = random.Random(count)
            keys = [rand.randrange(count) for _ in range(context.size.lookups)]
            with context.part(f"lookups of {count:,}"):
                _store_lookups(context, data, session, count, keys)
            for name in ("rosbag", "mcap", "sqlite"):
                with context.part(f"lookups of {count:,}, {name}"):
                    _file_lookups(context, data, name, count, keys)
    for name in FORMAT_NAMES:
        with context.part(f"small reads, {name}"):
            one = data.stored[name, context.size.steps[-1]]
            assert isinstance(one, Store)
            _small_reads(context, one)


@contextlib.contextmanager
def bare_session(context: Context) -> Iterator[Session]:
    """Connect with the driver alone."""
    cluster = bare_cluster(context.server)
    try:
        yield cluster.connect()
    finally:
        cluster.shutdown()


def bare_lookup(one: Store, session: Session) -> Callable[[int], Any]:
    """Return what reads a whole row by its time with a prepared SELECT."""
    (table,) = one.topic.tables
    names = ", ".join(f'"{column}"' for column in ("_t", "_seq", *table.columns))
    statement = session.prepare(
        f'SELECT {names} FROM "{one.server.keyspace}"."{table.name}" '
        'WHERE "_node" = ? AND "_bucket" = ? AND "_t" = ?'
    )
    bucket_ns = table.metadata.bucket_ns
    return lambda t_ns: session.execute(statement, ("", t_ns // bucket_ns, t_ns)).one()


def _store_lookups(
    context: Context, data: Grown, session: Session, count: int, keys: list[int]
) -> None:
    """Time the formats and bare SELECTs in turn, key by key."""
    stored = {n: data.stored[n, count] for n in FORMAT_NAMES if (n, count) in data.stored}
    ways: dict[tuple[str, str], Callable[[int], Any]] = {}
    for name, one in stored.items():
        assert isinstance(one, Store)
        one.open_reading()
        topic = one.topic
        ways["lookup", name] = lambda key, topic=topic: topic.getData(key)
        ways["lookup by bare time", name] = one.lookup
        # A row of packed is a block; what a lookup in it must reach is the SELECT of binary.
        if name != "packed":
            ways["lookup", f"bare SELECT, {name}"] = bare_lookup(one, session)
    samples: dict[tuple[str, str], list[float]] = {way: [] for way in ways}
    for number, i in enumerate(keys[:WARM] + keys):
        t_ns, wire = data.batch.times[i], data.batch.wires[i]
        for (what, name), ask in ways.items():
            key: Any = t_ns
            if what == "lookup" and name in stored:
                key = stored[name]._topic.getRow(t_ns).key  # what the store returned
            start = time.perf_counter()
            found = ask(key)
            samples[what, name].append((time.perf_counter() - start) * 1e3)
            if name in stored and number % 10 == 0:
                assert serialized(found) == wire, f"{name}: another message was found"
    for (what, name), values in samples.items():
        context.add(what, name, values[-len(keys) :], "ms", x=count)


def _file_lookups(context: Context, data: Grown, name: str, count: int, keys: list[int]) -> None:
    contender: Contender = data.stored[name, count]
    contender.open_reading()
    began, values = time.perf_counter(), []
    for number, i in enumerate(keys):
        late = time.perf_counter() - began > ENOUGH_SEC
        if late and number >= context.size.slow_lookups:
            break
        start = time.perf_counter()
        found = contender.lookup(data.batch.times[i])
        values.append((time.perf_counter() - start) * 1e3)
        assert serialized(found) == data.batch.wires[i], f"{name}: another message was found"
    contender.close()
    context.add("lookup", name, values, "ms", x=count)


def _small_reads(context: Context, one: Store) -> None:
    """Time reads of one or ten messages, each beside the exact lookup."""
    topic, store, times = one.topic, one.server.store, one.batch.times
    rand, count = random.Random(7), min(200, context.size.lookups)
    keys = [topic.getRow(rand.choice(times)).key for _ in range(count)]
    name, ten = topic.name, times[:10]

    def keys_of(rows: Any) -> list[int]:
        return [row[0].to_nsec() for row in rows]

    reads: dict[str, tuple[Callable[[Any], Any], Any]] = {
        "exact": (topic.getData, None),
        "nearest before": (lambda key: topic.getData(key.to_nsec() + 1, nearest="before"), None),
        "nearest after": (lambda key: topic.getData(key.to_nsec() - 1, nearest="after"), None),
        "first": (lambda key: [topic.first().to_nsec()], times[:1]),
        "last": (lambda key: [topic.last().to_nsec()], times[-1:]),
        "limit 10": (lambda key: keys_of(topic.items(limit=10)), ten),
        "statement limit 10": (
            lambda key: keys_of(store.executeCQL(f"select KEY, a, c from {name} limit 10")),
            ten,
        ),
        "desc limit 1": (
            lambda key: keys_of(
                store.executeCQL(f"select KEY, a from {name} order by KEY desc limit 1")
            ),
            times[-1:],
        ),
    }
    samples: dict[str, list[float]] = {what: [] for what in reads}
    for key in [*keys[:10], *keys]:
        for what, (read, wanted) in reads.items():
            start = time.perf_counter()
            found = read(key)
            samples[what].append((time.perf_counter() - start) * 1e3)
            assert wanted is None or found == wanted, f"{what}: {found} instead of {wanted}"
    for what, values in samples.items():
        context.add(f"small read: {what}", one.format, values[-count:], "ms", x=len(times))
