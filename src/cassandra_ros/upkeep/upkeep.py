# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class Upkeep: what is done to stored topics now and then, several at once."""

from __future__ import annotations

from typing import Dict, Iterable, List, Optional

from cassandra_ros.arguments import check_integer, check_topics
from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.stamps import Length, Time, duration_ns, to_ns
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.upkeep.deletion import delete_messages
from cassandra_ros.upkeep.retention_rules import Retained, Rules, retain
from cassandra_ros.upkeep.run_places import PlacesOfRun, index_places, places_of_runs
from cassandra_ros.upkeep.store_check import CheckReport, check_store
from cassandra_ros.upkeep.table_copy import Progress


class Upkeep:
    """Deletes messages, thins what is old, reads everything back, mends it, notes places.

    Got as ``rosCas.upkeep``; it works in the keyspace that was connected then.
    """

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog

    def __repr__(self) -> str:
        return f"<Upkeep of keyspace {self._catalog.keyspace.name}: see its methods>"

    def delete(
        self,
        topics: Optional[Iterable[str]] = None,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
        where: Conditions = None,
        run: RunName = None,
        dry_run: bool = False,
    ) -> Dict[str, int]:
        """Delete messages of several topics; return topic -> how many. Topics stay, also empty.

        The arguments are those of RosCassandra.readMessages, but with ``where`` only topics that
        have a condition lose messages. With a run alone all that it stored goes, and it is not
        listed any more; that of one that still records is refused.

        Args:
            dry_run: Only count them.

        Raises:
            InvalidOption: Nothing is given but topics (see removeTopic, truncateTopic), a topic
                has no condition beside others, or the run goes on.
            TopicNotFound, RunNotFound, InvalidName, InvalidQuery: As readMessages.
        """
        names = check_topics(topics)
        time_range = self._catalog.time_range(names, key, to_key)
        return delete_messages(self._catalog, names, time_range, nodeID, run, where, dry_run)

    def isWritten(self, topic: str) -> bool:
        """Say whether a client writes messages of a topic now, as a recorder does.

        Raises:
            TopicNotFound, InvalidName: There is no such topic.
        """
        return self._catalog.is_written(topic)

    def check(
        self,
        topics: Optional[Iterable[str]] = None,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        repair: bool = False,
        progress: Progress = None,
    ) -> CheckReport:
        """Read topics back (None = all), with checksums, and compare them with the directory.

        Args:
            key, to_key: Ends, both included; whole time ranges (buckets) are read.
            repair: Mend what can be: counts, entries in the directory, pieces without a message.
        """
        names = check_topics(topics)
        time_range = self._catalog.time_range(names, key, to_key)
        return check_store(self._catalog, names, time_range, repair, progress)

    def indexPlaces(
        self,
        *,
        nodeID: Optional[str] = None,
        run: RunName = None,
        progress: Progress = None,
    ) -> List[PlacesOfRun]:
        """Note where the robots of runs were, so that NEAR reads only poses around a place.

        Recorders note it themselves; this is for imports, and for what was recorded without. What
        is noted already stays; runs that still go on, and interrupted imports, are left out.

        Args:
            nodeID, run: Of one node, of a run by its name or writer id; None = of all.
            progress: Called with how many seconds of how many of a run were gone through.

        Raises:
            RunNotFound, InvalidName.
        """
        return index_places(self._catalog, nodeID, run, progress)

    def placesIndex(
        self, *, nodeID: Optional[str] = None, run: RunName = None
    ) -> List[PlacesOfRun]:
        """Say of runs whether their poses are noted in the index of places; see indexPlaces."""
        return places_of_runs(self._catalog, nodeID, run)

    def retain(
        self,
        topics: Optional[Iterable[str]] = None,
        *,
        max_age: Optional[Length] = None,
        max_bytes: Optional[int] = None,
        keep: Conditions = None,
        before: Length = 30.0,
        after: Length = 30.0,
        thin: Optional[float] = None,
        thin_after: Length = 0.0,
        now: Optional[Time] = None,
        dry_run: bool = False,
        progress: Progress = None,
    ) -> List[Retained]:
        """Drop messages by age and size, thin others, and keep what lies around what happened.

        Latched messages are not thinned, and one that a publisher had latched before what is kept
        stays as well, so that this can be played. Messages under names are left alone. Repeated
        with the same arguments it drops nothing more but what became older.

        Args:
            topics: Their names; None = all whose messages lie by time.
            max_age: Older messages are dropped; seconds or a Duration.
            max_bytes: Serialised bytes (as info counts them) that these topics may take together:
                the oldest messages go first. What is kept around hits goes beyond it.
            keep: Topic -> condition, a text or (text, parameters), also of other topics: what
                lies from ``before`` before their messages to ``after`` behind them is not touched.
            thin: Messages a second that are kept at the most, of each publisher.
            thin_after: Only older messages are thinned, as max_age.
            now: From when ages are counted back; None = now, by the server's clock.
            dry_run: Only count them.
            progress: Called with how many messages of how many were looked at.

        Raises:
            InvalidOption: Nothing says what is to be dropped, a number cannot be, or a topic that
                is named has messages under names.
            InvalidKey: A length of time or now is none.
            TopicNotFound, InvalidName, InvalidQuery: As readMessages.
        """
        if thin is not None and not 0 < thin < float("inf"):
            raise InvalidOption(f"thin={thin!r:.80} is no rate: give messages a second above 0")
        server_ns = self._catalog.keyspace.cassandra.server_time_us() * 1000
        rules = Rules(
            now=server_ns if now is None else to_ns(now),
            max_age=None if max_age is None else duration_ns(max_age),
            max_bytes=None
            if max_bytes is None
            else check_integer("max_bytes", max_bytes, 0, 2**63),
            keep=keep,
            before=duration_ns(before),
            after=duration_ns(after),
            period=0 if thin is None else max(1, int(SECOND_NS / thin)),
            thin_after=duration_ns(thin_after),
        )
        return retain(self._catalog, check_topics(topics), rules, dry_run, progress)
