# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Verbs that are killed with SIGKILL at random moments, and are then run again to their end."""

from __future__ import annotations

import contextlib
import resource
import time
from typing import Callable

import psutil

from faults.trial import START_NS, TOPIC, Trial
from faults.world import Failed, Program, Server

KILLS = 4, 20
"""Number of kills in the short and in the long form."""
STRIKES = 10
"""Number of attempts to meet a copy while it runs."""
PACE_HZ = 10_000.0
DELETION_HZ = 40_000.0
"""Messages that a verb works on in a second of processor time, about; kills are spread over it."""


def import_killed(trial: Trial) -> None:
    """An import is killed at random moments, each time a new process, and completed."""
    _import_killed(trial, "ros")


def import_killed_packed(trial: Trial) -> None:
    """The same in format packed."""
    _import_killed(trial, "packed")


def _import_killed(trial: Trial, form: str) -> None:
    bag = trial.bag()
    _killed_and_completed(trial, "import", bag, "--format", form)
    trial.done("verify", bag)


def conversion_killed(trial: Trial) -> None:
    """A conversion from ros to packed is killed at random moments, and completed."""
    trial.done("import", trial.bag(1), "--format", "ros")
    _killed_and_completed(trial, "convert", f"{TOPIC}_0", "--format", "packed")


def conversion_back_killed(trial: Trial) -> None:
    """The same from packed to ros."""
    trial.done("import", trial.bag(1), "--format", "packed")
    _killed_and_completed(trial, "convert", f"{TOPIC}_0", "--format", "ros")


def deletion_killed(trial: Trial) -> None:
    """Deleting the messages of a time range is killed at random moments, and completed."""
    trial.done("import", trial.bag(), "--format", "ros")
    start, end = trial.time_of(0.25), trial.time_of(0.75)
    trial.removed.append((start, end))
    words = ("delete", "--start", start, "--end", end, "--yes")
    _killed_and_completed(trial, *words, pace_hz=DELETION_HZ)


def deletion_killed_packed(trial: Trial) -> None:
    """The same in format packed, where blocks at the ends of the time range are cut."""
    trial.done("import", trial.bag(), "--format", "packed")
    start, end = trial.time_of(0.25), trial.time_of(0.75)
    trial.removed.append((start, end))
    words = ("delete", "--start", start, "--end", end, "--yes")
    _killed_and_completed(trial, *words, pace_hz=DELETION_HZ)


def retention_killed(trial: Trial) -> None:
    """Deleting messages by age is killed at random moments, and completed."""
    trial.done("import", trial.bag(), "--format", "packed")
    now = trial.time_of(1.0)
    age_sec = trial.messages // 2000
    trial.removed.append((START_NS, now - age_sec * 10**9))
    words = ("retention", "--max-age", age_sec, "--now", now, "--yes")
    _killed_and_completed(trial, *words, pace_hz=DELETION_HZ)


def index_killed(trial: Trial) -> None:
    """Making an index is killed at random moments, and completed."""
    trial.done("import", trial.bag(1), "--format", "ros")
    _killed_and_completed(trial, "index", f"{TOPIC}_0", "data")


def copy_killed(trial: Trial) -> None:
    """A copy into another keyspace is killed at random moments, and completed."""
    _copy_killed(trial, "ros")


def copy_killed_packed(trial: Trial) -> None:
    """The same in format packed."""
    _copy_killed(trial, "packed")


def copy_killed_converting(trial: Trial) -> None:
    """The same from ros to packed on the way."""
    _copy_killed(trial, "ros", "--format", "packed")


def _copy_killed(trial: Trial, form: str, *options: str) -> None:
    source, words = _source(trial, form)
    _killed_and_completed(trial, "copy", *words, *options)
    trial.done("verify", "--keyspace", source, "--with", words[-1])


def copies_at_once(trial: Trial) -> None:
    """Two copies of one keyspace run at the same time, and one of them is killed."""
    source, words = _source(trial, "ros")
    others: list[Program] = []

    def begin() -> Program:
        for earlier in others:
            earlier.process.wait()
        others.append(trial.verb("copy", *words))
        return trial.verb("copy", *words)

    _struck(trial, begin, lambda copy: copy.kill())
    others[-1].process.wait()
    trial.outlast_lock()
    trial.done("copy", *words)
    trial.done("verify", "--keyspace", source, "--with", words[-1])


def copy_store_killed(trial: Trial) -> None:
    """The Cassandra that holds both keyspaces is killed while one is copied; the copy goes on."""
    source, words = _source(trial, "ros")
    _struck(trial, lambda: trial.verb("copy", *words), lambda copy: _restart(trial.server))
    trial.done("copy", *words)
    trial.done("verify", "--keyspace", source, "--with", words[-1])


def copy_target_killed(trial: Trial) -> None:
    """Two Cassandras: the one to which is copied is killed while a copy runs, and started again."""
    _copy_of_two_servers(trial, kill_target=True)


def copy_source_killed(trial: Trial) -> None:
    """The same with the one from which is copied."""
    _copy_of_two_servers(trial, kill_target=False)


def _copy_of_two_servers(trial: Trial, *, kill_target: bool) -> None:
    source, _ = _source(trial, "ros")
    robot, place = trial.server, trial.place
    trial.server = Server(trial.folder / "home")
    trial.open.callback(trial.server.stop)
    trial.server.start()
    target = f"{trial.place.host}:{trial.place.port}/{trial.keyspace}"
    words = ["--keyspace", source, "--host", place.host, "--port", place.port, "--to", target]
    victim = trial.server if kill_target else robot
    _struck(trial, lambda: trial.verb("copy", *words), lambda copy: _restart(victim))
    trial.done("copy", *words)
    trial.done("verify", *words[:-2], "--with", target)


def _restart(server: Server) -> None:
    server.kill()
    server.start()


def _struck(trial: Trial, begin: Callable[[], Program], strike: Callable[[Program], None]) -> None:
    """Strike at a random moment of a copy; wait until the copy has ended.

    A copy that was faster than expected proves nothing: it begins anew in an empty keyspace.

    Raises:
        Failed: It was faster each time.
    """
    start_sec, work_sec = _start_sec(trial), trial.messages / PACE_HZ
    for _ in range(STRIKES):
        before = _children_cpu_sec()
        copy = begin()
        _await_cpu(copy, _moment_sec(trial.random.random(), start_sec, work_sec))
        if copy.runs:
            strike(copy)
            copy.process.wait()
            return
        start_sec, work_sec = _faster(start_sec, work_sec, _children_cpu_sec() - before)
        trial.drop(trial.keyspace)
    raise Failed(f"the copy ended before each of {STRIKES} moments")


def _source(trial: Trial, form: str) -> tuple[str, list[object]]:
    """Import the messages into another keyspace; return its name, and the words of a copy of it."""
    source = f"{trial.keyspace}_robot"
    trial.done("import", trial.bag(), "--format", form, "--keyspace", source)
    trial.open.callback(trial.drop, source, trial.server)
    target = f"{trial.place.host}:{trial.place.port}/{trial.keyspace}"
    return source, ["--keyspace", source, "--to", target]


def _killed_and_completed(trial: Trial, *words: object, pace_hz: float = PACE_HZ) -> None:
    """Kill a verb at random moments, early ones first; each process goes on with what is left.

    A moment is an amount of processor time, so that a busy machine does not shift it, and for every
    other kill up to a second more, in which the verb may wait for the store.
    """
    start_sec, work_sec = _start_sec(trial), trial.messages / pace_hz
    count = KILLS[not trial.short]
    killed = number = 0
    while number < count or not killed:
        if number == STRIKES * count:
            raise Failed(f"{words[0]} ended before each of {number} kills")
        share = (number % count + trial.random.random()) / count
        before = _children_cpu_sec()
        program = trial.verb(*words)
        _await_cpu(program, _moment_sec(share, start_sec, work_sec))
        if number % 2 and program.runs:
            time.sleep(trial.random.random())
        if program.runs:
            program.kill()
            killed += 1
            trial.outlast_lock()
        else:
            took_sec = _children_cpu_sec() - before
            start_sec, work_sec = _faster(start_sec, work_sec, took_sec)
        number += 1
    trial.done(*words)
    trial.note(f"killed {killed} times while it worked")


def _start_sec(trial: Trial) -> float:
    """Return the processor time that a verb takes before it works, s."""
    before = _children_cpu_sec()
    trial.verb("list").process.wait()  # before an import there is no keyspace
    return _children_cpu_sec() - before


def _faster(start_sec: float, work_sec: float, took_sec: float) -> tuple[float, float]:
    """Return start and work of a program that took less processor time than was expected, s.

    The first program of a new checkout compiles what it imports, so it starts slower than others.
    """
    start_sec = min(start_sec, took_sec)
    return start_sec, min(work_sec, took_sec - start_sec)


def _moment_sec(share: float, start_sec: float, work_sec: float) -> float:
    """Return the processor time of a moment: share 0 is before the work begins, 1 is its end."""
    return 0.6 * start_sec + share * (0.4 * start_sec + work_sec)


def _await_cpu(program: Program, cpu_sec: float) -> None:
    """Wait until a program has used some processor time, or has ended."""
    with contextlib.suppress(psutil.Error):
        process = psutil.Process(program.process.pid)
        while program.runs and sum(process.cpu_times()[:2]) < cpu_sec:
            time.sleep(0.005)


def _children_cpu_sec() -> float:
    """Return the processor time of all children that have ended, s."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


FAULTS = (
    import_killed,
    import_killed_packed,
    conversion_killed,
    conversion_back_killed,
    deletion_killed,
    deletion_killed_packed,
    retention_killed,
    index_killed,
    copy_killed,
    copy_killed_packed,
    copy_killed_converting,
    copies_at_once,
    copy_store_killed,
    copy_target_killed,
    copy_source_killed,
)
