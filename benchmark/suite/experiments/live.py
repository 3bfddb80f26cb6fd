# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Record live messages at rising rates, beside rosbag record: what is lost, processor, memory.

A publisher of a process of its own sends numbered messages; its socket blocks where the recorder
does not read, so a rate also counts as lost where it could not be sent.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
import xmlrpc.client
from dataclasses import dataclass
from pathlib import Path
from typing import Iterator

import psutil
import rosbag

from cassandra_ros.local_server import free_port
from suite.contenders import FORMAT_NAMES
from suite.context import Context

ROOT = Path(__file__).resolve().parents[3]
RECORDER = ROOT / ".ws/devel/lib/cassandra_ros/recorder"
PUBLISHER = ROOT / "test/nodes/load_publisher.py"
TOPIC = "/load"
IMAGE_BYTES = 2_000_000
JOURNAL = "recorder, packed, journal"
BUFFER_MB = 256
HELD = 0.95
"""A rate of which less could be sent was not held."""
PATIENCE_SEC = 120
FORMATS = tuple(name for name in FORMAT_NAMES if name != "binary")


@dataclass
class Recorded:
    """What became of one recording."""

    sent: int
    stored: int
    rate: float
    """Messages a second that could be sent."""
    cpu: float
    """Processor time of the recorder, s."""
    server_cpu: float
    """Processor time of the server, s; 0 = it is not ours, or no part of it."""
    peak_mb: float
    """Memory of the recorder."""
    drain_sec: float
    """From the last message to the end of the recorder."""


def run(context: Context) -> None:
    """Record small messages, then images."""
    with roscore(context) as env:
        names = ("rosbag record", *(f"recorder, {name}" for name in FORMATS), JOURNAL)
        for kind, size, rates in (
            ("small", 0, context.size.rates),
            ("images of 2 MB", IMAGE_BYTES, context.size.image_rates),
        ):
            for name in names if rates else ():
                with context.part(f"{kind}, {name}"):
                    _rates(context, env, name, kind, size, list(rates))


@contextlib.contextmanager
def roscore(context: Context) -> Iterator[dict[str, str]]:
    """Run a master; yield the environment of its nodes."""
    port, home = free_port(), context.folder / "ros_home"
    home.mkdir(exist_ok=True)
    env = dict(os.environ, ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1")
    env.update(ROS_HOME=str(home), ROS_LOG_DIR=str(home), PYTHONUNBUFFERED="1")
    with (home / "roscore.log").open("w") as log:
        master = subprocess.Popen(
            ["roscore", "-p", str(port)], env=env, stdout=log, stderr=subprocess.STDOUT
        )
    try:
        _await_master(env["ROS_MASTER_URI"])
        yield env
    finally:
        master.send_signal(signal.SIGINT)
        master.wait()


def _await_master(uri: str) -> None:
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError):
            xmlrpc.client.ServerProxy(uri).getSystemState("/benchmark")
            return
        time.sleep(0.1)
    raise RuntimeError(f"roscore does not answer at {uri}")


def _rates(
    context: Context, env: dict[str, str], name: str, kind: str, size: int, rates: list[int]
) -> None:
    """Try one rate after the other, until one is lost."""
    held = 0
    for rate in rates:
        count = int(rate * context.size.live_sec)
        found = _record(context, env, name, size, count, rate)
        lost = found.sent - found.stored
        context.add("lost", name, lost, "messages", kind=kind, x=rate)
        context.add("sent", name, found.rate, "msg/s", kind=kind, x=rate)
        context.add("cpu", name, found.cpu / found.sent * 1e6, "µs/msg", kind=kind, x=rate)
        server_cpu = found.server_cpu / found.sent * 1e6
        context.add("server cpu", name, server_cpu, "µs/msg", kind=kind, x=rate)
        context.add("memory", name, found.peak_mb, "MB", kind=kind, x=rate)
        context.add("drain", name, found.drain_sec, "s", kind=kind, x=rate)
        if lost or found.rate < HELD * rate:
            break
        held = rate
    context.add("held", name, held, "msg/s", kind=kind)


def _record(
    context: Context, env: dict[str, str], name: str, size: int, count: int, rate: int
) -> Recorded:
    server, bag = context.server, context.folder / "live.bag"
    command = ["rosbag", "record", "-q", "-O", str(bag), "-b", str(BUFFER_MB), TOPIC]
    if name != "rosbag record":
        store = ["--host", server.host, "--port", str(server.port), "--keyspace", server.keyspace]
        format = name.split(", ")[1]
        command = [str(RECORDER), *store, "--format", format, "-b", str(BUFFER_MB)]
        command += ["--journal"] * (name == JOURNAL)
        command += ["-O", f"live {format} {rate}", TOPIC]
    log = context.folder / "recorder.log"
    before = server.cpu() or 0.0
    with log.open("w") as output:
        recorder = subprocess.Popen(
            command, env=env, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT
        )
    try:
        rate_sent = _publish(env, size, count, rate)
        processes = [psutil.Process(recorder.pid)]
        processes += processes[0].children(recursive=True)
        began = time.perf_counter()
        times = _end(recorder, processes)
        drain = time.perf_counter() - began
        server_cpu = 0.0 if name == "rosbag record" else (server.cpu() or 0.0) - before
        stored = _stored(context, bag, name)
    finally:
        if recorder.poll() is None:
            recorder.kill()
        recorder.wait()
    return Recorded(count, stored, rate_sent, times[0], server_cpu, times[1], drain)


def _publish(env: dict[str, str], size: int, count: int, rate: int) -> float:
    """Publish; return the rate that was reached."""
    uri = env["ROS_MASTER_URI"]
    done = subprocess.run(
        [sys.executable, str(PUBLISHER), uri, TOPIC, str(size), str(count), str(rate)],
        env=env,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        timeout=PATIENCE_SEC + 10 * count / rate,
    )
    seconds = float(re.search(r"sent \d+ in ([\d.]+) s", done.stdout)[1])
    return count / max(seconds, 0.1)


def _end(recorder: subprocess.Popen[bytes], processes: list[psutil.Process]) -> tuple[float, float]:
    """Interrupt the recorder; return its processor time, s, and its peak memory, MB."""
    cpu, peak = 0.0, 0.0
    target = processes[-1] if len(processes) > 1 else processes[0]
    target.send_signal(signal.SIGINT)
    deadline = time.monotonic() + PATIENCE_SEC
    while recorder.poll() is None:
        with contextlib.suppress(psutil.Error, OSError, TypeError):
            used = [one.cpu_times() for one in processes if one.is_running()]
            cpu = max(cpu, sum(one.user + one.system for one in used))
            status = [Path(f"/proc/{one.pid}/status").read_text() for one in processes]
            peaks = [int(re.search(r"VmHWM:\s+(\d+) kB", text)[1]) for text in status]
            peak = max(peak, sum(peaks) / 1024)
        if time.monotonic() > deadline:
            raise TimeoutError("the recorder does not end")
        time.sleep(0.02)
    return cpu, peak


def _stored(context: Context, bag: Path, name: str) -> int:
    """Return how many messages were kept; remove them."""
    if name == "rosbag record":
        with rosbag.Bag(str(bag)) as opened:
            count = int(opened.get_message_count(TOPIC))
        bag.unlink()
        return count
    topic = context.server.store.getTopic(TOPIC)
    count = topic.countTopicData()
    context.server.store.removeTopic(TOPIC)
    return count
