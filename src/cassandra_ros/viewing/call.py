# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One question of a browser: its parameters, read by the kinds that the route states."""

from __future__ import annotations

import math
import threading
from functools import cached_property, partial
from typing import Callable, Mapping, Sequence, TypeVar

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import InvalidKey, InvalidOption
from cassandra_ros.messages.stamps import written_time_ns
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.viewing.route import KEYSPACE, KINDS, Parameter, Route, Value
from cassandra_ros.viewing.shared import Shared
from cassandra_ros.viewing.viewer_settings import ViewerSettings

T = TypeVar("T")
_FLAGS = {"": True, "1": True, "true": True, "0": False, "false": False}


class Call:
    """What a handler is given.

    Args:
        shared: What all calls of this viewer have in common.
        route: The route that is asked.
        query: The texts of each parameter that is given, in their order.
        headers: Those of the request, their names in small letters.

    Attributes:
        method: GET or HEAD.
        headers: As given.
        gone: Is set once nobody waits for the answer any more: what takes long looks at it.
    """

    def __init__(
        self,
        shared: Shared,
        route: Route,
        query: Mapping[str, Sequence[str]],
        headers: Mapping[str, str],
        method: str = "GET",
    ) -> None:
        self._viewer = shared
        self._known = {each.name: each for each in (*route.parameters, KEYSPACE)}
        self._query = query
        self.headers = headers
        self.method = method
        self.gone = threading.Event()
        self._check_names(route.path)

    def _check_names(self, path: str) -> None:
        """Refuse what no parameter is called: a misspelt one must not be ignored."""
        for name in self._query:
            if name not in self._known and name != "token":
                known = ", ".join(self._known) or "none"
                raise InvalidOption(f"{path} has no parameter {name!r}; it has {known}")
        for name, parameter in self._known.items():
            if parameter.required and not any(self._query.get(name, ())):
                raise InvalidOption(f"{path} needs the parameter {name}: {parameter.summary}")

    @cached_property
    def _shared(self) -> Shared:
        """What calls on the same keyspace have in common; found on the handler's thread."""
        return self._viewer.of(self.text(KEYSPACE.name) or "")

    @property
    def store(self) -> RosCassandra:
        """The store, on the keyspace that is asked for; shared, and only read."""
        return self._shared.store

    @property
    def catalog(self) -> Catalog:
        """The topics of the keyspace that is asked for."""
        return self._shared.store.catalog

    @property
    def settings(self) -> ViewerSettings:
        """What the viewer was started with."""
        return self._viewer.settings

    def shared(self, make: Callable[[Catalog, ViewerSettings], T]) -> T:
        """Return what ``make`` made for this keyspace at its first call, as a cache."""
        return self._shared.get(make, partial(make, self.catalog, self.settings))

    def shared_by_all(self, make: Callable[[ViewerSettings], T]) -> T:
        """Return what ``make`` made for this viewer, whatever the keyspace, as a spool."""
        return self._viewer.get(make, partial(make, self.settings))

    def text(self, name: str) -> str | None:
        """Return a parameter of kind text; missing: its default."""
        return self._read(name, "text", str)

    def texts(self, name: str) -> tuple[str, ...] | None:
        """Return a parameter of kind texts, without empty ones; missing: its default."""
        parameter = self._parameter(name, "texts")
        given = self._query.get(name)
        if given is None:
            return _default(parameter, tuple)
        parts = (part.strip() for text in given for part in text.split(","))
        return tuple(part for part in parts if part)

    def lines(self, name: str) -> tuple[str, ...]:
        """Return a parameter of kind lines, without empty ones; missing: none."""
        self._parameter(name, "lines")
        return tuple(filter(None, self._query.get(name, ())))

    def time_ns(self, name: str) -> int | None:
        """Return a parameter of kind time, ns since 1970; missing: its default.

        Raises:
            InvalidOption: It is no time.
        """
        return self._read(name, "time", written_time_ns)

    def number(self, name: str) -> float | None:
        """Return a parameter of kind number; missing: its default.

        Raises:
            InvalidOption: It is no number, or not a finite one.
        """
        return self._read(name, "number", _read_number)

    def count(self, name: str) -> int | None:
        """Return a parameter of kind count; missing: its default.

        Raises:
            InvalidOption: It is no whole number from 0, or has more than 18 digits.
        """
        return self._read(name, "count", _read_count)

    def flag(self, name: str) -> bool:
        """Return a parameter of kind flag; missing: its default, or False.

        Raises:
            InvalidOption: It is neither true nor false.
        """
        return bool(self._read(name, "flag", _read_flag))

    def _parameter(self, name: str, kind: str) -> Parameter:
        parameter = self._known[name]
        if parameter.kind != kind:  # a mistake of ours, which the first test finds
            raise TypeError(f"parameter {name} is of kind {parameter.kind}, not {kind}")
        return parameter

    def _read(self, name: str, kind: str, read: Callable[[str], T]) -> T | None:
        """Return the value of a parameter that stands there once; read: raises ValueError."""
        parameter = self._parameter(name, kind)
        given = self._query.get(name)
        # A form that was left empty sends an empty text.
        if given is None or (kind != "flag" and given == [""]):
            return _default(parameter, read)
        if len(given) > 1:
            raise InvalidOption(f"{name} stands there {len(given)} times: give it once")
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
