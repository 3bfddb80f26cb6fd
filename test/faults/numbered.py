# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The numbered messages: the text of each number, and the log of what was published.

Neither this module nor the account imports the package.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Iterator, NamedTuple

SIZES = 97
"""Number of different lengths of texts. A block of up to 1,024 messages then holds fewer than 16 of
each length, which it stores plain."""
LOG_LINE = "{number:010d} {time_ns:019d} {connections:03d}\n"
LINE_BYTES = len(LOG_LINE.format(number=0, time_ns=0, connections=0))


class Published(NamedTuple):
    """A line of a publisher's log."""

    number: int
    time_ns: int
    """Wall time at which it was published, ns."""
    connections: int
    """Number of subscribers at that time."""


def text_of(number: int) -> str:
    """Return the text of the message with a number: the number and a pattern made of it."""
    pattern = hashlib.sha256(str(number).encode()).hexdigest() * 2
    return f"{number:010d} {pattern[: number % SIZES]}"


def topic_of(topic: str, number: int, topics: int, step: int = 0) -> str:
    """Return the topic on which a number is published.

    Args:
        topic: The topic, or the prefix of several.
        topics: Number of topics, which get the numbers in turn.
        step: A further topic begins after so many numbers; 0 = all begin at once.
    """
    if topics == 1:
        return topic
    begun = min(topics, 1 + number // step) if step else topics
    return f"{topic}_{number % begun}"


def read_log(path: str | Path) -> Iterator[Published]:
    """Yield the messages that a publisher has published."""
    with open(path, encoding="ascii") as file:
        for line in file:
            if len(line) == LINE_BYTES:  # the last line of a killed publisher may be cut
                yield Published(*map(int, line.split()))


def published_at(path: str | Path, position: int) -> Published | None:
    """Return a line of a publisher's log, the first is 0; None if it is not published yet."""
    if position >= count_published(path):
        return None
    with open(path, encoding="ascii") as file:
        file.seek(position * LINE_BYTES)
        return Published(*map(int, file.readline().split()))


def count_published(path: str | Path) -> int:
    """Return the number of messages that a publisher has published so far."""
    file = Path(path)
    return file.stat().st_size // LINE_BYTES if file.exists() else 0
