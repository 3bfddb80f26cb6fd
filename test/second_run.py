# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run pytest, and run the tests that failed once more, alone: python test/second_run.py [ARGS].

The second run begins when the first has ended, without workers (pytest -n) and with a Cassandra of
its own, one test after the other on a machine that is quiet by then. A test that passes there is
unsteady: it is shown with the outputs of both runs and does not fail the whole. A test that fails
twice does, and so does a first run that was interrupted, that crashed, that ran no test, or that
collected a test and never ran it: only the failures of a complete run are run again.

As a pytest plugin (-p second_run) this module writes what became of each test into the file that
CASSANDRA_ROS_TEST_RESULTS names; the program starts pytest with it.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
UNSTEADY = HERE / "unsteady.txt"
RESULTS_VARIABLE = "CASSANDRA_ROS_TEST_RESULTS"
MOST_FAILURES = 50
"""Maximum number of failed tests that are run again. More do not fail by chance."""
PASSED, FAILED = 0, 1  # pytest's exit codes for a complete run
WIDTH = 100


class Results:
    """The plugin: what became of each test, written when the session ends."""

    def __init__(self, path):
        self._path = path
        self._collected = set()
        self._ended = set()
        self._passed = set()
        self._failed = set()
        self._outputs = {}

    def pytest_collection_finish(self, session):
        self._collected.update(item.nodeid for item in session.items)

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, ids):
        self._collected.update(ids)

    def pytest_runtest_logreport(self, report):
        # The report of a crash has another ``when``: its test has ended, too.
        if report.when not in ("setup", "call"):
            self._ended.add(report.nodeid)
        if report.when == "call" and report.passed:
            self._passed.add(report.nodeid)
        if report.failed:
            self._failed.add(report.nodeid)
        if report.failed or report.when == "call":
            self._outputs.setdefault(report.nodeid, []).append(_output(report))

    def pytest_sessionfinish(self):
        results = {
            "collected": len(self._collected),
            "missing": sorted(self._collected - self._ended),
            "passed": sorted(self._passed - self._failed),
            "failed": sorted(self._failed),
            "outputs": {name: "\n".join(texts) for name, texts in self._outputs.items()},
        }
        Path(self._path).write_text(json.dumps(results), encoding="utf-8")


def _output(report):
    sections = [f"{title}:\n{text}" for title, text in report.sections]
    told = [f"{report.when}: {report.outcome} after {report.duration:.2f} s", report.longreprtext]
    return "\n".join(filter(None, told + sections))


def pytest_configure(config):
    # The workers' reports come to the process that started them.
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Results(os.environ[RESULTS_VARIABLE]))


def run_pytest(arguments):
    """Return pytest's exit code and what it says of each test, None where it was killed."""
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_results_") as folder:
        path = Path(folder) / "results.json"
        env = {**os.environ, RESULTS_VARIABLE: str(path)}
        env["PYTHONPATH"] = os.pathsep.join(filter(None, (str(HERE), env.get("PYTHONPATH"))))
        command = [sys.executable, "-m", "pytest", "-p", "second_run", *arguments]
        process = subprocess.Popen(command, env=env, stdin=subprocess.DEVNULL)
        # Its fixtures stop what they have started. A terminal sends SIGINT to both of us.
        signal.signal(signal.SIGTERM, lambda *_: process.terminate())
        signal.signal(signal.SIGINT, lambda *_: None)
        code = process.wait()
        return code, json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def why_incomplete(code, results):
    """Say why a first run proves nothing, None where each test has run."""
    if code not in (PASSED, FAILED) or results is None:
        return f"pytest ended early, with code {code}"
    if not results["collected"]:
        return "no test was collected"
    if results["missing"]:
        return f"{len(results['missing'])} tests never ran: {', '.join(results['missing'][:5])}"
    if (code == FAILED) != bool(results["failed"]):
        return f"pytest ended with code {code} and {len(results['failed'])} failed tests"
    return None


def rule(title):
    print(f" {title} ".center(WIDTH, "="), flush=True)


def show_unsteady(names, first, second):
    listed = {line.split("#")[0].strip() for line in UNSTEADY.read_text("utf-8").splitlines()}
    rule("unsteady")
    for name in names:
        known = "is listed" if name in listed else "is to be listed, or mended now"
        print(f"\n{name}\n  failed, and passed alone; in test/unsteady.txt it {known}")
        for title, results in (("first run", first), ("second run", second)):
            print(f"--- {title}\n{results['outputs'][name]}")


def reason_of(name, results):
    """Return the line in which pytest names the error of a failed test."""
    lines = results["outputs"].get(name, "").splitlines()
    return next((line[1:].strip() for line in lines if line.startswith("E  ")), "see above")


def closing_line(counts, seconds):
    """Return a line such as pytest's own last one."""
    told = ", ".join(f"{number} {word}" for word, number in counts.items() if number)
    return f"{told} in {seconds:.2f}s"


def main(arguments):
    began = time.monotonic()
    code, first = run_pytest(arguments)
    incomplete = why_incomplete(code, first)
    if incomplete:
        print(f"second_run: {incomplete}; nothing is run again", flush=True)
        return code or FAILED
    failed = first["failed"]
    if not failed:
        return PASSED
    if len(failed) > MOST_FAILURES:
        print(f"second_run: {len(failed)} failed tests are too many to run again", flush=True)
        return FAILED
    rule(f"second run, alone: {len(failed)}")
    _, second = run_pytest(["-p", "no:xdist", "-v", *failed])
    passed = sorted(set(second["passed"] if second else ()).intersection(failed))
    twice = [name for name in failed if name not in passed]
    if passed:
        show_unsteady(passed, first, second)
    for name in twice:
        print(f"FAILED in both runs: {name}\n  {reason_of(name, second or first)}")
    counts = {"failed": len(twice), "passed": len(first["passed"]), "unsteady": len(passed)}
    rule(closing_line(counts, time.monotonic() - began))
    return FAILED if twice else PASSED


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
