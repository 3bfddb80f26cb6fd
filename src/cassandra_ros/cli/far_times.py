# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Check of the times of options against those of what is stored: a wrong unit, a wrong year."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Iterable

from cassandra_ros.cli.parsers import error_line
from cassandra_ros.cli.terminal_text import format_duration
from cassandra_ros.errors import InvalidKey, InvalidOption

if TYPE_CHECKING:
    from cassandra_ros.messages.stamps import Stamp
    from cassandra_ros.topics.catalog import Catalog

_DAY_NS = 86_400 * 10**9
_FAR_NS = 365 * _DAY_NS
"""Distance from what is stored above which a limit that limits nothing is told, ns. One that leaves
out everything is told from a day on."""


def read_time(option: str, text: str | None) -> Stamp | None:
    """Return the time in the text of an option; None = the option is missing."""
    from cassandra_ros.messages.stamps import Stamp, written_time_ns

    if text is None:
        return None
    try:
        # A Stamp: as a key, an integer of nanoseconds that looks like seconds is refused.
        return Stamp.from_ns(written_time_ns(text))
    except InvalidKey as exc:
        raise InvalidOption(f"--{option} {exc}") from exc


def check_times(options: argparse.Namespace, catalogs: Iterable[Catalog]) -> None:
    """Tell on stderr of times that lie far outside of what is stored; nothing if it is empty.

    Args:
        options: Those that ``time_options`` names are times as for ``read_time``; None = none.
        catalogs: The topics of the keyspaces that are read.

    Raises:
        InvalidOption: A number was meant as ms or us, as the times that are stored show, or a text
            is no time.
    """
    texts = {name: getattr(options, name) for name in getattr(options, "time_options", ())}
    times = {name: read_time(name, text) for name, text in texts.items()}
    ends = _ends(catalogs) if any(time is not None for time in times.values()) else None
    if ends is None:
        return
    for name, time in times.items():
        if time is None:
            continue
        typed = f"--{name} {texts[name]}"
        _refuse_unit(typed, texts[name], time.ns, ends[0])
        distance = _distance(name, time.ns, ends)
        if distance and not getattr(options, "quiet", False):
            print(error_line("cassandra_bag", f"{typed} lies {distance}"), file=sys.stderr)


def _ends(catalogs: Iterable[Catalog]) -> tuple[int, int] | None:
    """Return the times of the first and the last message, ns; None = no message."""
    from cassandra_ros.overview.timeline.directory_reader import DirectoryReader
    from cassandra_ros.read import EVERYBODY

    extents = [
        DirectoryReader(catalog.keyspace.directory).extent(catalog.tables(None), EVERYBODY)
        for catalog in catalogs
    ]
    times = [time for extent in extents if extent is not None for time in extent]
    return (min(times), max(times)) if times else None


def _refuse_unit(typed: str, text: str, ns: int, first_ns: int) -> None:
    from cassandra_ros.messages.stamps import iso_time, other_unit

    meant = other_unit(text, first_ns) if text.strip() == str(ns) else ""
    if meant:
        raise InvalidOption(
            f"{typed} means nanoseconds since 1970, {iso_time(ns)}, long before the first stored "
            f"message, {iso_time(first_ns)}; {meant}"
        )


def _distance(name: str, ns: int, ends: tuple[int, int]) -> str:
    """Return how far outside of what is stored a time lies; '' = not far."""
    from cassandra_ros.messages.stamps import iso_time

    first, last = ends
    if ns < first - (_DAY_NS if name == "end" else _FAR_NS):
        return f"{format_duration(first - ns)} before the first stored message, {iso_time(first)}"
    if ns > last + (_DAY_NS if name == "start" else _FAR_NS):
        return f"{format_duration(ns - last)} after the last stored message, {iso_time(last)}"
    return ""
