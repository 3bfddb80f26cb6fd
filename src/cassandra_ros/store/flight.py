# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Requests in the air, bounded in number and bytes, sent again where that may help."""

from __future__ import annotations

import heapq
import logging
import threading
import time
from dataclasses import dataclass
from typing import Callable

from cassandra.cluster import ResponseFuture
from cassandra.query import Statement

from cassandra_ros.errors import ConnectionFailed
from cassandra_ros.store.driver_errors import DRIVER_ERRORS, is_busy, is_passing
from cassandra_ros.store.paging import BUSY_PAUSE_SEC, FIRST_PAUSE_SEC, LAST_PAUSE_SEC

_log = logging.getLogger(__name__)

MAX_BYTES = 2 * 1024 * 1024
"""More is no faster, and a server refuses to read on when one address sends it heap / 40 ahead."""
MAX_REQUESTS = 16

Outcome = Callable[["BaseException | None"], None]


@dataclass(eq=False)
class _Request:
    statement: Statement
    nbytes: int
    outcome: Outcome
    deadline: float
    pause: float = FIRST_PAUSE_SEC
    settled: bool = False
    counted: bool = False


class Flight:
    """Sends idempotent statements without waiting for each answer. Thread-safe.

    Args:
        send: Sends a statement and returns the driver's future.
        give_up_after_sec: How long one statement is tried.

    The outcome of each statement is told once, on the driver's event thread or on the retry
    thread: None, or the error after which it was given up. It must not block.
    """

    def __init__(
        self, send: Callable[[Statement], ResponseFuture], give_up_after_sec: float = 60.0
    ) -> None:
        self._send = send
        self._give_up = give_up_after_sec
        self._changed = threading.Condition()
        self._bytes = 0
        self._requests = 0
        self._late: list[tuple[float, int, _Request]] = []
        self._late_changed = threading.Condition()
        self._retries = 0
        self._thread: threading.Thread | None = None
        self._closed = False

    def submit(self, statement: Statement, nbytes: int, outcome: Outcome) -> None:
        """Send a statement; blocks while too much is in the air.

        Args:
            nbytes: Its size. One that is over the bound alone is sent when nothing else is.
        """
        request = _Request(statement, nbytes, outcome, time.monotonic() + self._give_up)
        try:
            with self._changed:
                while self._requests and (
                    self._requests >= MAX_REQUESTS or self._bytes + nbytes > MAX_BYTES
                ):
                    self._changed.wait()
                request.counted = True
                self._requests += 1
                self._bytes += nbytes
            request.deadline = time.monotonic() + self._give_up
            self._launch(request)
        except BaseException as exc:
            # Ctrl-C while waiting, or before the request was handed over.
            self._settle(request, exc)
            raise

    def wait(self) -> None:
        """Return when every statement has its outcome."""
        with self._changed:
            while self._requests:
                self._changed.wait()

    def close(self) -> None:
        """Wait, then end the retry thread; a second call is harmless."""
        self.wait()
        with self._late_changed:
            self._closed = True
            self._late_changed.notify()
        if self._thread is not None:
            self._thread.join()

    def _launch(self, request: _Request) -> None:
        try:
            future = self._send(request.statement)
        except (*DRIVER_ERRORS, ConnectionFailed) as exc:
            self._failed(exc, request)
            return
        future.add_callbacks(
            callback=self._succeeded,
            callback_args=(request,),
            errback=self._failed,
            errback_args=(request,),
        )

    def _succeeded(self, _rows: object, request: _Request) -> None:
        self._settle(request, None)

    def _failed(self, exc: BaseException, request: _Request) -> None:
        now = time.monotonic()
        busy = is_busy(exc)
        if not (busy or is_passing(exc)) or now > request.deadline:
            self._settle(request, exc)
            return
        if busy:
            due = now + BUSY_PAUSE_SEC
        else:
            _log.warning("a write failed and is tried again: %s", exc)
            due = now + request.pause
            request.pause = min(2 * request.pause, LAST_PAUSE_SEC)
        with self._late_changed:
            self._retries += 1
            heapq.heappush(self._late, (due, self._retries, request))
            if self._thread is None:
                self._thread = threading.Thread(
                    target=self._retry, name="cassandra_ros-retry", daemon=True
                )
                self._thread.start()
            self._late_changed.notify()

    def _settle(self, request: _Request, exc: BaseException | None) -> None:
        with self._changed:
            if request.settled:
                return
            request.settled = True
        try:
            request.outcome(exc)
        finally:
            with self._changed:
                if request.counted:
                    self._requests -= 1
                    self._bytes -= request.nbytes
                self._changed.notify_all()

    def _retry(self) -> None:
        while True:
            with self._late_changed:
                while not self._late or self._late[0][0] > time.monotonic():
                    if self._closed:
                        return
                    timeout = self._late[0][0] - time.monotonic() if self._late else None
                    self._late_changed.wait(timeout)
                request = heapq.heappop(self._late)[2]
            # Its place in the budget is still held, so this never blocks on itself.
            try:
                self._launch(request)
            except Exception as exc:  # noqa: BLE001 - told as its outcome; the thread goes on
                self._settle(request, exc)
