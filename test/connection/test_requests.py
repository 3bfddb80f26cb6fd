# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Pauses between attempts double up to a maximum, however long the store is away; a clock of ours.

After hours without a store it is asked again soon, and before that it is not asked all the time.
"""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import pytest
from cassandra import OperationTimedOut
from cassandra.connection import ConnectionBusy

from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.store.connection import outage as outage_module
from cassandra_ros.store.connection import requests, sessions
from cassandra_ros.store.connection.outage import Outage
from cassandra_ros.store.connection.requests import LOOK_SEC, Flight, Patience, retried
from cassandra_ros.store.connection.sessions import Link, Links

DOUBLED_SEC = [0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 5.0, 5.0]
"""Pauses between the first attempts of a request."""


class Clock:
    """A monotonic clock that a sleep moves on."""

    def __init__(self):
        self.now = 1000.0
        self._calls = []
        self.at_each_step = bool  # bool() has no effect

    def monotonic(self):
        return self.now

    def calls_at(self, now, call):
        """Call a function in the first sleep that ends then or later."""
        self._calls.append((now, call))

    def sleep(self, seconds):
        self.now += seconds
        self.at_each_step()
        for now, call in self._calls:
            if now <= self.now:
                call()
        self._calls = [(now, call) for now, call in self._calls if now > self.now]

    time, strftime, localtime = time.time, time.strftime, time.localtime


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    for module in (requests, sessions):
        monkeypatch.setattr(module, "time", clock)
    return clock


class Store:
    """A store that answers a request at a time, and fails with an error before it."""

    def __init__(self, clock, since, error):
        self._clock, self._since, self._error = clock, since, error
        self.asked = []

    def ask(self, *_):
        self.asked.append(self._clock.now)
        if self._clock.now < self._since:
            raise self._error
        return "answer"

    @property
    def pauses(self):
        return [later - before for before, later in zip(self.asked, self.asked[1:])]


def test_a_request_that_waits_is_repeated_at_least_every_5_s(clock):
    store = Store(clock, clock.now + 3600, OperationTimedOut("late"))
    assert retried("asking", store.ask, seconds=7200) == "answer"
    assert store.pauses[: len(DOUBLED_SEC)] == pytest.approx(DOUBLED_SEC)
    assert max(store.pauses) == pytest.approx(5.0)


def test_a_request_is_given_up_when_its_time_is_over(clock):
    began, store = clock.now, Store(clock, clock.now + 3600, OperationTimedOut("late"))
    with pytest.raises(StoreUnavailable):
        retried("asking", store.ask, seconds=30)
    assert began + 20 < clock.now <= began + 30


def test_a_full_socket_is_waited_for_without_longer_pauses(clock):
    store = Store(clock, clock.now + 0.1, ConnectionBusy("full"))
    assert retried("asking", store.ask) == "answer"
    assert max(store.pauses) == pytest.approx(0.002)


def by_retried(store, outage, seconds):
    try:
        retried("asking", store.ask, seconds=seconds, outage=outage)
    except StoreUnavailable as exc:
        return exc.__cause__


def by_flight(store, outage, seconds):
    outcomes = []
    flight = Flight(store.ask, Patience(seconds), outage)
    flight.submit(None, 1, outcomes.append)
    flight.wait()
    (outcome,) = outcomes
    return outcome


def test_a_statement_on_its_way_is_sent_again_at_least_every_5_s(clock):
    store = Store(clock, float("inf"), OperationTimedOut("late"))
    assert isinstance(by_flight(store, None, 120), OperationTimedOut)
    assert store.pauses[: len(DOUBLED_SEC)] == pytest.approx(DOUBLED_SEC)
    assert max(store.pauses) == pytest.approx(5.0)


@pytest.mark.parametrize("ask", [by_retried, by_flight])
def test_a_request_is_sent_again_at_once_when_the_store_answers_another(clock, monkeypatch, ask):
    """After an outage nothing waits for the rest of its pause: messages may be lost meanwhile."""
    monkeypatch.setattr(outage_module, "time", clock)
    outage = Outage("here")
    store = Store(clock, float("inf"), OperationTimedOut("late"))
    back = clock.now + sum(DOUBLED_SEC[:8]) + 1.0  # 4 s before the request would be sent again
    clock.calls_at(back, outage.answered)
    assert isinstance(ask(store, outage, 60), OperationTimedOut)
    sooner, *later = store.asked[8:]
    assert sooner < back < later[0] <= back + 2 * LOOK_SEC
    pauses = [after - before for before, after in zip(later, later[1:])]
    assert pauses[:7] == pytest.approx(DOUBLED_SEC[:7]), "it may not be back for good"


def test_a_statement_is_given_up_as_soon_as_its_time_is_shortened(clock):
    """A recorder that ends leaves it in the spool: the user does not wait for the next attempt."""
    store, patience = Store(clock, float("inf"), OperationTimedOut("late")), Patience(3600)
    outcomes = []
    flight = Flight(store.ask, patience)
    hurried = clock.now + sum(DOUBLED_SEC[:8]) + 1.0  # 4 s before it would be sent again
    clock.calls_at(hurried, lambda: patience.hurry(0.0))
    flight.submit(None, 1, outcomes.append)
    flight.wait()
    assert [type(each) for each in outcomes] == [OperationTimedOut]
    assert hurried <= store.asked[-1] <= hurried + 2 * LOOK_SEC


@pytest.mark.parametrize("ask", [by_retried, by_flight])
def test_a_request_that_fails_alone_keeps_its_pauses(clock, monkeypatch, ask):
    monkeypatch.setattr(outage_module, "time", clock)
    outage = Outage("here")
    store = Store(clock, float("inf"), OperationTimedOut("late"))
    clock.at_each_step = outage.answered  # others are answered all the time
    assert isinstance(ask(store, outage, 60), OperationTimedOut)
    assert store.pauses[: len(DOUBLED_SEC)] == pytest.approx(DOUBLED_SEC)


def test_a_new_session_is_tried_at_least_every_30_s(clock, monkeypatch):
    """A session that has ended is replaced half a minute after the store is back, or sooner."""
    ended = SimpleNamespace(is_shutdown=True, get_pools=tuple, shutdown=lambda: None)
    tried = []

    def accepts(place):
        tried.append(clock.now)
        return False

    monkeypatch.setattr(sessions, "_accepts", accepts)
    links = Links(lambda: Link(ended, ended, ended), lambda link: None, [("h", 1)], "h")
    for _ in range(600):
        links.failed(0.0)
        for thread in threading.enumerate():
            if thread.name == "cassandra_ros-session":
                thread.join()
        clock.sleep(0.5)
    links.close()
    pauses = [later - before for before, later in zip(tried, tried[1:])]
    assert pauses == [1, 2, 4, 8, 16] + 8 * [30]
