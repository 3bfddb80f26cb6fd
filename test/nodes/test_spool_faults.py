# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recorders with a spool that are killed, or whose store is away: at most 1 s is lost, and told."""

from __future__ import annotations

import contextlib
import os
import random
import struct
import tempfile
import threading
import time
from pathlib import Path

import pytest
from conftest import MEMORY
from nodes.children import await_true, start_client, start_recorder
from nodes.raw_publisher import RawPublisher, header_of
from proxy import Proxy
from std_msgs.msg import UInt64
from suites import SUITE, sparing

from cassandra_ros.store.tables.registry import LossKind

pytestmark = pytest.mark.suite("all", "it kills or cuts something, and waits")

MOMENTS = {"test": 2, "all": 4, "campaign": 20}[SUITE]
"""Number of moments at which the recorder is killed."""
RATE_HZ = 400


class Numbers:
    """A publisher of numbers at a rate, which notes when it has sent each."""

    def __init__(self, publisher):
        self._publisher = publisher
        self.sent = []
        """Monotonic time at which each number was sent, s."""
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        while not self._stopped.wait(1 / RATE_HZ):
            number = len(self.sent)
            self.sent.append(time.monotonic())
            self._publisher.publish(struct.pack("<Q", number))

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *exc_info):
        self._stopped.set()
        self._thread.join()

    @property
    def longest_pause_sec(self):
        """The longest time between two of them, for which a busy machine let nothing run."""
        return max(later - before for before, later in zip(self.sent, self.sent[1:]))


def starved_sec(pid):
    """Time for which the threads of a process could run and a busy machine did not let them, s."""
    total_ns = 0
    for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        with contextlib.suppress(OSError):  # a thread that has ended meanwhile
            total_ns += int(path.read_text("ascii").split()[1])
    return total_ns / 1e9


@pytest.fixture
def one(roscore):
    with RawPublisher(roscore.uri, "/n", header_of(UInt64)) as publisher:
        yield publisher


@pytest.fixture
def memory(tmp_path):
    """A folder in memory, if there is one: a disk that others use may take a second to sync."""
    if not MEMORY.is_dir():
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_spool_", dir=MEMORY) as folder:
        yield Path(folder)


def by_run(rosCas):
    """The stored numbers by writer id, in the order of the rows."""
    found = {}
    for row in rosCas.getTopic("/n").rows():
        found.setdefault(row.seq >> 32, []).append(struct.unpack("<Q", row.wire)[0])
    return found


def left_in(spool):
    """Writer ids of the runs in a spool, whose folder the first run makes."""
    names = os.listdir(spool) if spool.is_dir() else ()
    return {int(name) for name in names if name.isdigit()}


@pytest.mark.fault
@pytest.mark.parametrize("format", sparing(["ros", "packed"], ["packed"], "campaign"))
def test_a_recorder_that_is_killed(
    roscore, cassandra, keyspace, rosCas, one, memory, format, record_property
):
    """With --journal at most 1 s is lost, nothing is doubled, and the next start says so."""
    chance = random.Random(os.urandom(8))
    spool = memory / "spool"
    words = ("/n", "--journal", "--spool-dir", spool, "--format", format)
    killed, output = {}, ""
    with Numbers(one) as numbers:
        for _ in range(MOMENTS):
            with start_recorder(roscore, cassandra, keyspace, *words) as child:
                child.await_line("recording 1 topic")
                before_sec = starved_sec(child.process.pid)
                one.await_subscribers()
                # A loaded machine may not have handed over the first message yet.
                await_true(lambda: left_in(spool).difference(killed))
                time.sleep(chance.uniform(0.0, 2.5))
                starved = starved_sec(child.process.pid) - before_sec
                at = time.monotonic()  # before: what is sent while this waits for the processor
                child.process.kill()
                child.wait()
            output += child.output
            (left,) = left_in(spool).difference(killed)
            killed[left] = at, max(0.0, starved)
            one.hang_up()
        with start_recorder(roscore, cassandra, keyspace, *words) as child:
            await_true(lambda: not set(os.listdir(spool)).intersection(map(str, killed)))
            assert child.end() == 0, child.output
        output += child.output
    stored, lost_sec, lost = by_run(rosCas), [], 0
    for writer, (at, starved) in killed.items():
        mine = stored.get(writer, [])
        assert mine == list(range(mine[0], mine[0] + len(mine)))
        missing = [n for n, t in enumerate(numbers.sent) if n > mine[-1] and t < at]
        lost_sec.append(at - numbers.sent[missing[0]] if missing else 0.0)
        lost += len(missing)
        assert lost_sec[-1] < 1.0 + numbers.longest_pause_sec + starved
        (loss,) = [each for each in rosCas.losses() if each.writer == writer]
        assert (loss.kind, loss.topic, loss.count) == (LossKind.KILLED, "/n", 0)
        assert f"run {run_of(rosCas, writer).name} was not ended" in output
        assert run_of(rosCas, writer).state == "interrupted"
    assert os.listdir(spool) == []
    record_property(
        "told",
        f"{format}: killed {len(killed)} times; of {sum(map(len, stored.values()))} stored and "
        f"{lost} lost messages at most {max(lost_sec):.2f} s of a run are lost, each told",
    )


def run_of(rosCas, writer):
    return next(run for run in rosCas.runs() if run.writer == writer)


@pytest.mark.fault
def test_a_robot_whose_store_never_came(roscore, cassandra, keyspace, rosCas, one, tmp_path):
    """It records from its first second; the next recorder stores everything."""
    spool = tmp_path / "spool"
    words = ("/n", "--spool-dir", spool, "--wait", "600", "-O", "alone")
    with Proxy(cassandra.host, cassandra.port) as proxy:
        proxy.cut()
        with start_recorder(roscore, proxy, keyspace, *words) as child:
            child.await_line("recording 1 topic")
            one.await_subscribers()
            one.publish(*(struct.pack("<Q", n) for n in range(3000)))
            child.await_line("messages (")
            with start_client(roscore) as client:
                await_true(lambda: client.call("/recorder/status")["spooled_messages"] == 3000)
                assert client.call("/recorder/status")["behind_seconds"] > 0
            assert child.end() == 0, child.output
        assert "3000 messages in the spool" in child.output
        one.hang_up()
        proxy.mend()
        with start_recorder(roscore, proxy, keyspace, *words[:3]) as child:
            child.await_line("run alone: 3000 messages of the spool are stored")
            assert child.end() == 0, child.output
    ((_, numbers),) = by_run(rosCas).items()
    assert numbers == list(range(3000))
    (run,) = [each for each in rosCas.runs() if each.name == "alone"]
    assert (run.state, run.stored, run.lost) == ("ended", {"/n": 3000}, {})
    assert rosCas.losses() == []


def test_what_belongs_to_another_keyspace_is_told(
    roscore, cassandra, keyspace, rosCas, one, tmp_path
):
    spool = tmp_path / "spool"
    words = ("/n", "--spool-dir", spool)
    with Proxy(cassandra.host, cassandra.port) as proxy:
        proxy.cut()
        with start_recorder(roscore, proxy, "elsewhere", *words, "--wait", "600") as child:
            child.await_line("recording 1 topic")
            one.await_subscribers().publish(struct.pack("<Q", 7))
            child.await_line("1 messages (")
            assert child.end() == 0, child.output
    one.hang_up()
    with start_recorder(roscore, cassandra, keyspace, *words) as child:
        line = child.await_line("stays in the spool")
        assert "it belongs to keyspace elsewhere at 127.0.0.1:" in line
        assert child.end() == 0, child.output
    assert len(os.listdir(spool)) == 1
