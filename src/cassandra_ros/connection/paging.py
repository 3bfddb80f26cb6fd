# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Requests that are asked again where a failure may pass; reads go on behind their last row."""

from __future__ import annotations

import logging
import time
from collections import deque
from typing import (
    Callable,
    Deque,
    Iterable,
    Iterator,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
    Union,
)

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
"""How often a wait looks whether the program is to end, s."""
GROWTH = 4
"""How much larger a page is than the one before, where little was wanted at first."""

RawRow = Tuple[Optional[bytes], ...]
"""The columns of a row as the bytes that Cassandra stores; None = null."""
Refused = Callable[[BaseException], bool]
"""Tells of an error of the driver that it is to be raised as it is, at once."""
OnPage = Callable[[Sequence[RawRow]], None]
"""Called with the rows of each page as soon as they are here, on the driver's thread."""
_T = TypeVar("_T")


class Patience:
    """How long requests are tried, which may be shortened while they are. Thread-safe.

    Args:
        seconds: From when a request begins; inf = as long as it takes.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._hurried: Optional[float] = None
        self._left = self._answered = 0.0

    def hurry(self, seconds: float) -> None:
        """Try what begins, or has begun, no longer than so many seconds from now; once.

        All is given up at its first failure when the store has answered nothing for so long.
        """
        if self._hurried is None:
            self._left, self._hurried = seconds, time.monotonic()

    def answered(self) -> None:
        """Note that the store has answered."""
        if self._hurried is not None:
            self._answered = time.monotonic()

    def ends(self, begun: float) -> float:
        """Tell until when a request is tried that began at a time; monotonic."""
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
    refused: Refused | None = None,
    outage: Outage | None = None,
) -> _T:
    """Make an idempotent request, for so many seconds again while it fails with what may pass.

    Raises:
        CassandraRosError: Another try cannot help, or the time is up.
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
    """Sleep for so long, or until the waits of the program are to end."""
    ends = time.monotonic() + seconds
    while (left := ends - time.monotonic()) > 0 and (outage is None or outage.left_sec > 0):
        time.sleep(min(left, LOOK_SEC))


def sent_ahead(requests: Iterable[_T], count: int) -> Iterator[_T]:
    """Yield requests, which are sent when they are taken, with so many on their way at once."""
    sent: Deque[_T] = deque()
    for request in requests:
        sent.append(request)
        if len(sent) >= count:
            yield sent.popleft()
    yield from sent


def answered(future: ResponseFuture, outage: Outage | None = None) -> ResultSet:
    """Wait for the answer of a request that was sent without a time limit, as if it had one.

    The driver's own limit is a timer, for which each request wakes the driver's thread.

    Args:
        outage: Says when the waits of the program are to end.
    """
    ends = time.monotonic() + REQUEST_TIMEOUT_SEC
    while not future._event.wait(LOOK_SEC):
        if time.monotonic() >= ends or (outage is not None and outage.left_sec <= 0):
            future._on_timeout()
            break
    return future.result()


class Asked:
    """A request that is on its way from the start, of raw rows in one page or many.

    Args:
        statement_from: Makes the statement, given the last row that was read (None = none yet):
            where a later page fails the rest is asked for from there, so no row comes twice.
        first_rows: Rows of the first page; each further one has GROWTH times as many, up to those
            of the statement, and is not asked for ahead before that. 0 = all are that large.
        outage: Hears of answers and failures.

    Attributes:
        more: There are pages behind the one that was read.
    """

    def __init__(
        self,
        send: Callable[[Statement], ResponseFuture],
        statement_from: Callable[[Optional[RawRow]], Statement],
        what: str,
        refused: Optional[Refused] = None,
        on_page: Optional[OnPage] = None,
        first_rows: int = 0,
        outage: Optional[Outage] = None,
    ) -> None:
        self._send = send
        self._outage = outage
        self._statement_from = statement_from
        self._what = what
        self._refused = refused
        self._on_page = on_page
        self._small = first_rows
        self._last: Optional[RawRow] = None
        self._read: Sequence[RawRow] = ()
        self.more = True
        self._failed = False
        self._future = self._ask()

    @property
    def last(self) -> Optional[RawRow]:
        """The last row that was read."""
        if self._read:  # not before: the page may not be cut into rows yet
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
        """Wait for the page that is asked for; raises as retried does."""
        return retried(self._what, self._result, refused=self._refused, outage=self._outage)

    def pages(self, *, ahead: bool = True) -> Iterator[Sequence[RawRow]]:
        """Yield the pages; ahead: the next is asked for before one is yielded, not behind it."""
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
