# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The time that a player publishes, without a node: how often, and when it ends."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest
from rosgraph_msgs.msg import Clock

from cassandra_ros.nodes.outlets import Outlets

SEC = 10**9


class Closed:
    """An event that is never waited for: it notes how long it would have been."""

    def __init__(self, rounds):
        self._rounds, self.waits = rounds, []

    def wait(self, seconds):
        self.waits.append(seconds)
        return len(self.waits) == self._rounds


@pytest.mark.parametrize("hz", [0.001, 0.0001])
def test_the_time_is_told_as_often_as_asked(hz):
    told, closed = [], Closed(5)
    outlets = SimpleNamespace(
        _clock=SimpleNamespace(publish_wire=told.append),
        _clock_lock=threading.Lock(),
        _closed=closed,
    )
    Outlets.run_clock(outlets, lambda: 7 * SEC, hz)
    # The nth is due n periods after the beginning, whatever the machine does meanwhile.
    for number, seconds in enumerate(closed.waits, 1):
        assert (number - 0.5) / hz < seconds <= number / hz
    assert [Clock().deserialize(wire).clock.to_nsec() for wire in told] == 5 * [7 * SEC]
