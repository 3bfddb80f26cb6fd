# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The text that ``rosbag info`` prints, line for line."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Mapping, Sequence

import yaml

from cassandra_ros.keys import SECOND_NS


@dataclass(frozen=True)
class TopicSummary:
    """The line about one topic."""

    topic: str
    type: str
    messages: int
    connections: int
    frequency: float | None
    """Median rate, Hz; None = unknown."""


@dataclass(frozen=True)
class Summary:
    """The facts that ``rosbag info`` prints about a bag."""

    path: str
    size: int
    """Size of the serialised messages, bytes."""
    ends: tuple[int, int] | None
    """First and last receive time, ns; None = there are no messages."""
    types: Mapping[str, str]
    """Type -> md5sum."""
    topics: Sequence[TopicSummary]

    def text(self) -> str:
        """Return the text; its times are local times, as in rosbag."""
        rows = [("path:", self.path), ("version:", "2.0")]
        if self.ends is not None:
            start, end = (ns // SECOND_NS + ns % SECOND_NS / SECOND_NS for ns in self.ends)
            rows.append(("duration:", _duration(end - start)))
            rows += [("start:", _moment(start)), ("end:", _moment(end))]
        rows.append(("size:", _scaled(self.size / 1024, 1024, ("KB", "MB", "GB", "TB", "PB"))))
        rows.append(("messages:", str(sum(topic.messages for topic in self.topics))))
        rows += _head_lines("types:", self._types())
        rows += _head_lines("topics:", self._topics())
        width = max(len(head) for head, _ in rows)
        return "\n".join(f"{head:<{width}} {value}" for head, value in rows).rstrip()

    def yaml(self, key: str | None = None) -> str | None:
        """Return the facts as YAML, as ``rosbag info --yaml`` prints them.

        Args:
            key: Name of the only fact to return; None = all.

        Returns:
            The YAML text; None = there is no fact of this name.
        """
        facts: dict[str, object] = {"path": self.path, "version": 2.0}
        if self.ends is not None:
            start, end = (ns / SECOND_NS for ns in self.ends)
            times = {"duration": end - start, "start": start, "end": end}
            facts.update((name, round(seconds, 6)) for name, seconds in times.items())
        facts["size"] = self.size
        facts["messages"] = sum(topic.messages for topic in self.topics)
        facts["indexed"] = True
        facts["compression"] = "none"
        facts["types"] = [{"type": name, "md5": md5sum} for name, md5sum in self.types.items()]
        facts["topics"] = [_facts(topic) for topic in self.topics]
        if key is None:
            return str(yaml.safe_dump(facts, sort_keys=False))
        fact = facts.get(key)
        if isinstance(fact, list):
            return str(yaml.safe_dump(fact, sort_keys=False))
        return None if fact is None else str(fact)

    def _types(self) -> list[str]:
        """Return the lines about the types."""
        width = max(map(len, self.types), default=0)
        return [f"{name:<{width}} [{md5sum}]" for name, md5sum in self.types.items()]

    def _topics(self) -> list[str]:
        """Return the lines about the topics, in columns."""
        rates = [
            "" if topic.frequency is None else _scaled(topic.frequency, 1000, ("Hz", "kHz", "MHz"))
            for topic in self.topics
        ]
        name = max((len(topic.topic) for topic in self.topics), default=0)
        kind = max((len(topic.type) for topic in self.topics), default=0)
        number = max((len(str(topic.messages)) for topic in self.topics), default=0)
        rate = max(map(len, rates), default=0)
        return [
            f"{t.topic:<{name}}   {t.messages:>{number}} {'msgs' if t.messages > 1 else 'msg '}"
            f" {'@' if hz else ' '} {hz:>{rate}} : {t.type:<{kind}}"
            + (f" ({t.connections} connections)" if t.connections > 1 else "")
            for t, hz in zip(self.topics, rates)
        ]


def _facts(topic: TopicSummary) -> dict[str, object]:
    """Return the facts about a topic for YAML."""
    facts: dict[str, object] = {"topic": topic.topic, "type": topic.type}
    facts["messages"] = topic.messages
    if topic.connections > 1:
        facts["connections"] = topic.connections
    if topic.frequency is not None:
        facts["frequency"] = round(topic.frequency, 4)
    return facts


def _head_lines(head: str, lines: Sequence[str]) -> list[tuple[str, str]]:
    """Return (head, line) of each line; only the first one has the head."""
    return [(head if n == 0 else "", line) for n, line in enumerate(lines)]


def _scaled(value: float, step: int, units: Sequence[str]) -> str:
    """Return a value with the first unit in which it is smaller than ``step``, or the last unit.

    As rosbag does, it is rounded after the unit was chosen: 1023.96 KB is '1024.0 KB'.
    """
    for unit in units[:-1]:
        if value < step:
            return f"{value:.1f} {unit}"
        value /= step
    return f"{value:.1f} {units[-1]}"


def _duration(seconds: float) -> str:
    """Return a duration as rosbag writes it: '5.0s', '1:05s (65s)' or '1hr 1:05s (3665s)'."""
    minutes = int(seconds / 60)
    if not minutes:
        return f"{seconds:.1f}s"
    clock = f"{minutes}:{int(seconds % 60):02d}s"
    if minutes >= 60:
        clock = f"{minutes // 60}hr {minutes % 60}:{int(seconds % 60):02d}s"
    return f"{clock} ({int(seconds)}s)"


def _moment(seconds: float) -> str:
    """Return a time as rosbag writes it: local, and as seconds since 1970."""
    day = time.strftime("%b %d %Y %H:%M:%S", time.localtime(seconds))
    return f"{day}{f'{seconds % 1:.2f}'[1:]} ({seconds:.2f})"
