# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Requests with retries; a read that failed goes on after the last row that it got."""

from __future__ import annotations

import logging
import time
from collections import deque
from typing import Callable, Iterable, Iterator, Optional, Sequence, Tuple, TypeVar, Union

from cassandra.cluster import ResponseFuture, ResultSet
from cassandra.query import Statement

from cassandra_ros.connection.driver_errors import DRIVER_ERRORS, is_busy, is_passing, translate
from cassandra_ros.connection.outage import Outage

_log = logging.getLogger(__name__)

REQUEST_TIMEOUT_SEC = 20.0
RETRY_SEC = 30.0
BUSY_PAUSE_SEC = 0.002
FIRST_PAUSE_SEC = 0.1
LAST_PAUSE_SEC = 5.0
LOOK_SEC = 0.2
"""Interval at which a wait checks whether the program has to end, s."""
GROWTH = 4
"""Ratio between the sizes of two consecutive pages, for reads that start with a small page."""

RawRow = Tuple[Optional[bytes], ...]
"""Columns of a row as the bytes that Cassandra stores; None = null."""
IsRefused = Callable[[BaseException], bool]
"""Returns whether an error of the driver is raised at once as it is, without a retry."""
OnPage = Callable[[Sequence[RawRow]], None]
"""Called on the driver's thread with the rows of each page as soon as they arrive."""
_T = TypeVar("_T")


class Patience:
    """Time limit of requests and their retries, which can be shortened at any time. Thread-safe.

    Args:
        seconds: Time limit from the beginning of a request, s; inf = no limit.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._hurried: float | None = None
        self._left = self._answered = 0.0

    def hurry(self, seconds: float) -> None:
        """Limit all present and later requests to ``seconds`` from now; a later call may cut it.

        A request is given up at its first failure if the store has not answered for this time.
        """
        if self._hurried is None or seconds < self._left:
            self._left, self._hurried = seconds, time.monotonic()

    def answered(self) -> None:
        """Note that the store has answered a request."""
        if self._hurried is not None:
            self._answered = time.monotonic()

    def ends(self, begun: float) -> float:
        """Return until when a request that began at ``begun`` is retried; both monotonic, s."""
        if self._hurried is None:
            return begun + self._seconds
        heard = max(self._hurried, self._answered)
        latest = min(max(self._hurried, begun), heard) + self._left
        return min(begun + self._seconds, latest)


Seconds = Union[float, Patience]


def retried(
    what: str,
    call: Callable[[], _T],
    *,
    seconds: Seconds = RETRY_SEC,
    refused: IsRefused | None = None,
    outage: Outage | None = None,
) -> _T:
    """Make an idempotent request; repeat it for ``seconds`` while it fails with what may pass.

    Raises:
        CassandraRosError: A retry cannot help, or the time is over.
    """
    begun, later, told = time.monotonic(), FIRST_PAUSE_SEC, False
    while True:
        try:
            found = call()
            if outage is not None:
                outage.answered()
            return found
        except DRIVER_ERRORS as exc:
            if refused is not None and refused(exc):
                raise
            pause = BUSY_PAUSE_SEC if is_busy(exc) else later
            now = time.monotonic()
            trying_sec = now - begun
            ends = seconds.ends(begun) if isinstance(seconds, Patience) else begun + seconds
            over = outage is not None and outage.left_sec <= 0
            if not is_passing(exc) or now + pause > ends or over:
                nodes = outage.nodes() if outage is not None else ""
                raise translate(exc, what, nodes) from exc
            if not is_busy(exc):
                if outage is not None:
                    outage.failed(exc, trying_sec)
                elif not told:
                    _log.warning("%s; trying again", translate(exc, what))
                told = True
                later = min(2 * later, LAST_PAUSE_SEC)
        _rest(pause, outage)


def _rest(seconds: float, outage: Outage | None) -> None:
    """Sleep for ``seconds``, or until the waits of the program have to end."""
    ends = time.monotonic() + seconds
    while (left := ends - time.monotonic()) > 0 and (outage is None or outage.left_sec > 0):
        time.sleep(min(left, LOOK_SEC))


def sent_ahead(requests: Iterable[_T], count: int) -> Iterator[_T]:
    """Yield requests in order, ``count`` of them on their way.

    Taking one from the input sends it.
    """
    sent: deque[_T] = deque()
    for request in requests:
        sent.append(request)
        if len(sent) >= count:
            yield sent.popleft()
    yield from sent


def answered(future: ResponseFuture, outage: Outage | None = None) -> ResultSet:
    """Wait for the answer of a request that was sent without a timer, REQUEST_TIMEOUT_SEC at most.

    With the driver's own time limit each request would wake the driver's thread for a timer.

    Args:
        outage: Tells when the waits of the program have to end.
    """
    ends = time.monotonic() + REQUEST_TIMEOUT_SEC
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
        outage: Notes answers and failures.

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
        self._small = first_rows
        self._last: RawRow | None = None
        self._read: Sequence[RawRow] = ()
        self.more = True
        self._failed = False
        self._future = self._ask()

    @property
    def last(self) -> RawRow | None:
        """Last row that was read."""
        if self._read:  # not earlier: the page may not be cut into rows yet
            self._last, self._read = self._read[-1], ()
        return self._last

    def _ask(self) -> ResponseFuture:
        statement = self._statement_from(self.last)
        if self._small:
            self._small = self._small if self._small < statement.fetch_size else 0
            statement.fetch_size = self._small or statement.fetch_size
        future = self._send(statement)
        if self._on_page is not None:
            future.add_callback(self._on_page)
        return future

    def _result(self) -> Sequence[RawRow]:
        if self._failed:
            self._future, self._failed = self._ask(), False
        try:
            rows: Sequence[RawRow] = answered(self._future, self._outage).current_rows
            self.more = self._future.has_more_pages
            return rows
        except DRIVER_ERRORS:
            self._failed = True
            raise

    def page(self) -> Sequence[RawRow]:
        """Wait for the page that was requested; raises like retried."""
        return retried(self._what, self._result, refused=self._refused, outage=self._outage)

    def pages(self, *, ahead: bool = True) -> Iterator[Sequence[RawRow]]:
        """Yield the pages; with ``ahead`` the next one is requested before a page is yielded."""
        while self.more:
            page = self.page()
            early = ahead and not self._small
            if self.more and early:
                self._future.start_fetching_next_page()
            if page:
                self._read = page
            yield page
            if self.more and self._small and page:
                self._small *= GROWTH
                self._future = self._ask()
            elif self.more and not early:
                self._future.start_fetching_next_page()

    def rows(self, *, ahead: bool = True) -> Iterator[RawRow]:
        """Yield the rows of all pages."""
        for page in self.pages(ahead=ahead):
            yield from page
