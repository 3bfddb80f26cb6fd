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
from nodes.children import Child, start_recorder

PUBLISHER = Path(__file__).with_name("load_publisher.py")
BUFFER_MB = 256
BESIDE_MB = 150
"""What a recorder may take besides its buffer."""


def peak_mb(pid):
    text = Path(f"/proc/{pid}/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+) kB", text)[1]) / 1024


@pytest.mark.long
@pytest.mark.parametrize(
    ("size", "count", "rate", "fmt"),
    [(0, 100_000, 10_000, "ros"), (2 << 20, 600, 30, "binary")],
    ids=["small", "images"],
)
def test_nothing_is_lost_under_load(
    roscore, cassandra, keyspace, rosCas, record_property, size, count, rate, fmt
):
    child = start_recorder(
        roscore, cassandra, keyspace, "/load", "--format", fmt, "-b", BUFFER_MB, "-O", "load"
    )
    with child:
        child.await_line("recording 1 topic")
        command = [sys.executable, PUBLISHER, roscore.uri, "/load", size, count, rate]
        with Child(command, roscore.env) as publisher:
            sent = publisher.await_line("sent ")
            assert publisher.wait(60) == 0
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
