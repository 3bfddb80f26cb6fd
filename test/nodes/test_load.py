# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recording under load: nothing is lost, and memory stays bounded. Rates are printed."""

from __future__ import annotations

import re
import signal
import sys
import time
from pathlib import Path

import pytest
from nodes.children import Child, await_true, start_client, start_recorder

PUBLISHER = Path(__file__).with_name("load_publisher.py")
BUFFER_MB = 256
BESIDE_MB = 150
"""Maximum memory of a recorder in addition to its buffer, bytes."""


def peak_mb(pid):
    text = Path(f"/proc/{pid}/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+) kB", text)[1]) / 1024


@pytest.mark.suite("all", "seconds at a high rate")
@pytest.mark.parametrize(
    ("size", "count", "rate", "fmt", "rounds"),
    [
        (0, 100_000, 10_000, "ros", 1),
        (0, 200_000, 20_000, "packed", 1),
        # More than the buffer takes; of each round it takes all, however slow the store is.
        (2 << 20, 240, 10, "binary", 3),
    ],
    ids=["small", "packed", "images"],
)
def test_nothing_is_lost_under_load(
    roscore, cassandra, keyspace, rosCas, record_property, size, count, rate, fmt, rounds
):
    child = start_recorder(
        roscore, cassandra, keyspace, "/load", "--format", fmt, "-b", BUFFER_MB, "-O", "load"
    )
    with child, start_client(roscore) as client:
        child.await_line("recording 1 topic")
        command = [sys.executable, PUBLISHER, roscore.uri, "/load", size, count // rounds, rate]
        for _ in range(rounds):
            await_true(lambda: client.call("/recorder/status")["held_bytes"] < BUFFER_MB << 16)
            with Child(command, roscore.env) as publisher:
                sent = publisher.await_line("sent ")
                assert publisher.wait() == 0
        began = time.monotonic()
        peak = peak_mb(child.process.pid)
        child.process.send_signal(signal.SIGINT)
        status = child.wait(300)
        seconds = time.monotonic() - began
    assert status == 0, child.output
    record_property(
        "told", f"{sent}; stored {seconds:.1f} s later; peak {peak:.0f} MB resident, format {fmt}"
    )
    assert peak <= BUFFER_MB + BESIDE_MB
    (info,) = rosCas.info(["/load"])
    assert info.count == count
    if not size:
        numbers = [
            int.from_bytes(row.wire[:4], "little") for row in rosCas.getTopic("/load").rows()
        ]
        assert numbers == list(range(count))


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
def test_what_was_stored_in_blocks_survives_a_kill(roscore, cassandra, keyspace, rosCas):
    """A recorder is killed with SIGKILL: all messages older than a block are stored and whole."""
    options = ("--format", "packed", "--block-age", "0.2", "-O", "killed")
    child = start_recorder(roscore, cassandra, keyspace, "/load", *options)
    with child:
        child.await_line("recording 1 topic")
        command = [sys.executable, PUBLISHER, roscore.uri, "/load", 0, 3000, 3000]
        with Child(command, roscore.env) as publisher:
            publisher.await_line("sent ")
            # The recording has not ended: they are stored because they are old enough.
            await_true(lambda: sum(info.count for info in rosCas.info()) == 3000)
            assert publisher.wait() == 0
        command = [sys.executable, PUBLISHER, roscore.uri, "/load", 0, 100_000, 3000]
        with Child(command, roscore.env) as publisher:
            await_true(lambda: rosCas.info(["/load"])[0].count > 5000)
            child.process.send_signal(signal.SIGKILL)
            child.wait()
            publisher.end()  # it unregisters: other tests use the same master
    numbers = [int.from_bytes(row.wire[:4], "little") for row in rosCas.getTopic("/load").rows()]
    first, second = numbers[:3000], numbers[3000:]
    assert first == list(range(3000))
    assert second == list(range(len(second))) and len(second) > 2000
    assert rosCas.info(["/load"])[0].count == len(numbers)
