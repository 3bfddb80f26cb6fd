# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The stores of a viewer that shows several as one, and what it caches of them."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import Mapping, Sequence

from cassandra_ros.arguments import spellings
from cassandra_ros.query.plan.pushdown import Watch, unwatched
from cassandra_ros.stores.fleet.fleet import Fleet
from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer
from cassandra_ros.stores.fleet.fleet_topic import find_topic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.overview.stored_ends import Ends, widest
from cassandra_ros.topics.overview.timeline.lanes import Picture, Timeline, View, window_of
from cassandra_ros.topics.overview.timeline.merged_pictures import merged_extent, merged_picture


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
