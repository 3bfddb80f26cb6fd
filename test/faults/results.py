# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The file of results: the last line of each fault, with its commit and its machine."""

from __future__ import annotations

import datetime
import json
import os
import platform
import subprocess
from dataclasses import asdict
from pathlib import Path
from typing import Any

import psutil

from faults.trial import Result

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "test/faults/results/faults.json"


class Results:
    """Lines of the fault table by the name of the fault."""

    def __init__(self, lines: dict[str, dict[str, Any]]) -> None:
        self.lines = lines

    @classmethod
    def load(cls, path: Path) -> Results:
        """Read a file; one that does not exist has no lines."""
        return cls(json.loads(path.read_text(encoding="utf-8")) if path.exists() else {})

    def put(self, result: Result) -> Results:
        """Replace the line of a fault; return these results."""
        self.lines[result.name] = {**asdict(result), **_surroundings()}
        return self

    def save(self, path: Path) -> None:
        """Write the file."""
        text = json.dumps(self.lines, indent=1, sort_keys=True)
        path.write_text(text + "\n", encoding="utf-8")


def _surroundings() -> dict[str, Any]:
    git = ["git", "-C", str(ROOT)]
    commit = subprocess.run([*git, "rev-parse", "--short", "HEAD"], capture_output=True, text=True)
    return {
        "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat(),
        "commit": commit.stdout.strip(),
        "machine": f"{len(os.sched_getaffinity(0))} cores, "
        f"{psutil.virtual_memory().total / 2**30:.0f} GiB, {platform.system()}",
    }
