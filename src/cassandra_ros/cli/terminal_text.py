# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Text for people: aligned columns, sizes, times, and a progress bar."""

from __future__ import annotations

import io
import math
import sys
from typing import Collection, Sequence

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.printable import shown

_UNITS = ("B", "KB", "MB", "GB", "TB")
_BARS = "▁▂▃▄▅▆▇█"
_WEIGHTS = ".:-=+*#@"
_LENGTHS = ((86_400, "d"), (3_600, "h"), (60, "min"), (1, "s"))


def format_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], right: Collection[str] = ()
) -> str:
    """Return a header and rows as aligned columns; the columns in ``right`` are right-aligned.

    Cells may be text from outside; they are made safe for a terminal, see printable.py.
    """
    lines = [[shown(cell) for cell in row] for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*lines)]
    return "\n".join(align(line, widths, [name in right for name in header]) for line in lines)


def align(cells: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    """Return one line of a table; ``right`` says for each column whether it is right-aligned."""
    texts = [
        text.rjust(width) if is_right else text.ljust(width)
        for text, width, is_right in zip(cells, widths, right)
    ]
    return "  ".join(texts).rstrip()


def format_bytes(count: int) -> str:
    """Return a size as rosbag prints it: 3.2 MB, of 1024 * 1024 bytes each."""
    size, unit = float(count), 0
    while size >= 1024 and unit < len(_UNITS) - 1:
        size, unit = size / 1024, unit + 1
    return f"{count} B" if not unit else f"{size:.1f} {_UNITS[unit]}"


def format_time(ns: int | None) -> str:
    """Return a time in UTC, cut to seconds; '-' for None."""
    from cassandra_ros.messages.stamps import iso_time

    return "-" if ns is None else iso_time(ns)[:19] + "Z"


def format_length(ns: int) -> str:
    """Return the length of a bucket in the largest unit that divides it: 10 min."""
    for seconds, unit in _LENGTHS:
        if ns and ns % (seconds * SECOND_NS) == 0:
            return f"{ns // (seconds * SECOND_NS)} {unit}"
    return f"{ns} ns"


def write_utf8() -> None:
    """Write standard output in UTF-8 from now on, for other programs, whatever a terminal knows."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(encoding="utf-8")


def counted(count: int, noun: str) -> str:
    """Return a number with its noun: 1 message, 2 messages."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def sparkline(values: Sequence[float], encoding: str | None) -> str:
    """Return numbers as a line of bars, scaled to the maximum; 0 is a blank.

    Args:
        values: The numbers, at least 0.
        encoding: Encoding of the terminal. If it has no bars, characters of increasing darkness
            are used instead.
    """
    bars = _BARS
    try:
        bars.encode(encoding or "ascii")
    except (UnicodeError, LookupError):
        bars = _WEIGHTS
    top = max(values, default=0)
    steps = (math.ceil(value / top * len(bars)) if value > 0 else 0 for value in values)
    return "".join(" " if not step else bars[step - 1] for step in steps)


class MessageBar:
    """A progress bar for messages. It appears after one second, on a terminal only."""

    def __init__(self, text: str, total: int | None = None, unit: str = " msg") -> None:
        from tqdm import tqdm

        # disable=None: only where standard error is a terminal.
        self._bar: tqdm[None] = tqdm(
            desc=shown(text),
            total=total,
            unit=unit,
            unit_scale=True,
            delay=1,
            leave=False,
            disable=None,
        )

    def __enter__(self) -> MessageBar:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._bar.close()

    def add(self, messages: int, size: int = 0) -> None:
        """Add a number of handled messages; the bar does not show their size."""
        self._bar.update(messages)

    def reach(self, messages: int, total: int) -> None:
        """Set the number of handled messages and the total."""
        self._bar.total = total
        self._bar.update(messages - self._bar.n)
