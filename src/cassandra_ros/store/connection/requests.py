# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Requests with retries: one by one, page by page (``PagedRead``), many on their way (``Flight``).

A read that failed goes on after the last row that it got.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Callable, Iterable, Iterator, Optional, Sequence, Tuple, TypeVar, Union

from cassandra.cluster import ResponseFuture, ResultSet
from cassandra.query import Statement

from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.store.connection.driver_errors import (
    DRIVER_ERRORS,
    is_busy,
    is_passing,
    translate,
)
from cassandra_ros.store.connection.outage import Outage

_log = logging.getLogger(__name__)

REQUEST_TIMEOUT_SEC = 20.0
"""Maximum time to wait for the answer of one request, s."""
RETRY_SEC = 30.0
"""How long a request that fails is repeated, unless the caller says otherwise, s."""
BUSY_PAUSE_SEC = 0.002
"""Pause before a request that our own full socket buffers refused is sent again, s."""
FIRST_PAUSE_SEC = 0.1
LAST_PAUSE_SEC = 5.0
"""Pauses before other requests are sent again, doubled from the first to the last, s."""
LOOK_SEC = 0.2
"""Interval at which a wait checks whether the program has to end, s."""
GROWTH = 4
"""Ratio between the sizes of two consecutive pages, for reads that start with a small page."""

RawRow = Tuple[Optional[bytes], ...]
"""Columns of a row as the bytes that Cassandra stores; None = null."""
IsRefused = Callable[[BaseException], bool]
"""Returns whether an error of the driver is raised at once as it is, without a retry."""
OnPage = Callable[[Sequence[RawRow]], None]
"""Called on the driver's thread with the rows of each page as soon as they arrive, perhaps after
the thread that waits for the page got it. It must not block."""
_T = TypeVar("_T")


class Patience:
    """Time limit of requests and their retries, which can be shortened at any time. Thread-safe.

    Args:
        seconds: Time limit from the beginning of a request, s; inf = no limit.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._hurried: float | None = None
        """Monotonic time at which hurry was called, s; None = it was not."""
        self._hurry_sec = 0.0
        """Argument of hurry; valid once _hurried is set."""
        self._answered = 0.0
        """Monotonic time of the last answer since hurry was called, s."""

    def hurry(self, seconds: float) -> None:
        """Limit the retries of present requests to ``seconds`` from now, and those of later ones.

        A later request is retried for ``seconds`` from its beginning if the store answers any
        request meanwhile, otherwise from the last answer or from this call. So while the store is
        silent it is given up at its first failure. A later call counts only with fewer seconds.
        """
        if self._hurried is None or seconds < self._hurry_sec:
            self._hurry_sec = seconds  # before _hurried, because other threads call ends
            self._hurried = time.monotonic()

    def answered(self) -> None:
        """Note that the store has answered a request."""
        if self._hurried is not None:
            self._answered = time.monotonic()

    def ends(self, start: float) -> float:
        """Return until when a request that began at ``start`` is retried; both monotonic, s."""
        if self._hurried is None:
            return start + self._seconds
        heard = max(self._hurried, self._answered)
        latest = min(max(self._hurried, start), heard) + self._hurry_sec
        return min(start + self._seconds, latest)


Seconds = Union[float, Patience]
"""How long a request is repeated: a fixed time, s, or one that can be shortened meanwhile."""


def retried(
    what: str,
    call: Callable[[], _T],
    *,
    seconds: Seconds = RETRY_SEC,
    refused: IsRefused | None = None,
    outage: Outage | None = None,
) -> _T:
    """Make an idempotent request; repeat it for ``seconds`` while it fails with what may pass.

    Args:
        what: What the request does, for the error text.
        outage: Is told of failures and of the answer. Its ``limit_sec`` limits ``seconds``, and the
            retries end with the waits of the program.

    Raises:
        CassandraRosError: A retry cannot help, or the time is over.
        One of DRIVER_ERRORS: ``refused`` says that it is not to be repeated.
    """
    start = time.monotonic()
    next_pause = FIRST_PAUSE_SEC
    is_logged = False
    while True:
        ended = _ended(outage)
        try:
            answer = call()
            if outage is not None:
                outage.answered()
            return answer
        except DRIVER_ERRORS as exc:
            if refused is not None and refused(exc):
                raise
            pause = BUSY_PAUSE_SEC if is_busy(exc) else next_pause
            now = time.monotonic()
            trying_sec = now - start
            ends = seconds.ends(start) if isinstance(seconds, Patience) else start + seconds
            if outage is not None:
                ends = min(ends, start + outage.limit_sec)
            over = outage is not None and outage.left_sec <= 0
            if not is_passing(exc) or now + pause > ends or over:
                nodes = outage.nodes() if outage is not None else ""
                raise translate(exc, what, nodes) from exc
            if not is_busy(exc):
                if outage is not None:
                    outage.failed(exc, trying_sec)
                elif not is_logged:
                    _log.warning("%s; trying again", translate(exc, what))
                is_logged = True
                next_pause = min(2 * next_pause, LAST_PAUSE_SEC)
        if _pause(pause, outage, ended):
            next_pause = FIRST_PAUSE_SEC


def _ended(outage: Outage | None) -> int:
    """Return the number of outages that are over."""
    return 0 if outage is None else outage.ended


def _pause(
    seconds: float,
    outage: Outage | None,
    ended: int,
    is_over: Callable[[], bool] = bool,  # bool() is False
) -> bool:
    """Wait before a request that failed is sent again.

    The wait is shorter if the waits of the program have to end, or the store answers again.

    Args:
        ended: Number of outages that were over before the request failed.
        is_over: Returns whether the time of the request is over meanwhile.

    Returns:
        Whether an outage has ended since the request failed.
    """
    ends = time.monotonic() + seconds
    while (
        (rest_sec := ends - time.monotonic()) > 0
        and (outage is None or outage.left_sec > 0)
        and _ended(outage) == ended
        and not is_over()
    ):
        time.sleep(min(rest_sec, LOOK_SEC))
    return _ended(outage) != ended


def sent_ahead(requests: Iterable[_T], count: int) -> Iterator[_T]:
    """Yield requests in order, while at most ``count`` of them are on their way.

    Args:
        requests: Taking a request from this iterator sends it.
    """
    queue: deque[_T] = deque()
    for request in requests:
        queue.append(request)
        if len(queue) >= count:
            yield queue.popleft()
    yield from queue


def await_answer(future: ResponseFuture, outage: Outage | None = None) -> ResultSet:
    """Wait for the answer of a request that was sent without a timer, and return it.

    The wait ends after REQUEST_TIMEOUT_SEC, or the outage's ``limit_sec`` if that is less, or when
    the waits of the program have to end. Then the request is ended as by the driver's timer. With
    that timer each request would wake the driver's thread. Nothing is retried or noted here.

    Args:
        outage: Tells how long a read may wait, and when the waits of the program have to end.

    Raises:
        OperationTimedOut: No answer came in time.
        One of DRIVER_ERRORS: The server or the driver reports it.
    """
    limit_sec = REQUEST_TIMEOUT_SEC if outage is None else outage.limit_sec
    ends = time.monotonic() + min(REQUEST_TIMEOUT_SEC, limit_sec)
    while not future._event.wait(LOOK_SEC):
        if time.monotonic() >= ends or (outage is not None and outage.left_sec <= 0):
            future._on_timeout()
            break
    return future.result()


class PagedRead:
    """A read of raw rows, in one page or many; it is sent when the object is made.

    Args:
        statement_from: Returns the statement that reads the rows after a row; None = from the
            beginning. If a later page fails, the rest is read by it, so no row comes twice.
        first_rows: Number of rows of the first page. Each further page has GROWTH times as many,
            up to the statement's page size; until then no page is requested ahead. 0 = all pages
            have the statement's size.
        refused, outage: See ``retried``.

    Attributes:
        more: Whether there are further pages after the one that was read last.
    """

    def __init__(
        self,
        send: Callable[[Statement], ResponseFuture],
        statement_from: Callable[[RawRow | None], Statement],
        what: str,
        refused: IsRefused | None = None,
        on_page: OnPage | None = None,
        first_rows: int = 0,
        outage: Outage | None = None,
    ) -> None:
        self._send = send
        self._outage = outage
        self._statement_from = statement_from
        self._what = what
        self._refused = refused
        self._on_page = on_page
        self._small_rows = first_rows
        """Number of rows of the next page while pages are small; 0 = the statement's page size."""
        self._last: RawRow | None = None
        self._last_page: Sequence[RawRow] = ()
        """The page that was yielded last; empty = _last is up to date."""
        self.more = True
        self._has_failed = False
        """Whether the request of the page failed, so that it must be sent again."""
        self._future = self._ask()

    @property
    def last(self) -> RawRow | None:
        """Last row of the pages that ``pages`` has yielded; None = no row."""
        if self._last_page:  # not earlier: the page may not be cut into rows yet
            self._last, self._last_page = self._last_page[-1], ()
        return self._last

    def _ask(self) -> ResponseFuture:
        """Send the statement that reads the rows after the last one."""
        statement = self._statement_from(self.last)
        if self._small_rows:
            if self._small_rows < statement.fetch_size:
                statement.fetch_size = self._small_rows
            else:
                self._small_rows = 0
        future = self._send(statement)
        if self._on_page is not None:
            future.add_callback(self._on_page)
        return future

    def _result(self) -> Sequence[RawRow]:
        """Wait for the present page; after a failure request what follows the last row first."""
        if self._has_failed:
            self._future = self._ask()
            self._has_failed = False
        try:
            rows: Sequence[RawRow] = await_answer(self._future, self._outage).current_rows
            self.more = self._future.has_more_pages
            return rows
        except DRIVER_ERRORS:
            self._has_failed = True
            raise

    def page(self) -> Sequence[RawRow]:
        """Wait for the page that was requested; raises like retried."""
        return retried(self._what, self._result, refused=self._refused, outage=self._outage)

    def pages(self, *, ahead: bool = True) -> Iterator[Sequence[RawRow]]:
        """Yield the pages, of which some may be empty.

        Args:
            ahead: Request the next page before a page is yielded, unless pages are still small.
        """
        while self.more:
            page = self.page()
            is_ahead = ahead and not self._small_rows
            if self.more and is_ahead:
                self._future.start_fetching_next_page()
            if page:
                self._last_page = page
            yield page
            if self.more and self._small_rows and page:
                # A page of another size is another statement, from the last row on.
                self._small_rows *= GROWTH
                self._future = self._ask()
            elif self.more and not is_ahead:
                self._future.start_fetching_next_page()

    def rows(self, *, ahead: bool = True) -> Iterator[RawRow]:
        """Yield the rows of all pages."""
        for page in self.pages(ahead=ahead):
            yield from page


MAX_SENT_BYTES = 4 * 1024 * 1024
"""Maximum number of bytes on their way: eight chunks of large messages, or 16 batches. More is not
faster, and a server stops reading from an address that has sent it heap / 40 ahead."""
MAX_REQUESTS = 16
"""Maximum number of requests on their way."""

_GIVEN_UP = "the program is to end, and the store does not answer"

Outcome = Callable[["BaseException | None"], None]
"""Takes None if a statement was acknowledged, else the error after which it was given up."""


@dataclass(eq=False)
class _Request:
    """A statement of a Flight."""

    statement: Statement
    nbytes: int
    outcome: Outcome
    begun: float
    """Monotonic time at which the request was sent first, s."""
    pause: float = FIRST_PAUSE_SEC
    """Pause before its next retry, s."""
    settled: bool = False
    """Whether its outcome was told. What is heard of it later has no effect."""


class Flight:
    """Sends idempotent statements without waiting for each answer. Thread-safe.

    The callback ``outcome`` of each statement is called once, with None or with the error after
    which the statement was given up: on the driver's event thread, on the thread of a retry, or on
    the thread that calls ``submit`` or ``wait``, with the locks that this thread holds. It must not
    block.

    Args:
        patience: How long a statement is retried; None = 60 s.
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
        """Requests on their way, or waiting for a retry, whose callbacks have not returned."""

    def submit(self, statement: Statement, nbytes: int, outcome: Outcome) -> None:
        """Send a statement of ``nbytes`` bytes; block while too many bytes or requests are sent.

        Raises:
            StoreUnavailable: The program has to end, and the store does not answer. ``outcome``
                gets every error that is raised here, too.
        """
        request = _Request(statement, nbytes, outcome, time.monotonic())
        try:
            with self._changed:
                # A statement larger than MAX_SENT_BYTES is sent when no other one is on its way.
                while self._requests and (
                    len(self._requests) >= MAX_REQUESTS or self._bytes + nbytes > MAX_SENT_BYTES
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
            self._end_request(request, exc)
            raise

    @property
    def nbytes(self) -> int:
        """Number of bytes on their way."""
        return self._bytes

    def wait(self) -> None:
        """Wait until every statement has its outcome and the callbacks have returned."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: not self._requests, LOOK_SEC)
                if not self._requests:
                    return
                late = list(self._requests) if self._is_over() else []
            for request in late:
                self._end_request(request, StoreUnavailable(_GIVEN_UP))

    def _is_over(self) -> bool:
        """Return whether the program has to end and the store does not answer."""
        return self._outage is not None and self._outage.left_sec <= 0

    def _launch(self, request: _Request) -> None:
        try:
            future = self._send(request.statement)
        except Exception as exc:  # noqa: BLE001 - told as its outcome
            self._fail(exc, request)
            return
        future.add_callbacks(
            callback=self._succeed,
            callback_args=(request,),
            errback=self._fail,
            errback_args=(request,),
        )

    def _succeed(self, _rows: object, request: _Request) -> None:
        self._patience.answered()
        if self._outage is not None:
            self._outage.answered()
        self._end_request(request, None)

    def _fail(self, exc: BaseException, request: _Request) -> None:
        """Send a request that failed again after a pause, or give it up."""
        busy, now, ended = is_busy(exc), time.monotonic(), _ended(self._outage)
        trying_sec = now - request.begun
        ends = now if self._is_over() else self._patience.ends(request.begun)
        if not (busy or is_passing(exc)) or now >= ends:
            self._end_request(request, exc)
            return
        pause = BUSY_PAUSE_SEC
        if not busy:
            if self._outage is not None:
                self._outage.failed(exc, trying_sec)
            pause, request.pause = request.pause, min(2 * request.pause, LAST_PAUSE_SEC)
        # The request still holds its place in the budget, so its retry never has to wait for one.
        retry = threading.Thread(target=self._retry, args=(request, pause, ended), daemon=True)
        try:
            retry.start()
        except RuntimeError as no_thread:  # the process has its maximum number of threads
            self._end_request(request, no_thread)

    def _retry(self, request: _Request, pause: float, ended: int) -> None:
        """Send a request again after a pause, see ``_pause``, or when its time is over."""

        def is_over() -> bool:
            return time.monotonic() >= self._patience.ends(request.begun)

        if _pause(pause, self._outage, ended, is_over):
            request.pause = FIRST_PAUSE_SEC
        self._launch(request)

    def _end_request(self, request: _Request, exc: BaseException | None) -> None:
        """Tell the outcome of a request, if that was not done, and make room for others.

        The callback is called without our lock. ``wait`` returns only after it.
        """
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
