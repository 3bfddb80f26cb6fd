# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""second_run.py: what fails is run again alone, and no incomplete run passes for a good one."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest
from conftest import ROOT
from second_run import UNSTEADY

MADE_UP = """
import os, pytest

ALONE = "PYTEST_XDIST_WORKER" not in os.environ

def test_steady():
    print("printed by the steady test")

def test_unsteady():
    print("alone" if ALONE else "among workers")
    assert ALONE, "others disturb it"

@pytest.fixture
def leaving():
    yield
    assert ALONE, "others disturb its end"

def test_unsteady_at_its_end(leaving):
    pass

def test_crashing_among_workers():
    if not ALONE:
        os._exit(7)

def test_failing():
    assert not "it fails always"

def test_crashing():
    os._exit(7)

def test_interrupted():
    raise KeyboardInterrupt
"""


@pytest.fixture
def run_twice(tmp_path):
    """Run tests of a made-up folder, as .ci/run does; return exit code and output."""
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    (tmp_path / "test_made_up.py").write_text(MADE_UP)

    def run(*names, options=("-n", "2")):
        done = subprocess.run(
            [sys.executable, ROOT / "test/second_run.py", *options]
            + [f"test_made_up.py::test_{name}" for name in names],
            cwd=tmp_path,
            env={name: value for name, value in os.environ.items() if "XDIST" not in name},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=300,
        )
        return done.returncode, done.stdout

    return run


def last_line(told):
    return re.sub(r"[\d.]+s =+$", "", told.splitlines()[-1]).strip("= ")


def test_what_passes_alone_is_unsteady_and_fails_nothing(run_twice):
    code, told = run_twice("steady", "unsteady", "unsteady_at_its_end", "crashing_among_workers")
    assert code == 0, told
    shown = told.partition(" unsteady ===")[2]
    for name in ("unsteady", "unsteady_at_its_end", "crashing_among_workers"):
        assert f"\ntest_made_up.py::test_{name}\n" in shown
    assert "test_steady" not in shown
    for told_of_either in (
        "others disturb it\n",
        "among workers",
        "alone",
        "others disturb its end",
    ):
        assert told_of_either in shown
    assert "crashed while running" in shown
    assert "is to be listed" in shown
    assert last_line(told) == "1 passed, 3 unsteady in"


def test_what_fails_twice_fails_the_run(run_twice):
    code, told = run_twice("steady", "unsteady", "failing")
    assert code == 1
    failing = "test_made_up.py::test_failing"
    assert (
        f"FAILED in both runs: {failing}\n  AssertionError: assert not 'it fails always'\n" in told
    )
    assert "FAILED in both runs: test_made_up.py::test_unsteady" not in told
    assert last_line(told) == "1 failed, 1 passed, 1 unsteady in"
    # A second run that ends in a crash has passed nothing.
    code, told = run_twice("steady", "crashing")
    assert code == 1
    assert last_line(told) == "1 failed, 1 passed in"


def test_a_good_run_ends_with_the_line_of_pytest(run_twice):
    code, told = run_twice("steady")
    assert code == 0
    assert last_line(told) == "1 passed in"
    assert "second run" not in told


@pytest.mark.parametrize(
    ("names", "options", "why"),
    [
        (["steady", "unsteady", "interrupted"], ["-n", "1"], "ended early, with code 2"),
        (["steady", "unsteady", "absent"], ["-n", "2"], "ended early, with code"),
        (["steady"], ["-n", "2", "-k", "absent"], "ended early, with code 5"),
        (["crashing", "steady"], ["-n", "1", "--max-worker-restart", "0"], "1 tests never ran"),
    ],
)
def test_an_incomplete_run_never_passes(run_twice, names, options, why):
    code, told = run_twice(*names, options=options)
    assert code != 0
    assert f"second_run: {'' if 'never' in why else 'pytest '}{why}" in told
    assert "second run, alone" not in told


def test_the_list_names_tests_that_exist():
    for line in UNSTEADY.read_text(encoding="utf-8").splitlines():
        name = line.split("#")[0].strip()
        if name:
            file, _, test = name.partition("::")
            assert f"def {test.partition('[')[0].split('::')[-1]}(" in (ROOT / file).read_text()
