# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Choosing topics of a bag by name."""

from __future__ import annotations

from difflib import get_close_matches
from typing import AbstractSet, Iterable, Set

from cassandra_ros.bag.reader import BagReader
from cassandra_ros.errors import TopicNotFound

LISTED = 10
"""Topics that an error names."""


def matchTopics(names: Iterable[str], present: AbstractSet[str], where: str) -> Set[str]:
    """Find topics by name, with or without the leading slash.

    Args:
        names: What was asked for.
        present: Topics that exist, spelt as they are stored.
        where: Where they should be, for the error's sentence.

    Raises:
        TopicNotFound: One of the names is not there; the text lists what is, the nearest first.
    """
    found: Set[str] = set()
    for name in names:
        matches = {name} & present or {t for t in present if t.strip("/") == name.strip("/")}
        if not matches:
            raise TopicNotFound(f"there is no topic {name} in {where}; {_listing(name, present)}")
        found |= matches
    return found


def _listing(name: str, present: AbstractSet[str]) -> str:
    if not present:
        return "it has none"
    near = get_close_matches(name, sorted(present), n=LISTED, cutoff=0.4)
    every = [*near, *sorted(present - set(near))]
    more = f" and {len(every) - LISTED} more" if len(every) > LISTED else ""
    return f"it has {', '.join(every[:LISTED])}{more} ({len(every)} topics)"


def chosenConnections(reader: BagReader, topics: Iterable[str] | None) -> Set[int]:
    """Return the numbers of the connections of some topics of a bag (None = of all).

    Raises:
        TopicNotFound: The bag has no such topic.
    """
    connections = reader.connections
    if topics is None:
        return set(connections)
    names = matchTopics(topics, {c.topic for c in connections.values()}, reader.path)
    return {number for number, c in connections.items() if c.topic in names}
