# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Find the stored runs of a file by its path, and the runs that a file name of class Bag means."""

from __future__ import annotations

import os
from typing import Sequence

from cassandra_ros.tables.registry import Run

_MOST_NAMED = 3
"""Maximum number of runs named in an error text."""


def source_of(path: str | os.PathLike[str]) -> str:
    """Return the absolute path of a file as it is stored with a run; invalid UTF-8 becomes �."""
    return os.fsencode(os.path.abspath(path)).decode("utf-8", "replace")


def runs_of_file(runs: Sequence[Run], path: str) -> list[Run]:
    """Return the runs whose source is this file, with or without symbolic links in the path."""
    ways = {source_of(path), source_of(_real(path))}
    return [run for run in runs if run.source and ways & {run.source, _real(run.source)}]


def _real(path: str) -> str:
    try:
        return os.path.realpath(path)
    except ValueError:  # the path contains NUL, so there is no such file
        return path


def runs_meant(runs: Sequence[Run], name: str) -> list[Run]:
    """Return the runs that a file name of class Bag means; [] = no run.

    These are the runs whose source is this file. If no run has it and no such file exists here,
    they are the runs with this name or writer id.
    """
    found = runs_of_file(runs, name)
    if found or os.path.isfile(name):
        return found
    return [run for run in runs if name and name in (run.name, str(run.writer))]


def describe_same_name(runs: Sequence[Run], path: str) -> str:
    """Name the runs of other files that have this base name; '' = no other file has it."""
    name = os.path.basename(path)
    alike = [run for run in runs if run.name == name and name]
    descriptions = [
        f"{run.source} (open it as Bag({run.source!r}) or Bag('{run.writer}'))"
        if run.source
        else f"no file (open it as Bag('{run.writer}'))"
        for run in alike[:_MOST_NAMED]
    ]
    if len(alike) > _MOST_NAMED:
        descriptions.append(f"{len(alike) - _MOST_NAMED} more")
    if not descriptions:
        return ""
    return f"the stored run {name!r:.80} is of {', of '.join(descriptions)}"
