# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Alignment of runs of different days to one start, and a name prefix for each robot."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Mapping, Sequence

from cassandra_ros.errors import InvalidOption
from cassandra_ros.playing.play_source import PlaySource
from cassandra_ros.playing.stored_ranges import StoredRange
from cassandra_ros.read import Whose
from cassandra_ros.topics.overview.latched_messages import Source


def check_alignment(align: object) -> str:
    """Return 'run', 'node', or '' for no alignment, or raise InvalidOption."""
    alignments = {False: "", True: "run", "": "", "run": "run", "node": "node"}
    if isinstance(align, (bool, str)) and align in alignments:
        return alignments[align]
    raise InvalidOption(f"align_start {align!r:.80} is neither 'run' nor 'node'")


def split_sources(source: PlaySource, align: str) -> list[PlaySource]:
    """Divide a source into sources that are aligned with each other: its runs or its robots."""
    groups: dict[Source, list[StoredRange]] = {}
    for stored_range in source.stored_ranges:
        writer = 0 if align == "node" and stored_range.node else stored_range.writer
        groups.setdefault((stored_range.node, writer), []).append(stored_range)
    sources = []
    for (node, writer), ranges in sorted(groups.items()):
        writers = source.whose.writers if align == "node" and node else frozenset([writer])
        whose = Whose((node,), writers)
        sources.append(replace(source, whose=whose, stored_ranges=tuple(ranges)))
    return sources


def aligned(sources: Sequence[PlaySource]) -> list[PlaySource]:
    """Shift sources so that their first selected messages have the time of the earliest one."""
    start = min(source.begin for source in sources)
    return [replace(source, shift=start - source.begin) for source in sources]


def source_names(
    stored_ranges: Sequence[StoredRange], run_names: Mapping[int, str], align: str
) -> dict[Source, str]:
    """Return for each robot and writer a valid ROS name to stand before its topics.

    It is the nodeID, else the run's name, else run_<writer id>. When several runs of one robot are
    aligned with each other, it is nodeID and run. Names that would be equal are numbered.
    """
    firsts: dict[Source, int] = {}
    for e in stored_ranges:
        source = (e.node, e.writer)
        firsts[source] = min(e.first, firsts.get(source, e.first))
    given: dict[Source, str] = {}
    taken: dict[str, tuple[str, str]] = {}
    for node, writer in sorted(firsts, key=lambda source: (firsts[source], source)):
        run = run_names.get(writer) or f"run_{writer}"
        runs_of_node = {w for n, w in firsts if n == node}
        told_apart = not node or (align == "run" and len(runs_of_node) > 1)
        text = f"{node}_{run}" if node and told_apart else node or run
        # All runs of one robot share its name unless they are aligned with each other.
        owner = (node, str(writer) if told_apart else "")
        name, number = valid_name(text), 1
        while taken.setdefault(name, owner) != owner:
            number += 1
            name = f"{valid_name(text)}_{number}"
        given[node, writer] = name
    return given


def valid_name(text: str) -> str:
    """Return a text as a name that is valid between two slashes in ROS: /<name>/topic."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)
    return name if name[:1].isalpha() else f"node_{name}"
