# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ask SQL over Imu messages and fixes, beside DuckDB over Parquet, and pandas over bags.

Columns of Arrow out of blocks and rows; a join by time; a condition that a thousandth satisfies,
with and without pushdown; and the memory of a join over ten times as many messages.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas as pd
import pyarrow.parquet
import rosbag
from sensor_msgs.msg import NavSatFix

from cassandra_ros.client.sql.sql_result import SqlResult
from cassandra_ros.messages.classes import serialize
from suite.contenders import Rosbag, Store
from suite.context import Context, timed
from suite.experiments.conditions import CONDITIONS, plant
from suite.messages import Batch, imu_batch, imu_rows

FIX_EVERY = 10
"""Number of Imu messages for each fix."""
ROUNDS = 3
MANY = 10
"""Number of times that the Imu messages are stored for the join whose memory is measured."""
JOIN = """SELECT count(*) AS n, sum(f.altitude) AS height, max(i.linear_acceleration.z) AS most
    FROM {imu} i ASOF JOIN {fix} f ON i.KEY >= f.KEY"""
CONDITION = "SELECT KEY, {field} FROM imu_packed WHERE {field} > ?"
HITS = ("1,000 spread", "1,000 in ten stretches")
"""Conditions, as conditions.py names them; in stretches most blocks need not be unpacked."""
MEMORY = """
import sys
from cassandra_ros import RosCassandra
with RosCassandra(sys.argv[1], int(sys.argv[2]), keyspace=sys.argv[3]) as store:
    found = store.sql(sys.argv[4]).fetchall()
with open("/proc/self/status") as status:
    peak = next(line.split()[1] for line in status if line.startswith("VmHWM:"))
print(found[0][0], int(peak) / 1024)
"""
"""Program that answers one statement; prints its first value and its peak memory, MB. ru_maxrss of
a child process would be at least the memory of its parent."""


def run(context: Context) -> None:
    """Store the messages, then measure each question."""
    count = context.size.condition_messages
    times, rows = imu_rows(count)
    plant(rows)
    batch, fixes = imu_batch(times, rows), _fixes(times[::FIX_EVERY])
    with context.new_folder("sql") as folder:
        stores = []
        for name in ("packed", "ros"):
            one = Store(batch.first(count, f"/imu_{name}"), folder, context.server, name)
            stores.append(one)
        stores.append(Store(fixes, folder, context.server, "packed"))
        for one in stores:
            with context.part(f"storing {one.batch.topic}"):
                one.open()
                one.extend(0, len(one.batch))
                one.finish()
        for name in ("packed", "ros"):
            with context.part(f"toArrow, {name}"):
                _to_arrow(context, name, count)
        with context.part("join"):
            _join(context, folder, batch, fixes)
        with context.part("condition"):
            _condition(context, count)
        with context.part("memory"):
            _memory(context, stores[0], count * MANY)
        for one in stores:
            one.discard()


def _fixes(times: Any) -> Batch:
    """Make a fix for some of the Imu messages."""
    rand = np.random.default_rng(7)
    wires = []
    for t, (lat, lon, alt) in zip(times.tolist(), rand.standard_normal((len(times), 3)).tolist()):
        message = NavSatFix(latitude=lat, longitude=lon, altitude=alt)
        message.header.stamp.secs, message.header.stamp.nsecs = divmod(t, 10**9)
        wires.append(serialize(message))
    return Batch("fix", "/fix", NavSatFix, times.tolist(), wires, 10.0)


def _to_arrow(context: Context, name: str, count: int) -> None:
    topic = context.server.store.getTopic(f"/imu_{name}")
    rates = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        read = sum(batch.num_rows for batch in topic.toArrow())
        rates.append(count / (time.perf_counter() - start))
        assert read == count
    context.add("toArrow", name, rates, "msg/s", x=count)


def _join(context: Context, folder: Path, batch: Batch, fixes: Batch) -> None:
    store, count = context.server.store, len(batch)
    files = {}
    for topic in ("imu_packed", "fix"):
        files[topic] = f"{folder}/{topic}.parquet"
        pyarrow.parquet.write_table(store.getTopic(topic).toArrow().read_all(), files[topic])
    mine = JOIN.format(imu="imu_packed", fix="fix")
    theirs = JOIN.format(imu=f"'{files['imu_packed']}'", fix=f"'{files['fix']}'")
    answers = {}

    def ask(name: str, work: Any) -> float:
        return timed(lambda: answers.__setitem__(name, work()))

    seconds: dict[str, list[float]] = {"packed": [], "DuckDB, Parquet": []}
    for _ in range(ROUNDS):
        seconds["packed"].append(ask("packed", lambda: store.sql(mine).fetchall()))
        parquet = ask("DuckDB, Parquet", lambda: duckdb.sql(theirs).fetchall())
        seconds["DuckDB, Parquet"].append(parquet)
    for name, values in seconds.items():
        context.add("join", name, values, "s", x=count)
    bags = []
    for each in (batch, fixes):
        (folder / each.kind).mkdir()
        bag = Rosbag(each, folder / each.kind)
        bag.open()
        bag.extend(0, len(each))
        bag.finish()
        bags.append(bag.path)
    context.add(
        "join", "bags, pandas", ask("bags, pandas", lambda: _by_pandas(*bags)), "s", x=count
    )
    one, *others = (row[0] for row in answers.values())
    assert all(np.allclose(np.array(one, float), np.array(each, float)) for each in others)


def _by_pandas(imu: str, fix: str) -> list[tuple[Any, ...]]:
    """Join by reading both bags and pandas.merge_asof."""
    frames = []
    for path, field in (
        (imu, lambda msg: msg.linear_acceleration.z),
        (fix, lambda msg: msg.altitude),
    ):
        with rosbag.Bag(path) as bag:
            found = [(t.to_nsec(), field(msg)) for _, msg, t in bag.read_messages()]
        frames.append(pd.DataFrame(found, columns=["KEY", Path(path).parent.name]))
    joined = pd.merge_asof(*frames, on="KEY").dropna()
    return [(len(joined), joined["fix"].sum(), joined["imu"].max())]


def _condition(context: Context, count: int) -> None:
    for kind in HITS:
        field, limit = CONDITIONS[kind]
        text, counts = CONDITION.format(field=field), set()
        for name, pushdown in (("pushdown", True), ("whole table", False)):
            seconds = []
            for _ in range(ROUNDS):
                gc.collect()
                start = time.perf_counter()
                asked = SqlResult(context.server.store.catalog, text, [limit], pushdown=pushdown)
                counts.add(asked.arrow().num_rows)
                seconds.append(time.perf_counter() - start)
            context.add("condition", name, seconds, "s", kind=kind, x=count)
        assert len(counts) == 1


def _memory(context: Context, one: Store, count: int) -> None:
    """Store the Imu messages some more times, and join all of them in a process of its own."""
    batch = one.batch
    span = batch.times[-1] - batch.times[0] + 10**7
    for more in range(1, MANY):
        with context.server.store.messageWriter(format="packed", block_sec=None) as writer:
            handle = writer.connect(batch.connection)
            for n, (t, wire) in enumerate(zip(batch.times, batch.wires)):
                writer.write(handle, t + more * span, n, wire)
    server = context.server
    host, port = server.store.cassandra.hosts[0], server.store.cassandra.port
    text = JOIN.format(imu="imu_packed", fix="fix")
    words = [sys.executable, "-c", MEMORY, host, str(port), server.store.keyspace or "", text]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    *_, joined, peak = done.stdout.split()
    assert int(joined) == count, joined
    context.add("memory", "packed", float(peak), "MB", x=count)
