# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What an experiment is given: the server, a folder, how much to measure, where results go."""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Callable, Iterator, TypeVar

from suite.results import Results, quartiles
from suite.server import Server
from suite.sizes import Size

Value = TypeVar("Value")


@dataclass
class Context:
    """A run of the benchmark."""

    size: Size
    server: Server
    folder: Path
    """Empty at the beginning; for bags and the like."""
    results: Results
    experiment: str = ""
    """The one that runs."""
    shared: dict[str, Any] = field(default_factory=dict)
    """What one experiment leaves to the others, by name."""

    def say(self, text: str) -> None:
        """Tell how far it is."""
        print(text, flush=True)

    def add(self, what: str, contender: str, values: Any, unit: str, **names: Any) -> None:
        """Note samples, one or several, and print them."""
        values = list(values) if isinstance(values, (list, tuple)) else [values]
        self.results.add(self.experiment, what, contender, values, unit, **names)
        low, middle, high = quartiles(values)
        spread = f"  ({low:,.4g} to {high:,.4g})" if len(values) > 1 else ""
        about = " ".join(
            f"{value:,}" if not isinstance(value, str) else value for value in names.values()
        )
        self.say(f"  {about:20} {what:28} {contender:16} {middle:12,.4g} {unit}{spread}")

    @contextlib.contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Go on behind what fails: it is noted as failed."""
        try:
            yield
        except Exception as exc:  # noqa: BLE001 - whatever a contender raises, the others go on
            traceback.print_exc()
            text = f"{type(exc).__name__}: {exc}"
            self.say(f"  FAILED {name}: {text[:500]}")
            failure = {"experiment": self.experiment, "part": name, "error": text[:500]}
            self.results.failures.append(failure)

    @contextlib.contextmanager
    def new_folder(self, name: str) -> Iterator[Path]:
        """Yield an empty folder that is removed afterwards."""
        folder = self.folder / name
        folder.mkdir()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


@dataclass
class Costs:
    """What something took."""

    seconds: float
    client_cpu: float
    """Processor time of this process, s."""
    server_cpu: float | None
    """Processor time of the server, s; None = it is not ours."""


def measure(server: Server, work: Callable[[], Value]) -> tuple[Costs, Value]:
    """Do something; return its costs and its result."""
    before, cpu, start = server.cpu(), time.process_time(), time.perf_counter()
    found = work()
    seconds, client = time.perf_counter() - start, time.process_time() - cpu
    after = server.cpu()
    theirs = None if before is None or after is None else after - before
    return Costs(seconds, client, theirs), found


def timed(work: Callable[[], Any]) -> float:
    """Return the seconds that something takes."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def rotated(names: list[str], number: int) -> list[str]:
    """Return the names in another order for each round."""
    at = number % len(names)
    return names[at:] + names[:at]


def warn(text: str) -> None:
    """Tell on standard error."""
    print(text, file=sys.stderr, flush=True)
