# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ask stored Imu messages for those that satisfy a condition, beside a scan of the bag.

A thousandth of them, spread over all or in ten stretches (events), with and without an index; half
of all. Each answer is compared with the true one.
"""

from __future__ import annotations

import functools
import random
import time
from typing import Any, List, Tuple

import numpy as np

from suite.contenders import FORMAT_NAMES, Contender, Mcap, Rosbag, Sqlite, Store
from suite.context import Context, timed
from suite.experiments.growth import grown
from suite.experiments.writing import getter
from suite.messages import imu_batch, imu_rows

ONE_IN = 1000
LIMIT = 100.0
"""Far above the random values; what satisfies the condition is put there."""
WARM = 5
"""Statements before the first that is measured, for the server's Java compiles meanwhile."""
FORMATS = tuple(name for name in FORMAT_NAMES if name != "binary")
CONDITIONS = {
    "1,000 spread": ("linear_acceleration.x", LIMIT),
    "1,000 in ten stretches": ("angular_velocity.z", LIMIT),
    "half of all": ("orientation.x", 0.0),
}
"""Field, and what it must exceed."""
PLACES = {"linear_acceleration.x": 0, "angular_velocity.z": 2, "orientation.x": 0}
INDEXED = "1,000 spread"

Answer = List[Tuple[int, int, float]]
"""Receive time in ns, header.seq and the field of each message found."""


def run(context: Context) -> None:
    """Store the messages, then measure each condition."""
    count = context.size.condition_messages
    times, rows = imu_rows(count)
    plant(rows)
    batch = imu_batch(times, rows)
    with context.new_folder("conditions") as folder:
        contenders: list[Contender] = [cls(batch, folder) for cls in (Rosbag, Mcap, Sqlite)]
        for name in FORMATS:
            mine = batch.first(count, f"/imu_{name}")
            contenders.append(Store(mine, folder, context.server, name))
        kept = []
        for one in contenders:
            with context.part(f"storing, {one.name}"):
                one.open()
                seconds = timed(lambda one=one: (one.extend(0, count), one.finish()))
                context.add("store", one.name, count / seconds, "msg/s", x=count)
                kept.append(one)
        for condition in CONDITIONS:
            _measure(context, kept, condition, answer(times, rows, condition))
        _with_index(context, kept, answer(times, rows, INDEXED))
        for one in kept:
            one.discard()


def plant(rows: Any) -> None:
    """Let a thousandth of the messages satisfy the first conditions."""
    rand, count = random.Random(2), len(rows)
    spread = [i + rand.randrange(ONE_IN) for i in range(0, count, ONE_IN)]
    rows["linear_acceleration"][spread, 0] = LIMIT + 1
    length = max(1, count // ONE_IN // 10)
    for event in range(10):
        start = event * (count // 10) + rand.randrange(count // 10 - length)
        rows["angular_velocity"][start : start + length, 2] = LIMIT + 2


def answer(times: Any, rows: Any, condition: str) -> Answer:
    """Return what a condition must find."""
    field, limit = CONDITIONS[condition]
    values = rows[field.partition(".")[0]][:, PLACES[field]]
    hits = np.flatnonzero(values > limit)
    found = zip(times[hits].tolist(), rows["seq"][hits].tolist(), values[hits].tolist())
    return list(found)


def scan(contender: Contender, condition: str) -> Answer:
    """Find the messages as one does in a file: read all, look at each."""
    field, limit = CONDITIONS[condition]
    get, found = getter(field), []
    for msg in contender.objects():
        value = get(msg)
        if value > limit:
            found.append((msg.header.stamp.to_nsec(), msg.header.seq, value))
    return found


def ask(store: Store, condition: str) -> Answer:
    """Find them with a statement."""
    field, limit = CONDITIONS[condition]
    rows = store.server.store.executeCQL(
        f"select KEY, header.seq, {field} from {store.batch.topic} where {field} > ?", [limit]
    )
    return [(key.to_nsec(), seq, value) for key, seq, value in rows]


def _measure(
    context: Context, kept: list[Contender], condition: str, wanted: Answer, suffix: str = ""
) -> None:
    """Time a condition on each contender, round by round."""
    samples: dict[str, list[float]] = {}
    few = len(wanted) < context.size.condition_messages // 10
    for number in range(context.size.condition_rounds):
        for one in kept:
            work = functools.partial(ask if isinstance(one, Store) else scan, one, condition)
            if isinstance(one, Store):
                if number == 0 and few:
                    for _ in range(WARM if context.size.warm_ups else 0):
                        work()
            elif number and one.name != "rosbag":
                continue  # beside rosbag the other files are scanned once
            found: list[Answer] = []
            with context.part(f"{condition}{suffix}, {one.name}"):
                seconds = timed(lambda work=work, found=found: found.append(work()))
                assert found[0] == wanted, f"{len(found[0]):,} found, {len(wanted):,} wanted"
                samples.setdefault(one.name, []).append(seconds)
    for name, seconds in samples.items():
        context.add("condition", name, seconds, "s", kind=f"{condition}{suffix}", x=len(wanted))


def _with_index(context: Context, kept: list[Contender], wanted: Answer) -> None:
    field, _ = CONDITIONS[INDEXED]
    stores = [one for one in kept if isinstance(one, Store) and one.format == "ros"]
    for one in stores:
        with context.part("index"):
            seconds = timed(lambda one=one: one.topic.createIndex(field))
            context.add("createIndex", one.name, seconds, "s", x=len(one.batch))
            _measure(context, [one], INDEXED, wanted, ", index")


def run_clauses(context: Context) -> None:
    """Ask for random WHERE clauses over the paper's messages (fig. 7)."""
    data, count = grown(context), context.size.steps[-1]
    head = np.dtype([("a", "i1"), ("b", "<i2"), ("c", "<i4"), ("d", "<i8")])
    joined = b"".join(wire[: head.itemsize] for wire in data.batch.wires)
    fields = np.frombuffer(joined, dtype=head)
    rand = random.Random(3)
    clauses = [random_clause(rand, fields) for _ in range(context.size.clauses)]
    for name in FORMATS:
        with context.part(f"clauses, {name}"):
            topic = data.stored[name, count].topic
            for where, params, mask in clauses:
                start = time.perf_counter()
                found = [key.to_nsec() for key, _ in topic.items(where=(where, params))]
                seconds = time.perf_counter() - start
                wanted = np.asarray(data.batch.times)[mask]
                assert np.array_equal(found, wanted), f"{where}: {len(found):,} of {len(wanted):,}"
                context.add("clause", name, seconds, "s", x=len(wanted))
    for name in ("rosbag", "mcap", "sqlite"):
        for step in context.size.steps:
            with context.part(f"scan of {step:,}, {name}"):
                one = data.stored[name, step]
                seconds = timed(lambda one=one: [m for m in one.objects() if m.a > 0 and m.c < 0])
                context.add("scan", name, seconds, "s", x=step)


def random_clause(rand: random.Random, fields: Any) -> tuple[str, list[int], Any]:
    """Return a random condition of one to three terms, its parameters, and what it selects."""
    names = rand.sample(["a", "b", "c", "d"], rand.randint(1, 3))
    share = (10 ** rand.uniform(-5, 0)) ** (1 / len(names))
    terms, params, mask = [], [], np.ones(len(fields), dtype=bool)
    for name in names:
        values = fields[name]
        if name == "a" and share < 0.02:
            value = int(rand.choice(values))
            terms.append("a = ?")
            mask &= values == value
        elif rand.random() < 0.5:
            value = int(np.quantile(values, share))
            terms.append(f"{name} <= ?")
            mask &= values <= value
        else:
            value = int(np.quantile(values, 1 - share))
            terms.append(f"{name} > ?")
            mask &= values > value
        params.append(value)
    return " and ".join(terms), params, mask
