# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Gives a target many changed inputs: each is answered or refused by an error of this package.

Input number n of a target is always the same, so a failure is repeated by what its text says:
``--inputs 1 --first n``.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import os
import random
import re
import signal
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import pytest

from cassandra_ros.errors import CassandraRosError

INPUT_SEC = 10.0
"""Maximum processor time of one input, s; the machine may be loaded, so the clock tells nothing."""
HANG_SEC = 120.0
"""Time after which an input that does not end is taken to hang, s."""
GROWTH_MB = 200
"""Maximum growth of the memory of this process, and of each watched one, over all inputs, MB."""
LEAVE_SEC = 180.0
"""Time that threads and processes of the last inputs have to end, s."""
_WARM = 0.05
"""Share of the inputs after which the memory is measured first: caches are filled then."""


class Refused(Exception):  # noqa: N818 - it is not a failure
    """Another program refused the input as it should; its text is the kind of refusal."""


@dataclass
class Report:
    """What became of the inputs of a target."""

    target: str
    first: int
    answered: int = 0
    refused: Counter = field(default_factory=Counter)
    slowest_sec: float = 0.0
    slowest: int = 0
    seconds: float = 0.0
    grown_mb: float = 0.0
    found: dict = field(default_factory=dict)

    def __str__(self):
        refused = sum(self.refused.values())
        kinds = ", ".join(f"{kind} {n:,}" for kind, n in self.refused.most_common(4))
        return (
            f"hostile {self.target}: {self.answered + refused:,} inputs from number {self.first}, "
            f"{self.answered:,} answered, {refused:,} refused ({kinds}), {self.seconds:.0f} s of "
            f"processor time, slowest {self.slowest_sec * 1000:.0f} ms (number {self.slowest}), "
            f"memory +{self.grown_mb:.0f} MB"
        )


def peak_mb():
    """Return the largest memory of this process since it was last called, MB."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return int(found[1]) / 1024


def now_mb():
    """Return the memory of this process now, MB."""
    found = re.search(r"VmRSS:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return int(found[1]) / 1024


@contextlib.contextmanager
def nothing_left():
    """Fail where a thread, a process, an open file or a temporary file of the inputs is left."""
    folder = Path(tempfile.gettempdir())
    before = set(folder.iterdir()), _open_files(), _threads(), _children()
    yield
    deadline = time.monotonic() + LEAVE_SEC
    while time.monotonic() < deadline:
        gc.collect()
        left = {
            "temporary files": set(folder.iterdir()) - before[0],
            "threads": _threads() - before[2],
            "processes": _children() - before[3],
        }
        if not any(left.values()) and _open_files() <= before[1]:
            return
        time.sleep(0.1)
    pytest.fail(f"left: {left}, open files: {before[1]} before and {_open_files()} after")


def _open_files():
    return len(os.listdir("/proc/self/fd"))


def _threads():
    """Return the names of threads without those of the driver's pools: a session that is made anew
    has a pool of its own, and its connections are counted as open files."""
    names = {thread.name for thread in threading.enumerate()}
    return {name for name in names if not name.startswith("ThreadPoolExecutor-")}


def _children():
    return {child.pid for child in psutil.Process().children(recursive=True)}


@contextlib.contextmanager
def _no_hang():
    def hang(number, frame):
        raise TimeoutError(f"no end within {HANG_SEC:.0f} s")

    before = signal.signal(signal.SIGALRM, hang)
    try:
        yield lambda: signal.setitimer(signal.ITIMER_REAL, HANG_SEC)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


class Inputs:
    """Random inputs of a target, as many as were asked for.

    Args:
        target: Name of the target, of which the inputs depend.
        numbers: Numbers of the inputs.
        keep_going: Collect failures, one of each kind, instead of ending at the first one.
    """

    def __init__(self, target, numbers, keep_going=False):
        self.target, self.numbers, self._keep_going = target, numbers, keep_going

    def give(self, attempt, within=contextlib.nullcontext, watched=()):
        """Call ``attempt`` with random numbers for each input; return the report.

        Args:
            attempt: Makes an input of the random numbers and hands it to the target, which is what
                ``within`` gives, if it gives something.
            within: Context of all inputs: after it nothing may be left of it.
            watched: Processes (psutil) that hold the target and must not grow either.
        """
        report = Report(self.target, self.numbers.start)
        warm = self.numbers.start + int(len(self.numbers) * _WARM)
        base = {}
        with nothing_left(), within() as target, _no_hang() as begin:
            hand = attempt if target is None else functools.partial(attempt, target)
            for number in self.numbers:
                if number == warm:
                    gc.collect()
                    peak_mb()
                    base = {None: now_mb(), **{each: _memory_mb(each) for each in watched}}
                begin()
                self._one(number, hand, report)
                if number % 200 == 0:
                    self._watch(number, watched, base, report)
            self._watch(self.numbers.stop, watched, base, report)
            assert not report.found, "\n\n".join(report.found.values())
        report.grown_mb = max(report.grown_mb, peak_mb() - base.get(None, now_mb()))
        assert report.grown_mb < GROWTH_MB, str(report)
        return report

    def _one(self, number, attempt, report):
        chance = random.Random(f"{self.target} {number}")
        started = time.process_time()
        try:
            attempt(chance)
        except (CassandraRosError, Refused) as exc:
            assert str(exc), self._repeat(number)
            kind = type(exc).__name__ if isinstance(exc, CassandraRosError) else str(exc)
            report.refused[kind] += 1
        except Exception as exc:
            place = exc.__traceback__
            while place.tb_next is not None:
                place = place.tb_next
            kind = (type(exc), place.tb_frame.f_code, place.tb_lineno)
            if not self._keep_going:
                raise AssertionError(self._repeat(number)) from exc
            where = f"{place.tb_frame.f_code.co_filename}:{place.tb_lineno}"
            text = f"{self._repeat(number)}: {type(exc).__name__} {str(exc):.900} at {where}"
            report.found.setdefault(kind, text)
        else:
            report.answered += 1
        seconds = time.process_time() - started
        report.seconds += seconds
        if seconds > report.slowest_sec:
            report.slowest_sec, report.slowest = seconds, number
        assert seconds < INPUT_SEC, f"{self._repeat(number)}: {seconds:.1f} s of processor time"

    def _repeat(self, number):
        return f"input {number} of {self.target}: repeat it with --inputs 1 --first {number}"

    def _watch(self, number, watched, base, report):
        for process in watched:
            grown = _memory_mb(process) - base.get(process, float("inf"))
            report.grown_mb = max(report.grown_mb, grown)
            assert grown < GROWTH_MB, f"{process} has grown by {grown:.0f} MB at input {number}"


def _memory_mb(process):
    return process.memory_info().rss / 2**20
