# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The first and the last stored time, and times that lie far outside: a wrong unit or year."""

from __future__ import annotations

from typing import Iterable, Tuple

from cassandra_ros.messages.stamps import iso_time, other_unit
from cassandra_ros.printable import format_duration
from cassandra_ros.read import EVERYBODY
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.overview.timeline.directory_reader import DirectoryReader

Ends = Tuple[int, int]
"""Times of the first and the last message, ns."""
_DAY_NS = 86_400 * 10**9
_FAR_NS = 365 * _DAY_NS
"""Distance from what is stored above which a limit that leaves out nothing is told, ns. One that
leaves out everything is told from a day on."""


def stored_ends(catalog: Catalog) -> Ends | None:
    """Return the times of the first and the last message of a keyspace; None = no message."""
    return DirectoryReader(catalog.keyspace.directory).extent(catalog.tables(None), EVERYBODY)


def widest(all_ends: Iterable[Ends | None]) -> Ends | None:
    """Return the ends of several keyspaces together; None = no message."""
    times = [time for ends in all_ends if ends is not None for time in ends]
    return (min(times), max(times)) if times else None


def wrong_unit(text: str, ns: int, ends: Ends) -> str:
    """Say that a number of ns was meant as ms or us; '' = it was not.

    Args:
        text: The time as it was typed.
        ns: The time that it means.
    """
    unit_text = other_unit(text, ends[0]) if text.strip() == str(ns) else ""
    if not unit_text:
        return ""
    return (
        f"means nanoseconds since 1970, {iso_time(ns)}, long before the first stored message, "
        f"{iso_time(ends[0])}; {unit_text}"
    )


def far_outside(limit: str, ns: int, ends: Ends, which: str = "stored") -> str:
    """Say how far outside of what is stored a time lies; '' = not far.

    Args:
        limit: What the time is: 'start', 'end', or another name for a time that is shown.
        which: Which messages the ends are of, as an adjective.
    """
    first, last = ends
    if ns < first - (_FAR_NS if limit == "start" else _DAY_NS):
        distance = format_duration(first - ns)
        return f"lies {distance} before the first {which} message, {iso_time(first)}"
    if ns > last + (_FAR_NS if limit == "end" else _DAY_NS):
        return f"lies {format_duration(ns - last)} after the last {which} message, {iso_time(last)}"
    return ""
