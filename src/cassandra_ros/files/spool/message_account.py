# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Count the messages of a run while its files are read, and tell those that the files miss.

A file tells how many messages the run had written before it, and after each of its chunks (see
``segment_writer``). What is missing in between is told by topic, with the time range in which it
was received: of a damaged part, of a file that was cut short, and of a file that is not there. A
file that was deleted because its messages are stored is not missing: the folder of the run says so.
"""

from __future__ import annotations

from pathlib import Path
from typing import Iterator

from cassandra_ros.files.spool.segment_reader import Missing, SegmentPart, SegmentReader
from cassandra_ros.files.spool.spool_folder import RunFolder
from cassandra_ros.files.spool.spool_label import TopicTotal, Totals, copy_totals


class MessageAccount:
    """The account of a run whose files are read in the order of their numbers.

    Args:
        folder: The files of the run.

    Raises:
        SpoolError: The notes of the folder cannot be read.
    """

    def __init__(self, folder: RunFolder) -> None:
        self._folder = folder
        self._settled = folder.settled()
        self._last_number = 0
        """Number of the last file that was read, or that is settled and not there any more."""
        self._count = _Count({})
        """The messages of the run up to the end of that file."""

    def parts(self, reader: SegmentReader) -> Iterator[SegmentPart]:
        """Yield the parts of a file with messages, and what is missing before and in it.

        What is missing after the last totals of the file is yielded with the next file, or by
        ``finish``.

        Args:
            reader: A file with a higher number than those before; all parts must be taken.
        """
        number = int(reader.path.stem)
        skipped = range(self._last_number + 1, number)
        settled = [earlier for earlier in skipped if earlier in self._settled]
        if settled:
            # The totals of the last one count the files before it, too, whatever is missing there.
            self._last_number = settled[-1]
            self._count = _Count(self._settled[self._last_number])
        if number > self._last_number + 1:
            self._count.note(f"{self._folder.file(self._last_number + 1)} is missing")
        self._last_number = number
        if number not in self._settled:
            yield from self._count.parts(reader)
            return
        # An earlier drain has stored the other messages of this file.
        rest = _Count(None)
        yield from rest.parts(reader)
        yield from rest.finish()
        self._count = _Count(self._settled[number])

    def finish(self) -> Iterator[SegmentPart]:
        """Yield what is missing after the last totals, when all files were read."""
        yield from self._count.finish()

    def totals(self) -> Totals:
        """Return the messages of the run up to the end of the last file that was read.

        Those that are known to be missing count, too.
        """
        return copy_totals(self._count.totals or {})


def read_run(folder: RunFolder) -> Iterator[SegmentPart]:
    """Yield the messages of a run chunk by chunk, and what is missing.

    Raises:
        SpoolError: A file or the notes of the folder cannot be read, or a file is of another
            version.
    """
    account = MessageAccount(folder)
    for path in folder.files():
        yield from account.parts(SegmentReader(path))
    yield from account.finish()


class _Count:
    """The messages of a run up to a place in its files, and the damage since the last totals.

    Args:
        totals: Messages of the run before the place where reading begins; None = not known, until
            totals are read: then only damage tells that messages before these are missing.
    """

    def __init__(self, totals: Totals | None) -> None:
        self.totals = None if totals is None else copy_totals(totals)
        """Messages up to the last part that was read; set to the totals where the file has some."""
        self._path: Path | None = None
        """The file that was read last."""
        self._forget()

    def _forget(self) -> None:
        """Begin anew after totals: what was missing before them is told."""
        self._damage = ""
        """What is damaged since the last totals; '' = nothing."""
        self._before: Totals = {}
        """The messages of the run before the damage."""
        self._listed: Totals = {}
        """The missing messages by the message indexes."""
        self._is_listed = True
        """Whether the message indexes tell all that is missing."""

    def note(self, damage: str) -> None:
        """Note damage, in words; of several the first counts."""
        if not self._damage:
            self._damage, self._before = damage, copy_totals(self.totals or {})

    def parts(self, reader: SegmentReader) -> Iterator[SegmentPart]:
        """Yield the parts of a file with messages or damage, and what its totals show as missing.

        The ``missing`` of the reader's parts is not yielded: it is used when the totals are known.
        """
        for segment_part in reader.parts():
            if segment_part.totals is not None:
                yield from self._compare(segment_part.totals)
                continue
            if segment_part.damage:
                self.note(segment_part.damage)
            for missing in segment_part.missing:
                if missing.topic:
                    total = self._listed.setdefault(missing.topic, TopicTotal())
                    total.add(missing.messages, missing.first_ns, missing.last_ns)
                else:
                    self._is_listed = False
            if self.totals is None:
                self.totals = {}
            for connection, t_ns, _, _ in segment_part.messages:
                self.totals.setdefault(connection.topic, TopicTotal()).add(1, t_ns, t_ns)
            yield SegmentPart(segment_part.messages, segment_part.damage)
        self._path = reader.path

    def _compare(self, totals: Totals) -> Iterator[SegmentPart]:
        """Yield what is missing before totals in the file; go on with them."""
        if self.totals is None:
            yield from self.finish()
        else:
            differences = [
                self._difference(topic, total, self.totals.get(topic, TopicTotal()))
                for topic, total in totals.items()
            ]
            yield from self._tell([missing for missing in differences if missing.messages > 0])
        self.totals = copy_totals(totals)
        self._forget()

    def _difference(self, topic: str, total: TopicTotal, counted: TopicTotal) -> Missing:
        """Return how many messages of a topic are missing, and in which time range.

        Args:
            total: The messages of the topic by the totals in the file.
            counted: Those that were read; if all were, the number that is returned is 0.
        """
        number = total.count - counted.count
        listed = self._listed.get(topic)
        if listed is not None and listed.count == number:
            return Missing(topic, number, listed.first_ns, listed.last_ns)
        # The indexes do not list all of them: any time from the damage to the totals.
        before = self._before.get(topic, TopicTotal()) if self._damage else counted
        first = before.last_ns + 1 if before.count else total.first_ns
        return Missing(topic, number, min(first, total.last_ns), total.last_ns)

    def finish(self) -> Iterator[SegmentPart]:
        """Yield what is missing where no totals follow: by the indexes, or an unknown number."""
        if self._damage:
            missing = [Missing(t, n.count, n.first_ns, n.last_ns) for t, n in self._listed.items()]
            if not self._is_listed:
                missing += self._unlisted()
            yield from self._tell(missing)
        self._forget()

    def _unlisted(self) -> list[Missing]:
        """Return an unknown number of messages of each topic that the indexes do not list.

        If there is no such topic, the topic is not known either.
        """
        totals = self.totals or {}
        last = max((n.last_ns for n in totals.values()), default=0)
        missing = [
            Missing(topic, 0, min(self._before.get(topic, total).last_ns, last), last)
            for topic, total in totals.items()
            if topic not in self._listed
        ]
        return missing or [Missing("", 0, 0, 0)]

    def _tell(self, missing: list[Missing]) -> Iterator[SegmentPart]:
        """Yield one part with what is missing, and a text about it; nothing for []."""
        if missing:
            topics = ", ".join(f"{n.messages or 'some'} of topic {n.topic or '?'}" for n in missing)
            damage = self._damage or f"{self._path} is cut short"
            yield SegmentPart(damage=f"{damage}: messages are missing, {topics}", missing=missing)
