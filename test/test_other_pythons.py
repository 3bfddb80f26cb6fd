# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The package under other Pythons than the one of the workspace (other_python.py).

make test-all compiles and imports all modules, and runs one test file of each part, with the oldest
Python that is found; the campaign runs everything with the oldest and with the newest.
"""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from conftest import ROOT, SERVER_VARIABLE
from other_python import command_of_tests, found_pythons, prepare, run
from suites import CAMPAIGN

SOURCES = ("src", "scripts", "test", "examples", "benchmark")

# One file of each part, and the API's contract on a real Cassandra.
SOME = (
    *("messages/test_definition.py", "messages/test_stamps.py", "formats/test_text.py"),
    *("query/test_parse.py", "query/test_cursor.py", "store/test_scan.py"),
    *("client/test_api.py", "bag/test_order.py"),
)

COMPILE = """
import pathlib, sys
for place in sys.argv[1:]:
    for path in pathlib.Path(place).rglob("*"):
        if path.suffix == ".py" or place == "scripts" and path.is_file() and not path.suffix:
            compile(path.read_bytes(), str(path), "exec")
            print("compiled", path)
"""

IMPORT_ALL = """
import importlib, pkgutil, cassandra_ros
for module in pkgutil.walk_packages(cassandra_ros.__path__, "cassandra_ros."):
    try:
        importlib.import_module(module.name)
        print("imported", module.name)
    except Exception as exc:
        assert "tf2_py" in str(exc), (module.name, exc)
"""


NEWEST = pytest.mark.suite("campaign", "its packages take minutes to install")


@pytest.fixture(scope="module", params=["oldest", pytest.param("newest", marks=NEWEST)])
def other_python(request):
    """Return the program of a Python with our requirements, and the environment of its tests."""
    found = found_pythons()
    if not found:
        pytest.skip(
            f"no Python 3.8 to 3.13 but 3.{sys.version_info[1]} is on the PATH or under pyenv; "
            "make one with: pyenv install 3.8"
        )
    if request.param == "newest" and len(found) == 1:
        pytest.skip(f"Python 3.{min(found)} is the only other one, and is the oldest")
    minor = min(found) if request.param == "oldest" else max(found)
    return prepare(minor, found[minor])


@pytest.mark.suite("all", "it installs other Pythons' packages")
def test_every_module_is_compiled_and_imported(other_python):
    program, env = other_python
    compiled = run([program, "-c", COMPILE, *SOURCES], env=env).count("compiled ")
    assert compiled > 600
    generated = program.parents[2] / "devel/lib/python3/dist-packages"
    paths = f"{ROOT / 'src'}{os.pathsep}{generated}"
    env = {**env, "PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"}
    imported = run([program, "-c", IMPORT_ALL], env=env).count("imported ")
    assert imported > 0.9 * len(list((ROOT / "src/cassandra_ros").rglob("*.py")))


@pytest.mark.suite("all", "it installs other Pythons' packages")
def test_some_or_all_tests_pass(other_python, cassandra, record_property):
    program, env = other_python
    env = {**env, SERVER_VARIABLE: f"{cassandra.host}:{cassandra.port}"}
    names = [] if CAMPAIGN else [f"test/{name}" for name in SOME]
    said = run(command_of_tests(program, ["-q", "-W", "ignore", *names]), env=env)
    assert " passed" in said.splitlines()[-1], said
    assert "NO REASON GIVEN" not in said
    record_property("told", said[said.rindex(" Python 3.") :])


def test_a_python_that_is_not_there_is_named():
    command = [sys.executable, "test/other_python.py", "python3.1"]
    env = {**os.environ, "PYENV_ROOT": "/nowhere"}
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True)
    assert done.returncode == 2
    assert "there is no python3.1, on the PATH or of pyenv" in done.stdout
    assert "pyenv install 3.1" in done.stdout
