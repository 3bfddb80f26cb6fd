# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which runs are stored of a file, by its path, and which ones a file name of class Bag means."""

from __future__ import annotations

import os
from typing import Sequence

from cassandra_ros.tables.registry import Run

_MOST_NAMED = 3
"""Maximum number of runs that an error names."""


def source_of(path: str | os.PathLike[str]) -> str:
    """Return the path of a file as its run notes it: absolute; bytes that are no text are �."""
    return os.fsencode(os.path.abspath(path)).decode("utf-8", "replace")


def runs_of_file(runs: Sequence[Run], path: str) -> list[Run]:
    """Return the runs whose source is this file, whatever links lead to it."""
    ways = {source_of(path), source_of(_real(path))}
    return [run for run in runs if run.source and ways & {run.source, _real(run.source)}]


def _real(path: str) -> str:
    try:
        return os.path.realpath(path)
    except ValueError:  # a NUL is in it: no file is called so
        return path


def runs_meant(runs: Sequence[Run], name: str) -> list[Run]:
    """Return the runs that a file name of class Bag means; [] = no run.

    The runs of that very file come first. Where no run has this file as its source, the name is
    looked up among the names and writer ids of runs, unless a file of that name exists here: that
    file is not stored.
    """
    found = runs_of_file(runs, name)
    if found or os.path.isfile(name):
        return found
    return [run for run in runs if name and name in (run.name, str(run.writer))]


def told_alike(runs: Sequence[Run], path: str) -> str:
    """Name the runs of other files that have this base name; '' = no other file has it."""
    name = os.path.basename(path)
    alike = [run for run in runs if run.name == name and name]
    told = [
        f"{run.source} (open it as Bag({run.source!r}) or Bag('{run.writer}'))"
        if run.source
        else f"no file (open it as Bag('{run.writer}'))"
        for run in alike[:_MOST_NAMED]
    ]
    if len(alike) > _MOST_NAMED:
        told.append(f"{len(alike) - _MOST_NAMED} more")
    return f"the stored run {name!r:.80} is of {', of '.join(told)}" if told else ""
