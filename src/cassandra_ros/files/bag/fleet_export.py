# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Export the messages of several stores into one bag or MCAP, each message once."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import Iterable, Sequence

from cassandra_ros.arguments import check_topics, spellings
from cassandra_ros.errors import BagError, MessageNotFound
from cassandra_ros.files.bag.exporter import ConnectionNumbers, ExportReport, robots_of
from cassandra_ros.files.bag.file_formats import make_file
from cassandra_ros.files.bag.message_file import MessageProgress
from cassandra_ros.files.bag.publish_times import PublishTimeFinder
from cassandra_ros.messages.stamps import Time
from cassandra_ros.stores.fleet.fleet import Fleet
from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer, Missing
from cassandra_ros.stores.fleet.fleet_reads import whose_of
from cassandra_ros.stores.fleet.fleet_row import FleetRow
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.event_finder import EventRule
from cassandra_ros.topics.run_finder import RunName


@dataclass
class FleetExportReport(ExportReport):
    """The result of an export of several stores."""

    missing: Missing = field(default_factory=dict)
    """The stores that did not answer, or not to the end → why, and how many messages that they had
    listed before are not in the file."""


def export_fleet(
    fleet: Fleet,
    path: str | os.PathLike[str],
    topics: Iterable[str] | None = None,
    start: Time | None = None,
    end: Time | None = None,
    nodeID: str | None = None,
    compression: str | None = None,
    force: bool = False,
    progress: MessageProgress | None = None,
    where: Conditions = None,
    run: RunName = None,
    event: EventRule = None,
) -> FleetExportReport:
    """Write the messages of several stores into a bag of format 2.0, or into an MCAP.

    As export_bag, but without the messages that were latched before the start, or before an event.
    Events that meet the time of the messages are written into an MCAP. The file is also
    written if a store does not answer; the report names it.

    Args:
        path, topics, start, end, nodeID, compression, force, progress, where, run, event: As in
            export_bag.

    Raises:
        MessageNotFound: There are no messages to export. No file is created or replaced.
        BagError: The file exists, or cannot be written.
        StoreUnavailable: No store answers.
        TopicNotFound, RunNotFound, EventNotFound, InvalidOption, InvalidQuery: As in
            Fleet.readMessages.
    """
    if os.path.exists(path) and not force:
        raise BagError(f"{os.fspath(path)} exists; choose another name, or replace it with --force")
    topics = check_topics(topics)
    rows = fleet.readMessages(
        topics, start, end, nodeID=nodeID, received=True, where=where, run=run, event=event
    )
    report = FleetExportReport(os.fspath(path), missing=rows.missing)
    first = list(islice(rows, 1))
    if not first:
        raise MessageNotFound(
            f"{report.path} is not written: no store that answers has such a message"
            f"{'; missing: ' + ', '.join(rows.missing) if rows.partial else ''}"
        )
    with make_file(path, compression) as writer:
        numbers = ConnectionNumbers(writer, _has_several_robots(rows.answer, topics, nodeID, run))
        publish_times = _PublishTimes(rows.answer, writer.keeps_publish_times)
        last = first[0]
        for row in chain(first, rows):
            try:
                number, wire = numbers.of(row), row.wire
            except MessageNotFound:
                continue  # deleted, or told in rows.missing with the store that went away
            writer.write(number, row.received, wire, *publish_times.of(row))
            report.add(row.topic, len(wire), early=False)
            last = row
            if progress is not None:
                progress(1, len(wire))
        if writer.keeps_publish_times:  # an MCAP: other files take no events
            events = fleet.events(None, first[0].received, last.received, nodeID=nodeID, run=run)
            report.events = sum(map(writer.add_event, events))
            report.missing = {**events.missing, **rows.missing}
    return report


def _has_several_robots(
    answer: FleetAnswer, topics: Sequence[str] | None, node: str | None, run: RunName
) -> bool:
    """Return whether the stores may have messages of several robots in a selection."""
    whose = whose_of(answer, node, run)
    names = None if topics is None else {name for topic in topics for name in spellings(topic)}

    def robots(catalog: Catalog) -> set[str]:
        tables = [t for t in catalog.tables(None) if names is None or t.metadata.topic in names]
        return robots_of(catalog, tables, whose)

    return len(set().union(*answer.each(answer.catalogs, robots).values())) > 1


class _PublishTimes:
    """Publish times of messages, from the stores that have them; see PublishTimeFinder.

    Args:
        enabled: False = return 0 and 0 for each row, without asking the stores.
    """

    def __init__(self, answer: FleetAnswer, enabled: bool) -> None:
        self._answer = answer
        self._finders = answer.each(
            answer.catalogs,
            lambda catalog: PublishTimeFinder(catalog.keyspace.side_tables, enabled),
        )

    def of(self, row: FleetRow) -> tuple[int, int]:
        """Return publish_time minus receive time, ns, and sequence number; 0 and 0 = unknown."""
        # A copy gets publish times after the messages: a store that was not read for the message
        # may have them already.
        for store in dict.fromkeys([*row.stores, *self._finders]):
            finder = {store: self._finders[store]} if store in self._finders else {}
            for publish_time in self._answer.each(
                finder, lambda store_finder: store_finder.of(row, row.received)
            ).values():
                if any(publish_time):
                    return publish_time
        return 0, 0
