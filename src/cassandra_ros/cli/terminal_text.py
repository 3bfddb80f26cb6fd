# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What people see: aligned columns, sizes, times, and a bar while they wait."""

from __future__ import annotations

import math
from typing import Collection, Sequence

from tqdm import tqdm

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.printable import shown

_UNITS = ("B", "KB", "MB", "GB", "TB")
_BARS = "▁▂▃▄▅▆▇█"
_WEIGHTS = ".:-=+*#@"
_LENGTHS = ((86_400, "d"), (3_600, "h"), (60, "min"), (1, "s"))


def format_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[str] = ()
) -> str:
    """Align rows under a header, the columns named ``right`` on the right.

    Each cell may be text from outside; see printable.py.
    """
    lines = [[shown(cell) for cell in row] for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*lines)]
    return "\n".join(align(line, widths, [name in right for name in header]) for line in lines)


def align(cells: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    """Write one line of a table."""
    found = zip(cells, widths, right)
    texts = [text.rjust(width) if last else text.ljust(width) for text, width, last in found]
    return "  ".join(texts).rstrip()


def format_bytes(count: int) -> str:
    """Write a size as rosbag does: 3.2 MB."""
    size, unit = float(count), 0
    while size >= 1024 and unit < len(_UNITS) - 1:
        size, unit = size / 1024, unit + 1
    return f"{count} B" if not unit else f"{size:.1f} {_UNITS[unit]}"


def format_time(ns: int | None) -> str:
    """Write a time in UTC, cut to seconds; '-' where there is none."""
    return "-" if ns is None else iso_time(ns)[:19] + "Z"


def format_length(ns: int) -> str:
    """Write the length of a bucket: 10 min."""
    for seconds, unit in _LENGTHS:
        if ns and ns % (seconds * SECOND_NS) == 0:
            return f"{ns // (seconds * SECOND_NS)} {unit}"
    return f"{ns} ns"


def counted(count: int, noun: str) -> str:
    """Write a number of things: 1 message, 2 messages."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def format_duration(ns: int) -> str:
    """Write a duration as rosbag info does: 37.9s, 1:38s (98s), 2hr 1:38s (7298s)."""
    total = ns // SECOND_NS
    minutes, seconds = divmod(total, 60)
    if not minutes:
        return f"{ns / SECOND_NS:.1f}s"
    hours, minutes = divmod(minutes, 60)
    return f"{f'{hours}hr ' if hours else ''}{minutes}:{seconds:02d}s ({total}s)"


def sparkline(values: Sequence[float], encoding: str | None) -> str:
    """Draw numbers of 0 or more as a line of bars, the tallest for the greatest; 0 is a blank.

    Args:
        encoding: Of where it is shown: where it has no bars, signs of growing weight stand for
            them.
    """
    bars = _BARS
    try:
        bars.encode(encoding or "ascii")
    except (UnicodeError, LookupError):
        bars = _WEIGHTS
    top = max(values, default=0)
    steps = (math.ceil(value / top * len(bars)) if value > 0 else 0 for value in values)
    return "".join(" " if not step else bars[step - 1] for step in steps)


class MessageBar(tqdm):
    """Shows on a terminal how many messages are done, from the second second on."""

    def __init__(self, text: str, total: int | None = None) -> None:
        # disable=None: only where standard error is a terminal.
        super().__init__(
            desc=shown(text),
            total=total,
            unit=" msg",
            unit_scale=True,
            delay=1,
            leave=False,
            disable=None,
        )

    def add(self, messages: int, size: int = 0) -> None:
        """Count messages as done."""
        self.update(messages)

    def reach(self, messages: int, total: int) -> None:
        """Say how many messages are done, of how many."""
        self.total = total
        self.update(messages - self.n)
