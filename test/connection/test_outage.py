# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is logged of an outage: its beginning, each minute of it, and its end."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest
from cassandra import OperationTimedOut

from cassandra_ros.store.connection import outage as outage_module
from cassandra_ros.store.connection.outage import GRACE_SEC, REPEAT_SEC, Outage


@pytest.fixture
def clock(monkeypatch):
    """The monotonic clock of outages, which the test moves on."""
    clock = SimpleNamespace(now=0.0)
    moved = SimpleNamespace(
        monotonic=lambda: clock.now,
        time=time.time,
        strftime=time.strftime,
        localtime=time.localtime,
    )
    monkeypatch.setattr(outage_module, "time", moved)
    return clock


def test_each_outage_is_told_from_its_beginning_to_its_end(clock, caplog):
    outage = Outage("here")
    for begin in (100.0, 110.0):  # the second one soon after the first
        for since in (0.0, GRACE_SEC):
            clock.now = begin + since
            outage.failed(OperationTimedOut("late"), since)
        assert outage.seconds == GRACE_SEC
        clock.now += 1
        outage.answered()
        assert outage.seconds == 0
        first, last = (record.getMessage() for record in caplog.records)
        assert first.startswith("the store at here has not answered since ") and "late" in first
        assert last == "the store at here answers again after 3 s"
        caplog.clear()


def test_a_short_silence_is_not_told_and_a_long_one_every_minute(clock, caplog):
    outage = Outage("here")
    outage.failed(OperationTimedOut("late"), 0.0)
    clock.now += GRACE_SEC / 2
    assert not outage.is_current
    outage.failed(OperationTimedOut("late"), GRACE_SEC / 2)
    outage.answered()
    assert caplog.records == []
    for second in range(int(GRACE_SEC + 2 * REPEAT_SEC) + 1):
        clock.now = 1000.0 + second
        outage.failed(OperationTimedOut("late"), second)
    assert ["still" in record.getMessage() for record in caplog.records] == [False, True, True]


def test_an_outage_lasts_from_the_first_failure_whether_it_was_logged_or_not(clock, caplog):
    outage = Outage("here")
    clock.now = 100.0
    outage.failed(OperationTimedOut("late"), 0.0)
    clock.now += GRACE_SEC + 1  # the next attempt is still on its way
    assert caplog.records == []
    assert outage.seconds > GRACE_SEC and outage.is_current
    outage.answered()
    assert outage.seconds == 0 and not outage.is_current
