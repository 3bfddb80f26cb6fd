# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class Upkeep: what is done to stored topics now and then, several at once."""

from __future__ import annotations

from typing import Dict, Iterable, Optional

from cassandra_ros.arguments import check_topics
from cassandra_ros.messages.stamps import Time
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.checking import CheckReport, check_store
from cassandra_ros.topics.copying import Progress
from cassandra_ros.topics.deletion import delete_messages
from cassandra_ros.topics.runs import RunName


class Upkeep:
    """Deletes messages of several topics, reads everything back and mends it.

    Got as ``rosCas.upkeep``; it works in the keyspace that was connected then.
    """

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog

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
        stretch = self._catalog.stretch(names, key, to_key)
        return delete_messages(self._catalog, names, stretch, nodeID, run, where, dry_run)

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
            key, to_key: Ends, both included; whole stretches of time (buckets) are read.
            repair: Mend what can be: counts, entries in the directory, pieces without a message.
        """
        names = check_topics(topics)
        stretch = self._catalog.stretch(names, key, to_key)
        return check_store(self._catalog, names, stretch, repair, progress)
