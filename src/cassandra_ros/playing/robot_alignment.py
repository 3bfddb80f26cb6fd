# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs of different days as if at once, and a prefix for each robot."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Dict, List, Mapping, Sequence, Tuple

from cassandra_ros.errors import InvalidOption
from cassandra_ros.overview.latched_messages import Source
from cassandra_ros.playing.extent import Extent
from cassandra_ros.playing.part import Part


def check_alignment(align: object) -> str:
    """Return 'run', 'node', or '' for none, or raise InvalidOption."""
    known = {False: "", True: "run", "": "", "run": "run", "node": "node"}
    if isinstance(align, (bool, str)) and align in known:
        return known[align]
    raise InvalidOption(f"align_start {align!r:.80} is neither 'run' nor 'node'")


def split_parts(part: Part, align: str) -> List[Part]:
    """Divide a part into those that are to begin at once: its runs, or its nodes."""
    groups: Dict[Source, List[Extent]] = {}
    for extent in part.extents:
        writer = 0 if align == "node" and extent.node else extent.writer
        groups.setdefault((extent.node, writer), []).append(extent)
    return [
        replace(
            part,
            node=node,
            writers=part.writers if align == "node" and node else frozenset([writer]),
            extents=tuple(extents),
        )
        for (node, writer), extents in sorted(groups.items())
    ]


def aligned(parts: Sequence[Part]) -> List[Part]:
    """Shift parts so that the first chosen message of each lies where the earliest one does."""
    start = min(part.begin for part in parts)
    return [replace(part, shift=start - part.begin) for part in parts]


def source_names(
    extents: Sequence[Extent], run_names: Mapping[int, str], align: str
) -> Dict[Source, str]:
    """Give each source the name that stands before its topics, a valid one in ROS.

    That is its nodeID, or the run's name, or run_<writer id>. Where several runs of a node are
    aligned with each other, each has its own: nodeID and run. Two that would be equal are numbered.
    """
    firsts: Dict[Source, int] = {}
    for e in extents:
        source = (e.node, e.writer)
        firsts[source] = min(e.first, firsts.get(source, e.first))
    given: Dict[Source, str] = {}
    taken: Dict[str, Tuple[str, str]] = {}
    for node, writer in sorted(firsts, key=lambda source: (firsts[source], source)):
        run = run_names.get(writer) or f"run_{writer}"
        runs_of_node = {w for n, w in firsts if n == node}
        told_apart = not node or (align == "run" and len(runs_of_node) > 1)
        text = f"{node}_{run}" if node and told_apart else node or run
        # Whoever has the same name by right: all runs of one node that are not told apart.
        owner = (node, str(writer) if told_apart else "")
        name, number = valid_name(text), 1
        while taken.setdefault(name, owner) != owner:
            number += 1
            name = f"{valid_name(text)}_{number}"
        given[node, writer] = name
    return given


def valid_name(text: str) -> str:
    """Make any text a name that may stand between two slashes in ROS: /<name>/topic."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", text)
    return name if name[:1].isalpha() else f"node_{name}"
