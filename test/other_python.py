# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run the tests under another Python: python test/other_python.py PYTHON [ARGS].

PYTHON is a program, as python3.8: on the PATH, of pyenv, or its path. ARGS are pytest's; without
them all tests of the suite run (CASSANDRA_ROS_SUITE, see suites.py). A virtual environment with
what requirements/dev.txt pins for that Python, and a catkin workspace whose programs start with it,
are made in .ws and kept. ROS's Python packages are linked beside them where they are Python only;
roslz4 and tf2_py are compiled for the distribution's Python, so that the tests that compare with
them cannot run. At the end the reasons of all tests that did not run are listed with their numbers.

As a pytest plugin (-p other_python) this module leaves out the tests in SAME, and writes that list.
"""

from __future__ import annotations

import contextlib
import fcntl
import glob
import hashlib
import os
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
DISTRIBUTION = Path("/usr/lib/python3/dist-packages")
REQUIREMENTS = (ROOT / "requirements/dev.txt", ROOT / "test/requirements-ros.txt")

BESIDE_ROS = (
    *("rospkg", "catkin_pkg", "catkin", "pyparsing", "distro", "dateutil", "six.py", "docutils"),
    *("roman.py", "em.py", "defusedxml", "gnupg.py", "Cryptodome"),
)
"""Packages without package.xml that ROS's need, and that run under every Python 3."""

NOT_INHERITED = ("ROS_HOSTNAME", "CASSANDRA_ROS_SUITE", "PYTHONPATH", "CMAKE_PREFIX_PATH")

SAME = {
    "test/test_other_pythons.py": "runs this",
    "test/test_setup.py": "the set-up takes the distribution's Python",
    "test/test_installed.py": "installs beside the distribution's ROS",
    "test/test_imports.py": "reads the sources, the same for each Python",
    "test/test_architecture.py": "reads the sources, the same for each Python",
    **{
        f"test/pages/test_{name}.py": "types what the pages say, in the workspace of make setup"
        for name in ("listings", "pages", "tutorial")
    },
    "test/benchmark": "make bench runs under the distribution's Python",
}
"""Tests that another Python would do no other way, and why."""


def find_python(name):
    """Return the minor version and the path of a Python 3, (0, None) if it cannot make venvs."""
    pyenv = os.environ.get("PYENV_ROOT") or str(Path.home() / ".pyenv")
    version = Path(name).name.replace("python", "")
    candidates = [shutil.which(name), *glob.glob(f"{pyenv}/versions/{version}.*/bin/python3")]
    for python in filter(None, candidates):
        # A pyenv shim exists for Pythons, too, that it then refuses to run.
        asked = "import sys, ensurepip, venv; print(sys.version_info[1])"
        done = subprocess.run([python, "-c", asked], capture_output=True, text=True)
        if done.returncode == 0:
            return int(done.stdout), python
    return 0, None


def found_pythons():
    """Return minor version and path of the other Pythons of this machine, oldest first."""
    found = (find_python(f"python3.{minor}") for minor in range(8, 14))
    return {minor: python for minor, python in found if python and minor != sys.version_info[1]}


def prepare(minor, python):
    """Make what is missing for a Python; return its program and the environment of its tests."""
    folder = ROOT / f".ws/python3.{minor}"
    folder.mkdir(parents=True, exist_ok=True)
    program = folder / "venv/bin/python"
    env = {name: value for name, value in os.environ.items() if name not in NOT_INHERITED}
    env.update(
        CASSANDRA_ROS_TEST_WORKSPACE=str(folder),
        CASSANDRA_ROS_OTHER_PYTHON="yes",
        ROS_IP="127.0.0.1",
        LC_ALL="C.UTF-8",
    )
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with once(folder / "installed", python, *_requirements()) as missing:
            if missing:
                _make_venv(python, folder / "venv")
        _link_ros(folder / "ros", program)
        build = [ROOT / "CMakeLists.txt", ROOT / "package.xml", ROOT / "setup.py"]
        build += sorted(path for kind in ("msg", "srv") for path in (ROOT / kind).iterdir())
        with once(folder / "built", (folder / "installed").read_text(), *build) as missing:
            if missing:
                _make_workspace(program, folder, env)
    return program, {**env, "PYTHONPATH": str(ROOT / "test")}


def _requirements():
    return sorted((ROOT / "requirements").glob("*.txt")) + [REQUIREMENTS[-1]]


@contextlib.contextmanager
def once(stamp, text, *files):
    """Yield whether something is to be made: not with this text and these files yet."""
    content = "".join([str(text), str(ROOT), *(path.read_text("utf-8") for path in files)])
    wanted = hashlib.sha256(content.encode()).hexdigest()
    missing = not stamp.is_file() or stamp.read_text() != wanted
    yield missing
    if missing:
        stamp.write_text(wanted)


def _make_venv(python, folder):
    run([python, "-m", "venv", folder])
    pip = [folder / "bin/python", "-m", "pip", "--disable-pip-version-check", "install", "-q"]
    without_ros = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    run([*pip, *(word for path in REQUIREMENTS for word in ("-r", path))], env=without_ros)


def _link_ros(folder, program):
    """Link ROS's packages into a folder that the Python searches, as the distribution's does."""
    folder.mkdir(exist_ok=True)
    [packages] = program.parents[1].glob("lib/python3.*/site-packages")
    (packages / "ros.pth").write_text(f"{folder}\n")
    for path in DISTRIBUTION.iterdir():
        ros = Path("/usr/share", path.name).is_dir() and _is_ros(path)
        link = folder / path.name
        if (ros or path.name in BESIDE_ROS) and not link.is_symlink():
            link.symlink_to(path)


def _is_ros(folder):
    """Tell whether a folder of the distribution is a package of ROS, and Python only."""
    share = Path("/usr/share", folder.name)
    described = (share / "package.xml").is_file() or (folder / "msg/__init__.py").is_file()
    return described and not any(folder.rglob("*.so"))


def _make_workspace(program, folder, env):
    for name in ("build", "devel"):
        shutil.rmtree(folder / name, ignore_errors=True)
    options = {"PYTHON_EXECUTABLE": program, "CATKIN_DEVEL_PREFIX": folder / "devel"}
    run(
        ["catkin_make", "-C", folder, "--source", ROOT / ".ws/src", "--build", folder / "build"]
        + [f"-D{name}={value}" for name, value in options.items()],
        env=env,
    )


def run(command, **options):
    """Run a command to its end; return what it says. It is an error if it fails."""
    done = subprocess.run(
        list(map(str, command)),
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        **options,
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))}\n{done.stdout[-6000:]}")
    return done.stdout


def command_of_tests(program, arguments):
    """Return the command that runs tests in the prepared environment."""
    workspace = program.parents[2] / "devel/setup.bash"
    pytest_ = [program, "-m", "pytest", "-p", "other_python", "-p", "no:cacheprovider"]
    sourced = 'source "$1" && shift && exec "$@"'
    return ["bash", "-c", sourced, "bash", *map(str, [workspace, *pytest_, *arguments])]


# --- The plugin ---


def pytest_collection_modifyitems(items):
    for item in items:
        path = item.nodeid.split("::")[0]
        for place, reason in SAME.items():
            if path == place or path.startswith(f"{place}/"):
                item.add_marker(pytest.mark.skip(reason=f"{place}: {reason}"))


def pytest_terminal_summary(terminalreporter):
    stats = terminalreporter.stats
    ran = sum(len(stats.get(word, ())) for word in ("passed", "failed", "error"))
    reasons = Counter(_reason(report) for report in stats.get("skipped", ()))
    python = ".".join(map(str, sys.version_info[:3]))
    terminalreporter.section(f"Python {python}: {ran} ran, {sum(reasons.values())} did not")
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"{count:6}  {reason}")
    left = len(stats.get("deselected", ()))
    if left:
        terminalreporter.write_line(f"{left:6}  belong to larger suites, or were not asked for")


def _reason(report):
    text = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    text = text.replace("Skipped: ", "", 1).splitlines()[0]
    if text in ("", "unconditional skip"):
        return "NO REASON GIVEN"
    return text if "::" in report.nodeid else f"{text} (all of {report.nodeid})"


def main(arguments):
    minor, python = find_python(arguments[0])
    if python is None:
        version = arguments[0].replace("python", "")
        print(f"other_python: there is no {arguments[0]}, on the PATH or of pyenv, that can make")
        print(f"other_python: virtual environments; make one with: pyenv install {version}")
        return 2
    print(f"other_python: {python}, in .ws/python3.{minor}", flush=True)
    program, env = prepare(minor, python)
    env["CASSANDRA_ROS_SUITE"] = os.environ.get("CASSANDRA_ROS_SUITE", "test")
    return subprocess.run(command_of_tests(program, arguments[1:]), cwd=ROOT, env=env).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
