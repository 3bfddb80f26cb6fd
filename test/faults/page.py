# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Fill the tables of doc/faults.md from the results: python -m faults.page [--check]."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

from faults.results import RESULTS, Results
from faults.table import FAULTS
from faults.trial import Result

PAGE = Path(__file__).resolve().parents[2] / "doc/faults.md"
TITLES = {
    "recorder": "The recorder, and ROS around it",
    "store": "Cassandra, and the network before it",
    "verb": "Verbs",
    "copy": "A robot that is copied home",
    "cluster": "Three nodes",
}
COLUMNS = {
    "published": "published",
    "stored": "stored",
    "removed": "removed",
    "unheard": "unheard",
    "in flight": "in_flight",
    "told lost": "lost",
    "unaccounted": "unaccounted",
    "doubled": "doubled",
    "changed": "changed",
}


def summary(result: Result) -> str:
    """Return a line for the terminal."""
    if result.skipped:
        return f"skipped: {result.skipped}"
    sums = ", ".join(f"{name} {result.sums[key]}" for name, key in COLUMNS.items())
    check = f"; CHECK: {result.check}" if result.check else ""
    normal = "" if result.normal_sec is None else f"; normal after {result.normal_sec} s"
    reasons = f" {result.sums['lost_by_reason']}" if result.sums["lost_by_reason"] else ""
    return f"{sums}{reasons}{normal}; {result.seconds:.0f} s{check} {'; '.join(result.notes)}"


def fill(text: str, results: Results) -> str:
    """Return the text of the page with the tables made anew."""
    for group in TITLES:
        begin, end = f"<!-- faults:{group} -->", f"<!-- /faults:{group} -->"
        table = table_of(group, results.lines)
        pattern = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
        text = pattern.sub(lambda _, t=table, b=begin, e=end: f"{b}\n{t}\n{e}", text)
    return text


def table_of(group: str, lines: dict[str, dict[str, Any]]) -> str:
    """Return the table of a group of faults, in the order in which they are run."""
    head = ["fault", *COLUMNS, "until normal", "check"]
    rows = [head, ["---", *["---:"] * (len(head) - 2), "---"]]
    below = []
    for name, fault in FAULTS.items():
        if fault.group == group:
            line = lines.get(name)
            rows.append([f"`{name}`", *_cells(line, len(head) - 1)])
            below.append(f"- `{name}`: {fault.done}{_run(line)}")
    if not below:
        return "No fault of this group has run yet."
    return "\n".join([*(f"| {' | '.join(row)} |" for row in rows), "", *below])


def _cells(line: dict[str, Any] | None, count: int) -> list[str]:
    if line is None or line["skipped"]:
        return ["-"] * count
    sums = [f"{line['sums'][key]:,}" for key in COLUMNS.values()]
    normal = "-" if line["normal_sec"] is None else f"{line['normal_sec']:.1f} s"
    return [*sums, normal, "finds something" if line["check"] else "finds nothing"]


def _run(line: dict[str, Any] | None) -> str:
    if line is None:
        return " Not run yet."
    if line["skipped"]:
        return f" Skipped: {line['skipped']}."
    notes = "".join(f" {note[0].upper()}{note[1:]}." for note in line["notes"])
    form = "Short form" if line["short"] else "Long form"
    return f"{notes} {form}, commit {line['commit']}, {line['date']}, {line['machine']}."


def main() -> int:
    """Write the page; with --check only tell whether it agrees with the results."""
    text = PAGE.read_text(encoding="utf-8")
    filled = fill(text, Results.load(RESULTS))
    if "--check" in sys.argv[1:]:
        return int(filled != text)
    PAGE.write_text(filled, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
