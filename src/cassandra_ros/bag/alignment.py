# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare two sequences of messages so that a lost one does not make all that follow differ."""

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import Deque, Iterator, NamedTuple, Tuple

from cassandra_ros.bag.differences import VerifyReport, describeBytes

WINDOW = 50
"""Messages ahead, on either side, among which a counterpart is looked for."""


class Content(NamedTuple):
    """What is compared of a message, and how to name it."""

    type: str
    md5sum: str
    value: bytes
    """Its fingerprint."""
    place: str

    @property
    def key(self) -> Tuple[str, str, bytes]:
        """What must be equal."""
        return self[:3]


class Alignment:
    """Compares the messages of one topic in a bag with those in the store, in their order.

    Args:
        store: The stored messages; read a window ahead.
        report: Gets what is found.
    """

    def __init__(self, store: Iterator[Content], report: VerifyReport) -> None:
        self._store = store
        self._report = report
        self._bag: Deque[Content] = deque()
        self._seen: Deque[Content] = deque()

    def add(self, message: Content) -> None:
        """Take the next message of the bag."""
        self._bag.append(message)
        self._compare(WINDOW)

    def finish(self) -> None:
        """Compare what is left; there are no more messages in the bag."""
        self._compare(1)
        if self._seen:
            place, count = self._seen[0].place, len(self._seen) + sum(1 for _ in self._store)
            self._report.add(f"{place}: the store has {count} messages more than the bag", count)

    def _compare(self, wanted: int) -> None:
        """Compare while at least so many messages of the bag wait, or the next two are equal."""
        while self._bag:
            self._seen.extend(islice(self._store, WINDOW - len(self._seen)))
            if self._seen and self._bag[0].key == self._seen[0].key:
                self._report.equal_messages += 1
                self._bag.popleft()
                self._seen.popleft()
            elif len(self._bag) < wanted:
                return
            else:
                self._resolve()
        self._seen.extend(islice(self._store, WINDOW - len(self._seen)))

    def _resolve(self) -> None:
        """Decide what the first difference is, and step behind it."""
        bag, seen = self._bag, self._seen
        if not seen:
            place = bag.popleft().place
            self._report.add(f"{place} has no counterpart: the store has fewer messages")
            return
        further = _find(bag[0], seen)
        missing = _find(seen[0], bag)
        if further and (not missing or further <= missing):
            for _ in range(further):
                self._report.add(f"{seen.popleft().place}: the bag has no such message here")
        elif missing:
            for _ in range(missing):
                self._report.add(f"{bag.popleft().place} is not in the store")
        else:
            self._report.add(_describe(bag.popleft(), seen.popleft()))


def _find(message: Content, others: Deque[Content]) -> int:
    """Return how many messages come before an equal one; 0 = there is none."""
    for place, other in enumerate(others):
        if other.key == message.key:
            return place
    return 0


def _describe(wanted: Content, seen: Content) -> str:
    if wanted.key[:2] != seen.key[:2]:
        return (
            f"{wanted.place}: type {wanted.type} [{wanted.md5sum}] in the bag, "
            f"{seen.type} [{seen.md5sum}] in the store"
        )
    return f"{wanted.place}: {describeBytes(wanted.value, seen.value)} (stored as {seen.place})"
