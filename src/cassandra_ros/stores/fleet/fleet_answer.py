# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The answer of a fleet to one question: the stores that are asked, and those that do not answer.

Everything that a store is asked passes one of the methods here, which note that it does not answer.
A store that was noted is asked nothing more for this answer; the next question asks it again.
"""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, islice
from typing import Callable, Dict, Generic, Iterable, Iterator, List, Mapping, Sequence, TypeVar

from cassandra_ros.errors import (
    AccessDenied,
    CassandraRosError,
    ConnectionFailed,
    KeyspaceNotFound,
    StoreUnavailable,
    TopicNotFound,
    UnsupportedSchema,
)
from cassandra_ros.query.plan.pushdown import Watch, unwatched
from cassandra_ros.stores.fleet.fleet_books import FleetBooks
from cassandra_ros.stores.fleet.fleet_store import FleetStore
from cassandra_ros.topics.catalog import Catalog

_T = TypeVar("_T")
_S = TypeVar("_S")

Missing = Dict[str, str]
"""Name of a store → why it did not answer, in words, with the number of messages that it had listed
before and that are left out; there may be more of these."""
AWAY = (
    *(StoreUnavailable, ConnectionFailed, AccessDenied, UnsupportedSchema),
    *(KeyspaceNotFound, TopicNotFound),
)
"""Errors after which a store is missing in an answer. The topic of a TopicNotFound
was there when the answer began; a caller that looks for a topic catches the error itself."""


class FleetAnswer:
    """The stores that one question is asked. Thread-safe.

    Args:
        stores: All stores of the fleet.
        away: Stores that are not asked, because they did not answer a moment ago → why.
        watch: Called for each row that is read, in any thread; what it raises ends the reading.

    Attributes:
        missing: The stores that did not answer, or not to the end; grows while rows are read.
        reasons: Name of such a store → only why.
        lost_at: The stores that were asked and did not answer → when, time.monotonic(), s.
        catalogs: Name of each store that answered first → its topics, in the order of the fleet. A
            store that goes away later stays here, and is passed over because it is missing.

    Raises:
        StoreUnavailable: No store answers.
    """

    def __init__(
        self,
        stores: Sequence[FleetStore],
        away: Mapping[str, str] | None = None,
        watch: Watch = unwatched,
    ) -> None:
        self._stores = {store.name: store for store in stores}
        self._watch = watch
        self.missing: Missing = dict(away or {})
        self.reasons: Missing = dict(self.missing)
        self.lost_at: dict[str, float] = {}
        self._left_out: dict[str, int] = {}
        """Name of a store → number of messages that are left out."""
        self._mutex = threading.Lock()
        self._books: FleetBooks | None = None
        self.catalogs: dict[str, Catalog] = self.each(self._stores, _catalog)
        if not self.catalogs:
            raise StoreUnavailable(f"no store of the fleet answers: {told(self.missing)}")

    @property
    def partial(self) -> bool:
        """Whether a store did not answer, so that its messages may be missing."""
        return bool(self.missing)

    @property
    def books(self) -> FleetBooks:
        """The books of the stores; which tables they tell of is read when it is needed first."""
        if self._books is None:
            believed = all(store.reads_quorum for store in self._stores.values())
            self._books = FleetBooks(self, believed=believed)
        return self._books

    def each(self, values: Mapping[str, _S], work: Callable[[_S], _T]) -> dict[str, _T]:
        """Call a function with a value of each store, at the same time, a thread each.

        Args:
            values: Name of a store → value.
            work: The function. One of AWAY means that the store does not answer; other errors are
                raised here.

        Returns:
            The results of the stores that answer, by name, in the order of ``values``.
        """
        names = [name for name in values if name not in self.missing]

        def ask(name: str) -> list[_T]:
            try:
                return [work(values[name])]
            except AWAY as exc:
                self.lose(name, exc)
                return []

        if len(names) < 2:
            answers = list(map(ask, names))
        else:
            with ThreadPoolExecutor(len(names), "cassandra_ros-fleet") as pool:
                answers = list(pool.map(ask, names))
        return {name: result for name, results in zip(names, answers) for result in results}

    def rows(self, streams: Mapping[str, Callable[[], Iterator[_T]]]) -> dict[str, Iterator[_T]]:
        """Begin to read a stream of each store, at the same time.

        A stream ends where its store does not answer any more.

        Args:
            streams: Name of a store → function that begins to read; it is called later if there is
                only one.
        """
        guarded = {name: self._until_lost(name, begin) for name, begin in streams.items()}
        if len(guarded) < 2:
            return guarded
        first = self.each(guarded, lambda rows: list(islice(rows, 1)))
        return {name: chain(rows, guarded[name]) for name, rows in first.items()}

    def _until_lost(self, name: str, begin: Callable[[], Iterator[_T]]) -> Iterator[_T]:
        """Yield what a store gives until it does not answer, or is missing for another reason."""
        try:
            for row in begin():
                if name in self.missing:
                    return
                self._watch()
                yield row
        except AWAY as exc:
            self.lose(name, exc)

    def lose(self, name: str, exc: CassandraRosError) -> None:
        """Note that a store does not answer; the first error stays its reason.

        Raises:
            CassandraRosError: The error, if the fleet was closed: then no store is to blame.
        """
        if self._stores[name].closed:
            raise exc
        with self._mutex:
            self.lost_at.setdefault(name, time.monotonic())
            self.reasons.setdefault(name, " ".join(str(exc).split()))
            self.missing.setdefault(name, self.reasons[name])

    def leave_out(self, name: str) -> None:
        """Count a message that a missing store had listed before, and that no other has."""
        with self._mutex:
            self._left_out[name] = self._left_out.get(name, 0) + 1
            count = self._left_out[name]
            which = f"at least {count} message{'s' * (count > 1)} that no other store has"
            self.missing[name] = f"{self.reasons[name]}; left out: {which}"

    def probed(self, exc: CassandraRosError) -> None:
        """Note which stores do not answer, after an error of an unknown store.

        Raises:
            CassandraRosError: The error, if all stores answer that answered before.
            StoreUnavailable: No store answers.
        """
        before = len(self.missing)
        self.catalogs = self.each(self.catalogs, _renew_catalog)
        if len(self.missing) == before:
            raise exc
        if not self.catalogs:
            raise StoreUnavailable(f"no store of the fleet answers: {told(self.missing)}") from exc


def _catalog(store: FleetStore) -> Catalog:
    """Return the topics of a store, connected and read anew; raises one of AWAY."""
    return _renew_catalog(store.catalog())


def _renew_catalog(catalog: Catalog) -> Catalog:
    """Read anew which topics a store has; return the same catalog.

    So a topic or field that is not known now is not one that was stored a moment ago.
    """
    catalog.keyspace.schema.tables(fresh=True)
    return catalog


def told(missing: Missing) -> str:
    """Return in words which stores do not answer."""
    return "; ".join(f"{name} ({reason})" for name, reason in missing.items())


class FleetRows(Iterator[_T], Generic[_T]):
    """What a fleet answers, read when the iterator is advanced. For one thread.

    Attributes:
        columns: Names of the columns of a statement's result, else empty.
        missing: The stores that did not answer so far, or not to the end → why.
        answer: The stores that are asked.
    """

    def __init__(
        self, rows: Iterator[_T], answer: FleetAnswer, columns: Sequence[str] = ()
    ) -> None:
        self._rows, self.answer = rows, answer
        self.columns = tuple(columns)
        self.missing = answer.missing

    def __iter__(self) -> Iterator[_T]:
        return self._rows

    def __next__(self) -> _T:
        # For next(rows), as with the rows of one store; a loop takes the iterator itself.
        return next(self._rows)

    @property
    def partial(self) -> bool:
        """Whether a store did not answer so far. It can become true until the last row."""
        return bool(self.missing)

    def mapped(self, work: Callable[[Iterator[_T]], Iterator[_S]]) -> FleetRows[_S]:
        """Return the results of a function of the rows, with the same ``missing``.

        This object must not be read any more.
        """
        return FleetRows(work(self._rows), self.answer)

    def listed(self, work: Callable[[_T], _S]) -> FleetList[_S]:
        """Return a list of the results of a function of each row."""
        return FleetList(map(work, self._rows), self.answer, self.columns)


class FleetList(List[_T]):
    """What a fleet answers, as a list.

    Attributes:
        columns: Names of the columns of a statement's result, else empty.
        missing: The stores that did not answer, or not to the end → why.
    """

    def __init__(
        self, items: Iterable[_T], answer: FleetAnswer, columns: Sequence[str] = ()
    ) -> None:
        super().__init__(items)
        self.columns = tuple(columns)
        self.missing = answer.missing

    @property
    def partial(self) -> bool:
        """Whether a store did not answer, so that its messages may be missing."""
        return bool(self.missing)


def settled(answer: FleetAnswer, make: Callable[[], _T]) -> _T:
    """Return what a function makes; call it again without a store that went away meanwhile.

    Args:
        make: Asks the stores, not only by ``each`` and ``rows``: it may raise one of AWAY.

    Raises:
        CassandraRosError: ``make`` raised it although all stores answer, or it is not in AWAY.
    """
    while True:
        try:
            return make()
        except AWAY as exc:
            answer.probed(exc)
