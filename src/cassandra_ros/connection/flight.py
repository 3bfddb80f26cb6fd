# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Requests on their way, limited in number and bytes, sent again if that may help."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Callable

from cassandra.cluster import ResponseFuture
from cassandra.query import Statement

from cassandra_ros.connection.driver_errors import is_busy, is_passing
from cassandra_ros.connection.outage import Outage
from cassandra_ros.connection.paging import (
    BUSY_PAUSE_SEC,
    FIRST_PAUSE_SEC,
    LAST_PAUSE_SEC,
    LOOK_SEC,
    Patience,
)
from cassandra_ros.errors import StoreUnavailable

MAX_BYTES = 4 * 1024 * 1024
"""Maximum number of bytes on their way: eight chunks of large messages, or 16 batches. More is not
faster, and a server stops reading from an address that has sent it heap / 40 ahead."""
MAX_REQUESTS = 16

_GIVEN_UP = "the program is to end, and the store does not answer"

Outcome = Callable[["BaseException | None"], None]


@dataclass(eq=False)
class _Request:
    statement: Statement
    nbytes: int
    outcome: Outcome
    begun: float
    """Monotonic time at which the request was sent first, s."""
    pause: float = FIRST_PAUSE_SEC
    settled: bool = False


class Flight:
    """Sends idempotent statements without waiting for each answer. Thread-safe.

    The callback ``outcome`` of each statement is called once, on the driver's event thread or on
    the thread of a retry, with None or with the error after which the statement was given up. It
    must not block.
    """

    def __init__(
        self,
        send: Callable[[Statement], ResponseFuture],
        patience: Patience | None = None,
        outage: Outage | None = None,
    ) -> None:
        self._send = send
        self._patience = patience or Patience(60.0)
        self._outage = outage
        self._changed = threading.Condition()
        self._bytes = 0
        self._requests: set[_Request] = set()

    def submit(self, statement: Statement, nbytes: int, outcome: Outcome) -> None:
        """Send a statement of ``nbytes`` bytes.

        Blocks while too many bytes or requests are sent.
        """
        request = _Request(statement, nbytes, outcome, time.monotonic())
        try:
            with self._changed:
                # A statement larger than MAX_BYTES is sent when no other one is on its way.
                while self._requests and (
                    len(self._requests) >= MAX_REQUESTS or self._bytes + nbytes > MAX_BYTES
                ):
                    self._changed.wait(LOOK_SEC)
                    if self._is_over():
                        raise StoreUnavailable(_GIVEN_UP)
                self._requests.add(request)
                self._bytes += nbytes
            request.begun = time.monotonic()
            self._launch(request)
        except BaseException as exc:
            # Ctrl-C while waiting, or before the request was handed over.
            self._settle(request, exc)
            raise

    @property
    def nbytes(self) -> int:
        """Number of bytes on their way."""
        return self._bytes

    def wait(self) -> None:
        """Wait until every statement has its outcome."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: not self._requests, LOOK_SEC)
                if not self._requests:
                    return
                late = list(self._requests) if self._is_over() else []
            for request in late:
                self._settle(request, StoreUnavailable(_GIVEN_UP))

    def _is_over(self) -> bool:
        """Return whether the program has to end and the store does not answer."""
        return self._outage is not None and self._outage.left_sec <= 0

    def _launch(self, request: _Request) -> None:
        try:
            future = self._send(request.statement)
        except Exception as exc:  # noqa: BLE001 - told as its outcome
            self._failed(exc, request)
            return
        future.add_callbacks(
            callback=self._succeeded,
            callback_args=(request,),
            errback=self._failed,
            errback_args=(request,),
        )

    def _succeeded(self, _rows: object, request: _Request) -> None:
        self._patience.answered()
        if self._outage is not None:
            self._outage.answered()
        self._settle(request, None)

    def _failed(self, exc: BaseException, request: _Request) -> None:
        busy, now = is_busy(exc), time.monotonic()
        trying_sec = now - request.begun
        ends = now if self._is_over() else self._patience.ends(request.begun)
        if not (busy or is_passing(exc)) or now >= ends:
            self._settle(request, exc)
            return
        pause = BUSY_PAUSE_SEC
        if not busy:
            if self._outage is not None:
                self._outage.failed(exc, trying_sec)
            pause, request.pause = request.pause, min(2 * request.pause, LAST_PAUSE_SEC)
        # The request still holds its place in the budget, so its retry never has to wait for one.
        retry = threading.Timer(pause, self._launch, (request,))
        retry.daemon = True
        try:
            retry.start()
        except RuntimeError as no_thread:  # the process has its maximum number of threads
            self._settle(request, no_thread)

    def _settle(self, request: _Request, exc: BaseException | None) -> None:
        with self._changed:
            if request.settled:
                return
            request.settled = True
        try:
            request.outcome(exc)
        finally:
            with self._changed:
                if request in self._requests:
                    self._requests.remove(request)
                    self._bytes -= request.nbytes
                self._changed.notify_all()
