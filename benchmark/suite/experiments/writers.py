# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Write by 1, 2 and 4 processes at once; and on three nodes with factor 3."""

from __future__ import annotations

import random
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from suite.contenders import FORMAT_NAMES, Store, verify
from suite.context import Context, measure
from suite.messages import imu
from suite.server import Server
from suite.writer_process import TOPIC

ROOT = Path(__file__).resolve().parents[2]


def run(context: Context) -> None:
    """Let processes write the same topic."""
    for format in FORMAT_NAMES:
        for writers in context.size.writers:
            with context.part(f"{writers} writers, {format}"):
                _together(context, format, writers)


def _together(context: Context, format: str, writers: int) -> None:
    server, count = context.server, context.size.writer_messages
    server.store.addTopic(TOPIC, format, msg_type="sensor_msgs/Imu")
    arguments = [server.host, str(server.port), server.keyspace, format, str(count)]
    children = [
        subprocess.Popen(
            [sys.executable, "-m", "suite.writer_process", *arguments],
            cwd=str(ROOT),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(writers)
    ]
    try:
        for child in children:
            assert child.stdout.readline() == "ready\n", "a writer did not start"
        start = time.perf_counter()
        for child in children:
            child.stdin.write("go\n")
            child.stdin.flush()
        for child in children:
            assert child.stdout.readline() == "done\n", "a writer failed"
        seconds = time.perf_counter() - start
    finally:
        for child in children:
            child.communicate()
    stored = server.store.getTopic(TOPIC).countTopicData()
    assert stored == writers * count, f"{stored:,} of {writers * count:,} stored"
    server.store.removeTopic(TOPIC)
    context.add("write", format, writers * count / seconds, "msg/s", kind="imu", x=writers)


def run_cluster(context: Context) -> None:
    """Write, read and look up on a cluster whose every node has every message; the last to run."""
    server, nodes = context.server, context.size.nodes
    if nodes:
        server.stop()
        server = Server(context.folder / "cluster", nodes=nodes)
    try:
        server.start()
        batch = imu(context.size.cluster_messages)
        for format in FORMAT_NAMES:
            with context.part(f"{nodes} nodes, {format}"):
                for number in range(1 + context.size.warm_ups):
                    measured = number == context.size.warm_ups
                    _on_cluster(context, Store(batch, context.folder, server, format), measured)
    finally:
        if nodes:
            server.stop()  # the one of the other experiments stays stopped: this is the last


def _on_cluster(context: Context, store: Store, measured: bool) -> None:
    count, batch = len(store.batch), store.batch
    store.open()
    try:
        cost, _ = measure(store.server, lambda: (store.extend(0, count), store.finish()))
        back, _ = measure(store.server, lambda: sum(1 for _ in store.objects()))
        verify(store, batch)
        values = _lookups(store, context.size.lookups)
    finally:
        store.discard()
    if measured:
        nodes = max(1, context.size.nodes)
        context.add("write", store.format, count / cost.seconds, "msg/s", kind="imu", x=nodes)
        context.add("read", store.format, count / back.seconds, "msg/s", kind="imu", x=nodes)
        context.add("lookup", store.format, values, "ms", kind="imu", x=nodes)


def _lookups(store: Store, count: int) -> list[float]:
    """Return the times of random lookups, ms."""
    topic, rand, values = store.topic, random.Random(1), []
    for _ in range(count):
        key: Any = topic.getRow(rand.choice(store.batch.times)).key
        start = time.perf_counter()
        topic.getData(key)
        values.append((time.perf_counter() - start) * 1e3)
    return values
