# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The losses of a run by topic, reason and time range, as rows for the store."""

from __future__ import annotations

import threading
from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Mapping

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.store.tables.registry import Loss, LossKind

JOINED_LOSSES_NS = 60 * SECOND_NS
"""Maximum time between two losses of a kind that are stored as one row, ns."""


@dataclass(frozen=True)
class LossTotal:
    """The messages of a topic that were lost for one reason."""

    count: int
    """Number of messages; 0 = the number is not known."""
    first_ns: int
    """Time of reception of the first of them, ns; 0 = not known."""
    last_ns: int
    """Time of reception of the last of them, ns."""
    detail: str = ""
    """Explanation of the first loss in addition to the kind; '' = none is needed."""
    varied: bool = False
    """Whether other losses have other explanations."""

    def plus(self, later: LossTotal) -> LossTotal:
        """Return the sum of this and later losses of the same topic and kind."""
        return LossTotal(
            self.count + later.count,
            min(self.first_ns, later.first_ns),
            max(self.last_ns, later.last_ns),
            self.detail,
            self.varied or later.varied or later.detail != self.detail,
        )


@dataclass
class _LossRange:
    """The losses of a topic and kind that are stored as one row."""

    loss: Loss
    """All of them together."""
    saved: bool = False
    """Whether the row in the store is up to date."""
    sent: bool = False
    """Whether the row may exist in the store: then its first time, which is its key, is fixed."""

    def takes(self, first_ns: int) -> bool:
        """Return whether a loss that begins at ``first_ns`` belongs to this row."""
        earliest = self.loss.first_ns - (0 if self.sent else JOINED_LOSSES_NS)
        return earliest <= first_ns <= self.loss.last_ns + JOINED_LOSSES_NS

    def grow(self, messages: int, first_ns: int, last_ns: int) -> None:
        """Add a further loss."""
        old = self.loss
        self.loss = replace(
            old,
            first_ns=min(old.first_ns, first_ns),
            last_ns=max(old.last_ns, last_ns),
            count=old.count + messages,
        )
        self.saved = False

    def to_store(self) -> Loss:
        """Return the loss to be stored; from now on its first time, which is its key, is fixed."""
        self.sent = True
        return self.loss

    def save(self, loss: Loss) -> None:
        """Note that the store has a loss, if that is still the present state of this one."""
        self.saved = self.saved or self.loss == loss


class LossLog:
    """The losses of one run. Thread-safe.

    Args:
        node: nodeID of the recorded robot.
        writer: Writer id of the run.
    """

    def __init__(self, node: str, writer: int) -> None:
        self._node, self._writer = node, writer
        self._loss_ranges: dict[tuple[str, LossKind], list[_LossRange]] = defaultdict(list)
        self._totals: dict[str, dict[LossKind, LossTotal]] = defaultdict(dict)
        self._mutex = threading.Lock()

    def add(
        self, topic: str, kind: LossKind, messages: int, first_ns: int, last_ns: int, detail: str
    ) -> int:
        """Record a loss; return the number of messages of the topic lost so far.

        Args:
            messages: Number of messages; 0 = not known.
            first_ns, last_ns: Times of reception of the first and the last of them, ns.
            detail: Explanation in addition to the kind; '' = none is needed.
        """
        with self._mutex:
            totals = self._totals[topic]
            total = LossTotal(messages, first_ns, last_ns, detail)
            totals[kind] = totals[kind].plus(total) if kind in totals else total
            ranges = self._loss_ranges[topic, kind]
            # Not only the last range: several threads report losses, not in the order of time.
            loss_range = next((s for s in reversed(ranges) if s.takes(first_ns)), None)
            if loss_range is None:
                new = Loss(topic, self._node, self._writer, kind, first_ns, last_ns, messages)
                ranges.append(_LossRange(new))
            else:
                loss_range.grow(messages, first_ns, last_ns)
            return sum(loss_total.count for loss_total in totals.values())

    def of(self, topic: str) -> Mapping[LossKind, LossTotal]:
        """Return the lost messages of a topic by kind."""
        with self._mutex:
            return dict(self._totals.get(topic, {}))

    def last_ns(self, topic: str) -> int:
        """Return the time of reception of the last lost message of a topic, ns; -1 = no loss.

        Losses of an unknown number are left out: those messages were never received.
        """
        with self._mutex:
            losses = [
                s.loss
                for (name, _), ranges in self._loss_ranges.items()
                if name == topic
                for s in ranges
            ]
        # Messages received while the clock was not set have no time.
        timed = (loss for loss in losses if loss.count and loss.kind is not LossKind.NO_CLOCK)
        return max((loss.last_ns for loss in timed), default=-1)

    def unsaved(self) -> list[Loss]:
        """Return the losses that are not stored yet; ``saved`` then marks one as stored."""
        with self._mutex:
            unsaved = [s for ranges in self._loss_ranges.values() for s in ranges if not s.saved]
            return [loss_range.to_store() for loss_range in unsaved]

    def saved(self, loss: Loss) -> None:
        """Mark a loss as stored; one that has grown since stays unsaved."""
        with self._mutex:
            ranges = self._loss_ranges[loss.topic, loss.kind]
            for loss_range in ranges:
                loss_range.save(loss)
            # So that memory stays bounded: a late loss of a removed range becomes a row of its own.
            ranges[:-2] = [loss_range for loss_range in ranges[:-2] if not loss_range.saved]
