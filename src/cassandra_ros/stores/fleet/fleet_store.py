# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A store of a fleet: its place and login, from a text or a section of a file, and its connection.

A file of stores has a section for each, named as the store is called::

    [husky]
    place = 10.0.0.7:9042/ros
    credentials = ~/.cassandra/husky
"""

from __future__ import annotations

import os
import threading
from concurrent.futures import Future
from concurrent.futures import TimeoutError as NotDone
from dataclasses import dataclass
from typing import Sequence

from cassandra_ros.arguments import check_list
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import ConnectionFailed, InvalidOption
from cassandra_ros.store.connection.address import DEFAULT_KEYSPACE, read_address
from cassandra_ros.store.connection.cassandra import is_quorum
from cassandra_ros.store.connection.login import read_sections
from cassandra_ros.topics.catalog import Catalog

_SETTINGS = ("place", "cqlshrc", "credentials")
"""Settings of a section; if ``place`` is missing, the section's name is the place."""


@dataclass(frozen=True)
class StoreAddress:
    """Address of a store, and the files with the login."""

    name: str
    """Name by which the fleet calls it."""
    host: str
    port: int
    keyspace: str
    cqlshrc: str | None = None
    credentials: str | None = None
    """Files with the login, as in class Cassandra; None = cqlsh's."""


def read_places(
    names: Sequence[str],
    file: str | None = None,
    keyspace: str = DEFAULT_KEYSPACE,
    cqlshrc: str | None = None,
    credentials: str | None = None,
) -> list[StoreAddress]:
    """Return the stores of a fleet.

    Args:
        names: Each is the name of a section of the file, or HOST[:PORT][/KEYSPACE].
        file: File of stores; None = no file.
        keyspace: Keyspace of stores that name none.
        cqlshrc, credentials: Files with the login for stores that name none; None = cqlsh's.

    Raises:
        InvalidOption: A name is not of this form, is given twice, or the file is not valid.
    """
    sections = read_sections(os.path.expanduser(file or ""), "stores", must_exist=True)
    places: dict[str, StoreAddress] = {}
    for name in check_list("stores", names, "['home', 'husky:9042']"):
        settings = dict(sections[name]) if sections.has_section(name) else {}
        unknown = sorted(set(settings).difference(_SETTINGS))
        if unknown:
            raise InvalidOption(
                f"[{name}] of {file} has {unknown[0]!r:.80}; there are {', '.join(_SETTINGS)}"
            )
        if name in places:
            raise InvalidOption(f"store {name} is given twice")
        host, port, space = read_address(settings.get("place", name), keyspace)
        login = (settings.get("cqlshrc", cqlshrc), settings.get("credentials", credentials))
        places[name] = StoreAddress(name, host, port, space, *login)
    if not places:
        raise InvalidOption("a fleet has at least one store: give ['home', 'husky:9042']")
    _refuse_same(list(places.values()))
    return list(places.values())


def _refuse_same(places: Sequence[StoreAddress]) -> None:
    """Raise InvalidOption if two stores have one host, port and keyspace."""
    seen: dict[tuple[str, int, str], str] = {}
    for place in places:
        other = seen.setdefault((place.host, place.port, place.keyspace), place.name)
        if other != place.name:
            raise InvalidOption(f"stores {other} and {place.name} are the same place")


class FleetStore:
    """A store that is connected when it is first asked, and again later if that failed.

    Safe to share between threads: they wait for one connection.

    Args:
        place: Where it is.
        consistency: Name of the consistency level of its reads.
        answer_sec: Maximum time to wait for a connection, and for each answer, s.

    Attributes:
        name: Name by which the fleet calls it.
        closed: Whether the fleet was closed.
        reads_quorum: Whether it finds all that a quorum has acknowledged.
    """

    def __init__(self, place: StoreAddress, consistency: str, answer_sec: float) -> None:
        self.name = place.name
        self.closed = False
        self._place = place
        self._consistency = consistency
        self.reads_quorum = is_quorum(consistency)
        self._answer_sec = answer_sec
        self._opening: Future[RosCassandra] | None = None
        """The connection, or the attempt to make it; None = it was not asked yet."""
        self._mutex = threading.Lock()

    def __repr__(self) -> str:
        place = self._place
        return f"<FleetStore {self.name}: {place.host}:{place.port}/{place.keyspace}>"

    def catalog(self) -> Catalog:
        """Return the topics of the store; connect first if it is not connected.

        The attempt goes on after this has failed for lack of time; the next call waits for it.

        Raises:
            ConnectionFailed: It does not answer in time, it refuses the login, or the fleet is
                closed.
            CassandraRosError: As RosCassandra raises.
        """
        opening = self._begin_opening()
        try:
            return opening.result(self._answer_sec).catalog
        except NotDone:
            raise ConnectionFailed(
                f"no connection within {self._answer_sec:g} s to {self._place.host} port "
                f"{self._place.port}"
            ) from None

    def _begin_opening(self) -> Future[RosCassandra]:
        """Return the connection or attempt that there is; begin a new one if it failed."""
        with self._mutex:
            if self.closed:
                raise ConnectionFailed("the fleet is closed; make another Fleet")
            opening = self._opening
            if opening is None or (opening.done() and opening.exception() is not None):
                opening = self._opening = Future()
                # Looking up a name, say, has no time limit: so a daemon, and no pool that waits.
                name = "cassandra_ros-fleet"
                threading.Thread(target=self._open, args=(opening,), name=name, daemon=True).start()
            return opening

    def _open(self, opening: Future[RosCassandra]) -> None:
        """Connect; on a thread of its own."""
        place = self._place
        try:
            store = RosCassandra(
                place.host,
                place.port,
                keyspace=place.keyspace,
                cqlshrc=place.cqlshrc,
                credentials=place.credentials,
                consistency=self._consistency,
                answer_sec=self._answer_sec,
            )
        except Exception as exc:  # noqa: BLE001 - the caller of result() gets it
            opening.set_exception(exc)
        else:
            opening.set_result(store)

    def hurry(self) -> None:
        """Let a program that has to end not wait for this store; a signal handler may call it."""
        opening = self._opening
        if opening is not None and opening.done() and opening.exception() is None:
            opening.result().cassandra.outage.hurry()

    def close(self) -> None:
        """Close the connection; one that is still being made is closed when it is there."""
        with self._mutex:
            self.closed, opening = True, self._opening
        if opening is not None:
            opening.add_done_callback(_close)


def _close(opening: Future[RosCassandra]) -> None:
    """Close the connection that an attempt has made, if it has."""
    if opening.exception() is None:
        opening.result().close()
