# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Plots of a run, in the manner of the paper's figures."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any, Callable

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from suite import paper
from suite.messages import NAMES
from suite.results import Results, Series, quartiles

COLOURS = {
    "packed": "#1b7837",
    "binary": "#5aae61",
    "ros": "#2166ac",
    "ros, indexes": "#92c5de",
    "rosbag": "#b2182b",
    "mcap": "#ef8a62",
    "sqlite": "#8073ac",
    "bare driver": "#4d4d4d",
}
DPI = 110


def save_all(results: Results, folder: Path, name: str) -> list[Path]:
    """Draw what was measured; return the files."""
    figures: dict[str, Callable[[Results, Any], None]] = {
        "fig5a-size": _size,
        "fig5b-write": _write_time,
        "fig6-lookups": _lookups,
        "fig7-clauses": _clauses,
        "writing": _writing,
    }
    needs = {"fig5a-size": "growth", "fig5b-write": "growth", "fig6-lookups": "lookups"}
    needs.update({"fig7-clauses": "clauses", "writing": "writing"})
    made = []
    for figure, draw in figures.items():
        if not results.of(needs[figure]):
            continue
        image, axes = plt.subplots(figsize=(9.5, 4.5))
        draw(results, axes)
        path = folder / f"{name}-{figure}.png"
        image.tight_layout()
        image.savefig(str(path), dpi=DPI, metadata={"Software": None})
        plt.close(image)
        made.append(path)
    return made


def _legend(axes: Any) -> None:
    """Put the legend beside the picture: nothing in it is hidden."""
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False)


def _by_contender(series: list[Series]) -> dict[str, list[Series]]:
    found: dict[str, list[Series]] = {}
    for one in sorted(series, key=lambda one: one.x or 0):
        found.setdefault(one.contender, []).append(one)
    return found


def _size(results: Results, axes: Any) -> None:
    for name, series in _by_contender(results.of("growth", "size")).items():
        xs, ys = [s.x for s in series], [s.values[0] for s in series]
        axes.plot(xs, ys, "o-", label=name, color=COLOURS.get(name))
    axes.set(xscale="log", yscale="log", xlabel="messages stored", ylabel="bytes a message")
    axes.set_title("Size on disk after flush (paper: figure 5a)")
    axes.grid(alpha=0.3)
    _legend(axes)


def _write_time(results: Results, axes: Any) -> None:
    for one in results.of("growth", "write, by part of all"):
        count = len(one.values)
        xs = [(one.x or 0) * (i + 0.5) / count for i in range(count)]
        axes.plot(xs, one.values, label=one.contender, color=COLOURS.get(one.contender))
    axes.set(yscale="log", xlabel="messages stored already", ylabel="µs a message")
    axes.set_title("Time of a write (paper: figure 5b)")
    axes.grid(alpha=0.3)
    _legend(axes)


def _lookups(results: Results, axes: Any) -> None:
    found = _by_contender(results.of("lookups", "lookup"))
    names = [name for name in COLOURS if name in found]
    steps = sorted({s.x for s in results.of("lookups", "lookup")})
    for place, name in enumerate(names):
        for s in found[name]:
            at = steps.index(s.x) + (place - len(names) / 2 + 0.5) * 0.8 / len(names)
            box = axes.boxplot(
                s.values, positions=[at], widths=0.7 / len(names), sym="", patch_artist=True
            )
            box["boxes"][0].set_facecolor(COLOURS[name])
            box["medians"][0].set_color("black")
        axes.plot([], [], "s", color=COLOURS[name], label=name)
    marks = {"Cassandra": "*", "MongoDB, index": "P", "MongoDB": "X"}
    for name, values in paper.LOOKUP_MS.items():
        at = [steps.index(x) for x in values if x in steps]
        ys = [y for x, y in values.items() if x in steps]
        axes.plot(at, ys, marks[name], color="black", label=f"{name} ({paper.SOURCE}, quoted)")
    axes.set_xticks(range(len(steps)), [f"{x:,.0f}" for x in steps])
    axes.set(yscale="log", xlabel="messages stored", ylabel="ms")
    axes.set_title("Lookups by key (paper: figure 6)")
    axes.grid(alpha=0.3, axis="y")
    _legend(axes)


def _clauses(results: Results, axes: Any) -> None:
    for name, series in _by_contender(results.of("clauses", "clause")).items():
        points = [(max(s.x or 0, 0.5), y) for s in series for y in s.values]
        axes.scatter(*zip(*points), label=name, color=COLOURS.get(name), s=16)
    for name, series in _by_contender(results.of("clauses", "scan")).items():
        last = series[-1]
        label = f"{name}: scan of {last.x:,.0f}"
        axes.axhline(statistics.median(last.values), color=COLOURS.get(name), ls="--", label=label)
    label = f"Cassandra ({paper.SOURCE}, quoted)"
    axes.plot(*zip(*paper.QUERY_SEC["Cassandra"].items()), "*", color="black", label=label)
    most = max(paper.BAG_SCAN_SEC)
    label = f"bag scan of {most:,} ({paper.SOURCE}, quoted)"
    axes.axhline(paper.BAG_SCAN_SEC[most], color="black", ls=":", label=label)
    axes.set(xscale="log", yscale="log", xlabel="messages returned (0.5: none)", ylabel="s")
    axes.set_title("Random WHERE clauses (paper: figure 7)")
    axes.grid(alpha=0.3)
    _legend(axes)


def _writing(results: Results, axes: Any) -> None:
    """Draw writing and reading as multiples of rosbag."""
    kinds = [kind for kind in NAMES if results.find("writing", "write", "rosbag", kind)]
    names = [n for n in COLOURS if n != "rosbag" and results.find("writing", "write", n, kinds[0])]
    for place, name in enumerate(names):
        for at, kind in enumerate(kinds):
            base = results.median("writing", "write", "rosbag", kind)
            values = results.find("writing", "write", name, kind)
            if not values or not base:
                continue
            low, middle, high = (value / base for value in quartiles(values))
            x = at + (place - len(names) / 2 + 0.5) * 0.8 / len(names)
            axes.bar(x, middle, width=0.75 / len(names), color=COLOURS[name])
            axes.plot([x, x], [low, high], color="black", lw=0.8)
        axes.plot([], [], "s", color=COLOURS[name], label=name)
    axes.axhline(1, color=COLOURS["rosbag"], label="rosbag")
    axes.set_xticks(range(len(kinds)), kinds)
    axes.set(yscale="log", ylabel="x rosbag")
    axes.set_title("Messages written a second, as multiples of rosbag's")
    _legend(axes)
