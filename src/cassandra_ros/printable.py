# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Safe text for terminals, durations, and tables and names for interactive Python.

Names of runs, topics, robots and labels come from bags, publishers and other clients. All text that
is printed passes one of these functions, so that no escape sequence reaches the terminal.
"""

from __future__ import annotations

import html
from typing import Callable, Container, Iterable, List, Mapping, Sequence, TypeVar

NOTEBOOK_ROWS = 60
"""Maximum number of rows of a table that is shown in a notebook, as in pandas."""

MOST_CHARACTERS = 256
"""Maximum number of characters of a name that are shown, which is the maximum of a new name."""

_SECOND_NS = 10**9
_YEAR_SEC = 365.25 * 86_400
_LONG = ((_YEAR_SEC, _YEAR_SEC, "years"), (360_000, 86_400, "days"))
"""From how many seconds on a duration is given in a unit, the unit's length, and its name."""

_Item = TypeVar("_Item")


def shown(text: str, most: int | None = MOST_CHARACTERS) -> str:
    """Return text from outside as one line that is safe for a terminal.

    Args:
        text: The text. Characters that are not printable, also line breaks, are escaped.
        most: Maximum number of characters; a longer text ends in '…'. None = no limit.
    """
    line = text if most is None else text[: most + 1]
    if not line.isprintable():
        line = "".join(map(_printable, line))
    return line if most is None or len(line) <= most else line[: most - 1] + "…"


def shown_lines(text: str) -> str:
    """Return text of several lines that is safe for a terminal.

    Line breaks and tabs are kept; all other characters that are not printable are escaped.
    """
    if text.replace("\n", "").replace("\t", "").isprintable():
        return text
    return "".join(c if c in "\n\t" else _printable(c) for c in text)


def format_duration(ns: int) -> str:
    """Return a duration as rosbag info prints it: 37.9s, 1:38s (98s), 2hr 1:38s (7298s).

    From 100 hours on they are given in days or years: 4.2 days (360000s), 2.0 years (63115200s).
    """
    total = ns // _SECOND_NS
    for least, length, unit in _LONG:
        if total >= least:
            return f"{total / length:.1f} {unit} ({total}s)"
    minutes, seconds = divmod(total, 60)
    if not minutes:
        return f"{ns / _SECOND_NS:.1f}s"
    hours, minutes = divmod(minutes, 60)
    return f"{f'{hours}hr ' if hours else ''}{minutes}:{seconds:02d}s ({total}s)"


def _printable(c: str) -> str:
    return c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode("ascii")


def public_names(thing: object, inner: Container[str]) -> list[str]:
    """Return the names that dir() lists: all but those that begin with _ and those in ``inner``."""
    names = object.__dir__(thing)
    return sorted(name for name in names if not name.startswith("_") and name not in inner)


def html_table(
    columns: Sequence[str], rows: Sequence[Sequence[object]], of: int | None = None
) -> str:
    """Return the first NOTEBOOK_ROWS rows of a table as HTML for a notebook; texts are escaped.

    Args:
        columns: Headings.
        rows: Rows of cells.
        of: Number of rows of the whole table; None = ``rows`` are all rows.
    """
    of = len(rows) if of is None else of
    parts = ["<table><thead>", _html_row("th", columns), "</thead><tbody>"]
    parts += [_html_row("td", row) for row in rows[:NOTEBOOK_ROWS]]
    parts.append("</tbody></table>")
    if of > NOTEBOOK_ROWS:
        parts.append(f"<p>{NOTEBOOK_ROWS} of {of} rows</p>")
    return "".join(parts)


def _html_row(tag: str, values: Iterable[object]) -> str:
    cells = (f"<{tag}>{html.escape(str(value))}</{tag}>" for value in values)
    return f"<tr>{''.join(cells)}</tr>"


class PrintableList(List[_Item]):
    """A list that is shown with one item per line, and in a notebook as a table.

    Attributes:
        COLUMNS: Heading -> function that returns the cell of an item.
    """

    COLUMNS: Mapping[str, Callable[[_Item], object]]

    def __repr__(self) -> str:
        return f"[{f',{chr(10)} '.join(map(repr, self))}]"

    def _repr_html_(self) -> str:
        rows = [[value(item) for value in self.COLUMNS.values()] for item in self]
        return html_table(tuple(self.COLUMNS), rows)
