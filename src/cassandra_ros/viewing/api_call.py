# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One request of a client, whose parameters are read by the kinds that the route declares."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace
from functools import cached_property, partial
from typing import Callable, Mapping, Sequence, TypeVar

from cassandra_ros.arguments import check_node, spellings
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.client.sql.statement_processes import StatementProcesses
from cassandra_ros.errors import CassandraRosError, InvalidKey, InvalidOption
from cassandra_ros.messages.stamps import Stamp, written_time_ns
from cassandra_ros.query.plan.pushdown import Watch, unwatched
from cassandra_ros.read import LAST_NS, TimeRange, Whose
from cassandra_ros.stores.fleet.fleet import Fleet
from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer
from cassandra_ros.stores.fleet.fleet_topic import find_topic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.overview.stored_ends import Ends, widest
from cassandra_ros.topics.overview.timeline.lanes import Picture, Timeline, View, window_of
from cassandra_ros.topics.overview.timeline.merged_pictures import merged_extent, merged_picture
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.viewing.route import KEYSPACE, KINDS, Parameter, Route, Value
from cassandra_ros.viewing.viewer_context import ViewerContext
from cassandra_ros.viewing.viewer_settings import ViewerSettings

T = TypeVar("T")
_FLAGS = {"": True, "1": True, "true": True, "0": False, "false": False}
TOPICS = Parameter("topics", "texts", "Names of topics; missing: all topics that can be read.")
NODES = Parameter("nodes", "texts", "nodeIDs of robots; missing: all robots.")
RUNS = Parameter("runs", "texts", "Names or writer ids of runs; missing: all runs.")
START = Parameter("start", "time", "First time, included.")
END = Parameter("end", "time", "Last time, included.")
TIME = Parameter("time", "time", "Time that is shown first.")
WHOLE_RANGE = (
    Parameter("start", "time", "First time, included; missing: that of the first message."),
    Parameter("end", "time", "Last time, included; missing: that of the last message."),
)
"""Time range of routes that take all messages without it."""


class ClientGone(CassandraRosError):
    """The client does not wait for the answer any more."""


class ApiCall:
    """One request, as it is given to a handler.

    Args:
        shared: The store, settings and caches of the viewer.
        route: The requested route.
        query: Values by parameter name, in the order of the request.
        headers: Headers of the request by name in lower case.

    Attributes:
        method: GET or HEAD.
        headers: As given.
        gone: Set when the client does not wait for the answer any more; long work checks it.
    """

    def __init__(
        self,
        shared: ViewerContext,
        route: Route,
        query: Mapping[str, Sequence[str]],
        headers: Mapping[str, str],
        method: str = "GET",
    ) -> None:
        self._viewer = shared
        self._known = {parameter.name: parameter for parameter in (*route.parameters, KEYSPACE)}
        self._query = query
        self.headers = headers
        self.method = method
        self.gone = threading.Event()
        self._check_names(route.path)

    def _check_names(self, path: str) -> None:
        """Refuse unknown parameters: a misspelt one must not be ignored."""
        for name in self._query:
            if name not in self._known and name != "token":
                names = ", ".join(self._known) or "none"
                raise InvalidOption(f"{path} has no parameter {name!r}; it has {names}")
        for name, parameter in self._known.items():
            if parameter.required and not any(self._query.get(name, ())):
                raise InvalidOption(f"{path} needs the parameter {name}: {parameter.summary}")

    @cached_property
    def _context(self) -> ViewerContext:
        """Store and caches of the requested keyspace; opened on the handler's thread."""
        return self._viewer.of(self.text(KEYSPACE.name) or "")

    @property
    def store(self) -> RosCassandra:
        """The store, open on the requested keyspace; shared by all calls, which only read."""
        return self._context.store

    @property
    def fleet(self) -> ViewedFleet:
        """The stores of a viewer of several stores."""
        context = self._context
        if not isinstance(context.source, Fleet):
            raise TypeError("the viewer shows one store")
        make = partial(ViewedFleet, context.source, self.settings.store_pause_sec)
        return context.get(ViewedFleet, make)

    @property
    def catalog(self) -> Catalog:
        """Topics of the requested keyspace."""
        return self._context.store.catalog

    @property
    def statements(self) -> StatementProcesses:
        """The processes for statements in SQL."""
        make = partial(StatementProcesses, self._viewer.store.cassandra)
        return self._viewer.get(StatementProcesses, make)

    @property
    def settings(self) -> ViewerSettings:
        """Settings of the viewer."""
        return self._viewer.settings

    def cached(self, make: Callable[[Catalog, ViewerSettings], T]) -> T:
        """Return the object that ``make`` returned for this keyspace at the first call."""
        return self._context.get(make, partial(make, self.catalog, self.settings))

    def cached_by_viewer(self, make: Callable[[ViewerSettings], T]) -> T:
        """Return the object that ``make`` returned for this viewer at the first call."""
        return self._viewer.get(make, partial(make, self.settings))

    def text(self, name: str) -> str | None:
        """Return a parameter of kind text; its default if it is missing."""
        return self._read(name, "text", str)

    def texts(self, name: str) -> tuple[str, ...] | None:
        """Return a parameter of kind texts, without empty ones; its default if it is missing."""
        parameter = self._parameter(name, "texts")
        given = self._query.get(name)
        if given is None:
            return _default(parameter, tuple)
        values = (value.strip() for text in given for value in text.split(","))
        return tuple(value for value in values if value)

    def lines(self, name: str) -> tuple[str, ...]:
        """Return a parameter of kind lines, without empty ones; () if it is missing."""
        self._parameter(name, "lines")
        return tuple(filter(None, self._query.get(name, ())))

    def time_ns(self, name: str) -> int | None:
        """Return a parameter of kind time, ns since 1970; its default if it is missing.

        Raises:
            InvalidOption: The value is not a time.
        """
        return self._read(name, "time", written_time_ns)

    def stamp(self, name: str) -> Stamp | None:
        """Return a parameter of kind time as a Stamp; raises like ``time_ns``.

        As a key, a small integer would mean seconds.
        """
        ns = self.time_ns(name)
        return None if ns is None else Stamp.from_ns(ns)

    def time_range(self) -> TimeRange:
        """Return the time range of the parameters ``start`` and ``end``; raises like ``time_ns``.

        A missing one is the limit of all times.
        """
        start, end = self.time_ns("start"), self.time_ns("end")
        return TimeRange(start or 0, LAST_NS if end is None else end)

    def number(self, name: str) -> float | None:
        """Return a parameter of kind number; its default if it is missing.

        Raises:
            InvalidOption: The value is not a finite number.
        """
        return self._read(name, "number", _read_number)

    def count(self, name: str) -> int | None:
        """Return a parameter of kind count; its default if it is missing.

        Raises:
            InvalidOption: The value is not a whole number from 0, or has more than 18 digits.
        """
        return self._read(name, "count", _read_count)

    def flag(self, name: str) -> bool:
        """Return a parameter of kind flag; its default, or False, if it is missing.

        Raises:
            InvalidOption: The value is neither true nor false.
        """
        return bool(self._read(name, "flag", _read_flag))

    def watch(self) -> None:
        """Raise ClientGone if the client has disconnected; see Watch."""
        if self.gone.is_set():
            raise ClientGone("the client does not wait for the answer any more")

    def _parameter(self, name: str, kind: str) -> Parameter:
        parameter = self._known[name]
        if parameter.kind != kind:  # an error in a handler, found by its first test
            raise TypeError(f"parameter {name} is of kind {parameter.kind}, not {kind}")
        return parameter

    def _read(self, name: str, kind: str, read: Callable[[str], T]) -> T | None:
        """Return the value of a parameter that may be given once.

        Args:
            read: Converts the text; raises ValueError.
        """
        parameter = self._parameter(name, kind)
        given = self._query.get(name)
        # An empty field of a form sends an empty text.
        if given is None or (kind != "flag" and given == [""]):
            return _default(parameter, read)
        if len(given) > 1:
            raise InvalidOption(f"{name} is given {len(given)} times: give it once")
        try:
            return read(given[0])
        except InvalidKey as exc:
            raise InvalidOption(f"{name} {exc}") from exc
        except ValueError as exc:
            raise InvalidOption(f"{name} {given[0][:80]!r}: give {KINDS[kind]}") from exc


def _default(parameter: Parameter, read: Callable[[str], T]) -> T | None:
    """Return the default, which is of the type that ``read`` returns."""
    value: Value = parameter.default
    return value  # type: ignore[return-value]


def _read_number(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(text)
    return number


def _read_count(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 18):
        raise ValueError(text)
    return int(text)


def _read_flag(text: str) -> bool:
    if text.lower() not in _FLAGS:
        raise ValueError(text)
    return _FLAGS[text.lower()]


def tables_of(call: ApiCall) -> list[TopicTable]:
    """Return the tables of the parameter ``topics``.

    Raises:
        TopicNotFound: A topic is not stored.
    """
    return call.catalog.tables(call.texts("topics") or None)


def whose_of(call: ApiCall) -> Whose:
    """Return the robots and runs of the parameters ``nodes`` and ``runs``.

    Raises:
        RunNotFound: The keyspace has no such run.
        InvalidName: A nodeID is not valid.
    """
    nodes, names = call.texts("nodes"), call.texts("runs")
    runs = call.catalog.keyspace.runs
    writers = [runs.writers(name) or frozenset() for name in names or ()]
    return Whose(
        tuple(map(check_node, nodes)) if nodes else None,
        frozenset().union(*writers) if names else None,
    )


class ViewedFleet:
    """The stores of a viewer. Thread-safe.

    A page sends many requests: a store that did not answer one of them is not asked again for some
    seconds, so that not each request waits for it. It is in ``missing`` of their answers.

    Args:
        fleet: The stores; the caller closes them.
        pause_sec: Minimum time until a store that did not answer is asked again, s.
    """

    def __init__(self, fleet: Fleet, pause_sec: float) -> None:
        self._fleet, self._pause_sec = fleet, pause_sec
        self._away: dict[str, tuple[float, str]] = {}
        """Stores that did not answer: until when they are not asked, and why."""
        self._timelines: dict[str, Timeline] = {}
        self._mutex = threading.Lock()

    @property
    def names(self) -> list[str]:
        """Names of all stores."""
        return [store.name for store in self._fleet.stores]

    def begin(self, watch: Watch = unwatched) -> FleetAnswer:
        """Return the stores for one request.

        Args:
            watch: See FleetAnswer.

        Raises:
            StoreUnavailable: No store answers.
        """
        now = time.monotonic()
        with self._mutex:
            away = {name: reason for name, (until, reason) in self._away.items() if until > now}
        all_stores = self._fleet.stores
        stores = FleetAnswer(all_stores, away if len(away) < len(all_stores) else None, watch)
        self.note(stores)
        return stores

    def note(self, stores: FleetAnswer) -> None:
        """Note which stores did not answer a request that asked them.

        A request may end long after it lost a store, so the pause begins when it did.
        """
        now = time.monotonic()
        with self._mutex:
            for name, lost in stores.lost_at.items():
                self._away.setdefault(name, (lost + self._pause_sec, stores.reasons[name]))
            self._away = {name: absence for name, absence in self._away.items() if absence[0] > now}

    def picture(
        self, stores: FleetAnswer, view: View, gone: threading.Event | None = None
    ) -> Picture:
        """Draw the timeline of all stores; raises like ``names_in``."""
        names = names_in(stores, view.topics)

        def drawn(store_view: View) -> list[Picture]:
            def draw(store: str) -> Picture:
                timeline = self._timeline(store, stores.catalogs[store])
                return timeline.picture(replace(store_view, topics=names[store]), gone)

            return list(stores.each({store: store for store in names}, draw).values())

        if view.start is not None and view.end is not None:
            pictures = drawn(view)
            return merged_picture(pictures, merged_extent(pictures))
        # Without a time range each store would draw its own.
        extent = merged_extent(drawn(replace(view, cells=1, detail=False)))
        start, end = window_of(view, extent) or (None, None)
        return merged_picture(drawn(replace(view, start=start, end=end)), extent)

    def ends(self, stores: FleetAnswer) -> Ends | None:
        """Return the times of the first and the last message, ns; None = no message."""
        names = {store: store for store in stores.catalogs}
        ends = stores.each(names, lambda s: self._timeline(s, stores.catalogs[s]).ends())
        return widest(ends.values())

    def _timeline(self, store: str, catalog: Catalog) -> Timeline:
        with self._mutex:
            return self._timelines.setdefault(store, Timeline(catalog))


def names_in(
    stores: FleetAnswer, topics: Sequence[str] | None
) -> Mapping[str, Sequence[str] | None]:
    """Return for each store the names of those topics that it has; None = all topics.

    Raises:
        TopicNotFound: No store has one of the topics, and all stores answer.
    """
    if topics is None:
        return dict.fromkeys(stores.catalogs)
    names_by_store: dict[str, list[str]] = {}
    for store, names in stores.each(stores.catalogs, lambda c: c.names(fresh=False)).items():
        stored = (next(filter(names.__contains__, spellings(topic)), "") for topic in topics)
        names_by_store[store] = [name for name in stored if name]
    for topic in () if stores.partial else topics:
        if not any(set(spellings(topic)).intersection(names) for names in names_by_store.values()):
            find_topic(stores, topic)  # its error names the stores
    return {store: names for store, names in names_by_store.items() if names}
