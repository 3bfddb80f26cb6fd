# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a run lost: of which topic, why, from when to when, how many; rows for the store."""

from __future__ import annotations

import threading
from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Mapping

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.tables.registry import Loss, LossKind

STRETCH_NS = 60 * SECOND_NS
"""Losses of a kind that lie further apart are two rows."""


@dataclass(frozen=True)
class LossTotal:
    """What was lost of a topic for one reason."""

    count: int
    """Number of messages; 0 = the number is not known."""
    first_ns: int
    """When the first of them came, ns; 0 = not known."""
    last_ns: int
    """When the last of them came, ns."""
    detail: str = ""
    """A sentence about the first of them; '' = the kind says it all."""
    varied: bool = False
    """Others have other details."""

    def plus(self, later: LossTotal) -> LossTotal:
        """Return this and later losses of the same topic and kind together."""
        return LossTotal(
            self.count + later.count,
            min(self.first_ns, later.first_ns),
            max(self.last_ns, later.last_ns),
            self.detail,
            self.varied or later.varied or later.detail != self.detail,
        )


@dataclass
class _TimeRange:
    loss: Loss
    saved: bool = False
    told: bool = False
    """The store may know it: where it begins is its key there."""

    def takes(self, first_ns: int) -> bool:
        """Say whether a loss belongs to it that begins then."""
        begins, ends = self.loss.first_ns, self.loss.last_ns
        return begins - (0 if self.told else STRETCH_NS) <= first_ns <= ends + STRETCH_NS

    def grow(self, messages: int, first_ns: int, last_ns: int) -> None:
        """Take in a further loss."""
        old = self.loss
        self.loss = replace(
            old,
            first_ns=min(old.first_ns, first_ns),
            last_ns=max(old.last_ns, last_ns),
            count=old.count + messages,
        )
        self.saved = False

    def tell(self) -> Loss:
        """Return the loss for the store, where its first time is its key from now on."""
        self.told = True
        return self.loss

    def save(self, loss: Loss) -> None:
        """Note that the store knows a loss, where it is this one as it is now."""
        self.saved = self.saved or self.loss == loss


class LossLog:
    """The losses of one run. Thread-safe.

    Args:
        node: The robot or entity that is recorded.
        writer: The run's writer id.
    """

    def __init__(self, node: str, writer: int) -> None:
        self._node, self._writer = node, writer
        self._time_ranges: dict[tuple[str, LossKind], list[_TimeRange]] = defaultdict(list)
        self._totals: dict[str, dict[LossKind, LossTotal]] = defaultdict(dict)
        self._mutex = threading.Lock()

    def add(
        self, topic: str, kind: LossKind, messages: int, first_ns: int, last_ns: int, detail: str
    ) -> int:
        """Note a loss; return how many messages of the topic are lost by now.

        Args:
            messages: How many; 0 = nobody knows.
            first_ns, last_ns: When the first and the last of them came, ns.
            detail: A sentence about it; '' = the kind says it all.
        """
        with self._mutex:
            totals = self._totals[topic]
            total = LossTotal(messages, first_ns, last_ns, detail)
            totals[kind] = totals[kind].plus(total) if kind in totals else total
            time_ranges = self._time_ranges[topic, kind]
            # Not only the last one: several threads lose, of what came at different times.
            found = next((s for s in reversed(time_ranges) if s.takes(first_ns)), None)
            if found is None:
                new = Loss(topic, self._node, self._writer, kind, first_ns, last_ns, messages)
                time_ranges.append(_TimeRange(new))
            else:
                found.grow(messages, first_ns, last_ns)
            return sum(each.count for each in totals.values())

    def of(self, topic: str) -> Mapping[LossKind, LossTotal]:
        """Return what was lost of a topic, by kind."""
        with self._mutex:
            return dict(self._totals.get(topic, {}))

    def last_ns(self, topic: str) -> int:
        """Return when the last message of a topic came that was lost, ns; -1 = none was."""
        with self._mutex:
            every = [
                s.loss for (name, _), own in self._time_ranges.items() if name == topic for s in own
            ]
        # Those that came while the clock was not set have no time.
        timed = (loss for loss in every if loss.count and loss.kind is not LossKind.NO_CLOCK)
        return max((loss.last_ns for loss in timed), default=-1)

    def unsaved(self) -> list[Loss]:
        """Return what the store does not know yet."""
        with self._mutex:
            every = [
                s for time_ranges in self._time_ranges.values() for s in time_ranges if not s.saved
            ]
            return [time_range.tell() for time_range in every]

    def saved(self, loss: Loss) -> None:
        """Note that the store knows a loss; one that has grown since stays unsaved."""
        with self._mutex:
            time_ranges = self._time_ranges[loss.topic, loss.kind]
            for time_range in time_ranges:
                time_range.save(loss)
            # Only the last ones grow.
            time_ranges[:-2] = [
                time_range for time_range in time_ranges[:-2] if not time_range.saved
            ]
