# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class Upkeep: work on stored topics that is done now and then, several topics at once."""

from __future__ import annotations

from collections import Counter
from typing import Iterable, Mapping

from cassandra_ros.arguments import check_event_name, check_integer, check_list, check_topics
from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.stamps import Length, Time, duration_ns, to_ns
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.event_finder import EventRule
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.upkeep.deletion import delete_messages
from cassandra_ros.topics.upkeep.retention_rules import Retained, Rules, retain
from cassandra_ros.topics.upkeep.run_changes import MoveProgress, change_runs
from cassandra_ros.topics.upkeep.run_places import PlacesOfRun, index_places, places_of_runs
from cassandra_ros.topics.upkeep.store_check import CheckReport, check_store
from cassandra_ros.topics.upkeep.table_copy import Progress


class Upkeep:
    """Deletes messages, thins old ones, checks and mends the store, indexes places, changes runs.

    Get it as ``rosCas.upkeep``; it works in the keyspace that was connected then.
    """

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog

    def __repr__(self) -> str:
        return f"<Upkeep of keyspace {self._catalog.keyspace.name}: see its methods>"

    def delete(
        self,
        topics: Iterable[str] | None = None,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        nodeID: str | None = None,
        where: Conditions = None,
        run: RunName = None,
        event: EventRule = None,
        dry_run: bool = False,
    ) -> dict[str, int]:
        """Delete messages of several topics; return topic → number. Topics stay, even if empty.

        The arguments are those of RosCassandra.readMessages, but with ``where`` only topics that
        have a condition lose messages. With only a run, all messages of the run are deleted, and it
        is no longer listed; a run that is still recording is refused.

        Args:
            dry_run: Only count the messages.

        Raises:
            InvalidOption: Only topics are given (see removeTopic, truncateTopic), a topic has no
                condition while others do, or the run goes on.
            TopicNotFound, RunNotFound, EventNotFound, InvalidName, InvalidQuery: As readMessages.
        """
        names = check_topics(topics)
        whose = self._catalog.whose(nodeID, run)
        reads = self._catalog.reads_of(names, key, to_key, whose, event)
        counts: Counter[str] = Counter()
        for read in reads.parts:
            counts.update(delete_messages(self._catalog, names, read, where, dry_run))
        return dict(counts)

    def isWritten(self, topic: str) -> bool:
        """Return whether a client, such as a recorder, is writing messages of a topic now.

        Raises:
            TopicNotFound, InvalidName: There is no such topic.
        """
        return self._catalog.is_written(topic)

    def check(
        self,
        topics: Iterable[str] | None = None,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        repair: bool = False,
        progress: Progress = None,
    ) -> CheckReport:
        """Read topics back (None = all), with checksums, and compare them with the directory.

        Args:
            key, to_key: Key times, both included; whole buckets are read.
            repair: Mend counts, entries of the directory, and chunks without a message.
        """
        names = check_topics(topics)
        time_range = self._catalog.time_range(names, key, to_key)
        return check_store(self._catalog, names, time_range, repair, progress)

    def indexPlaces(
        self, *, nodeID: str | None = None, run: RunName = None, progress: Progress = None
    ) -> list[PlacesOfRun]:
        """Index where the robots of runs were, so that NEAR reads only poses around a place.

        Recorders do it themselves; this is for imports, and for recordings without it. Runs that
        are indexed stay as they are; runs that go on and interrupted imports are left out.

        Args:
            nodeID, run: nodeID, and run by name or writer id; None = all.
            progress: Called with the seconds of a run that are done, and all its seconds.

        Raises:
            RunNotFound, InvalidName.
        """
        return index_places(self._catalog, nodeID, run, progress)

    def placesIndex(self, *, nodeID: str | None = None, run: RunName = None) -> list[PlacesOfRun]:
        """Return for each run whether the index of places has its poses; see indexPlaces."""
        return places_of_runs(self._catalog, nodeID, run)

    def setRuns(
        self,
        run: str | int,
        *,
        name: str | None = None,
        nodeID: str | None = None,
        labels: Mapping[str, str | None] | None = None,
        progress: MoveProgress = None,
    ) -> list[Run]:
        """Give runs that have ended another name, robot or labels; return them as they are now.

        For another robot the tables of the run's topics are copied, as for another format
        (``convertTopic``), while others read them: each message is seen at all times, and once.
        Only a read that stands at a message with the same time as a moved one may see that one
        twice, or not. Losses, events and the index of places follow. If it was killed, the same
        call goes on.
        A store to which the run was copied keeps the old robot: change the run there, too, before
        it is copied again.

        Args:
            run: Name or writer id, which may mean several runs; the file from which a run was
                imported, or the folder of such files, as a path.
            name: New name; '' = no name.
            nodeID: New robot; '' = no robot.
            labels: Labels to add or to replace; None in place of a text removes a label.
            progress: Called with a topic, the number of its messages that are done, and that of
                all its messages.

        Raises:
            RunNotFound, InvalidName.
            SchemaConflict: A run, or a topic of it, is being recorded; or an import of another
                robot was interrupted.
            WriteFailed, StoreUnavailable, CorruptMessage: Messages of some topics have the new
                robot, the others the old one; all are there. Call it again.
        """
        return change_runs(self._catalog, run, name, nodeID, labels or {}, progress)

    def retain(
        self,
        topics: Iterable[str] | None = None,
        *,
        max_age: Length | None = None,
        max_bytes: int | None = None,
        keep: Conditions = None,
        event: str | Iterable[str] = (),
        before: Length = 30.0,
        after: Length = 30.0,
        thin: float | None = None,
        thin_after: Length = 0.0,
        now: Time | None = None,
        dry_run: bool = False,
        progress: Progress = None,
    ) -> list[Retained]:
        """Drop messages by age and size, thin others, and keep those around events.

        Latched messages are not thinned. A message that a publisher had latched before a kept time
        range is kept too, so that the range can be played. Messages with names are not touched. A
        repetition with the same arguments only drops messages that have become older.

        Args:
            topics: Names of topics; None = all with a time key.
            max_age: Maximum age of messages; seconds or a Duration.
            max_bytes: Maximum number of serialised bytes (as info counts them) of these topics
                together; the oldest messages are dropped first. What is kept around events is kept
                in addition.
            keep: Topic → condition, a text or (text, parameters); may contain other topics.
                Messages from ``before`` before to ``after`` after a message that matches are not
                touched.
            event: Names of events. Messages of all robots from ``before`` before to ``after`` after
                each event are not touched either. If there is no event of a name, this is logged.
            thin: Maximum number of messages a second that are kept, for each publisher.
            thin_after: Minimum age of messages that are thinned; like max_age.
            now: Time from which ages are counted back; None = the server's present time.
            dry_run: Only count the messages.
            progress: Called with the number of messages that are done, and of all.

        Raises:
            InvalidOption: No limit or rate is given, a number is out of range, or one of ``topics``
                has messages with names.
            InvalidKey: A length of time, or ``now``, is not valid.
            TopicNotFound, InvalidName, InvalidQuery: As readMessages.
        """
        if thin is not None and not 0 < thin < float("inf"):
            raise InvalidOption(f"thin={thin!r:.80} is not a rate: give messages a second above 0")
        server_ns = self._catalog.keyspace.cassandra.server_time_us() * 1000
        rules = Rules(
            now=server_ns if now is None else to_ns(now),
            max_age=None if max_age is None else duration_ns(max_age),
            max_bytes=None
            if max_bytes is None
            else check_integer("max_bytes", max_bytes, 0, 2**63),
            keep=keep,
            events=[check_event_name(name) for name in check_list("event", event, "['bump']")],
            before=duration_ns(before),
            after=duration_ns(after),
            period=0 if thin is None else max(1, int(SECOND_NS / thin)),
            thin_after=duration_ns(thin_after),
        )
        return retain(self._catalog, check_topics(topics), rules, dry_run, progress)
