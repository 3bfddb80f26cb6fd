# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The package under other Pythons than the one of the workspace: what needs no ROS master.

ROS's own Python packages are linked beside it where they are Python only; roslz4 and tf2_py are
compiled for one Python, so what reads lz4 and looks up transforms stays out. The short campaign
takes the oldest Python that is found, the long one all of them.
"""

from __future__ import annotations

import fcntl
import glob
import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from campaign import LENGTH
from conftest import GENERATED, ROOT, SERVER_VARIABLE, WORKSPACE

MINORS = [minor for minor in range(8, 13) if minor != sys.version_info[1]]

# python3-yaml is the distribution's and compiled; 6.0.2 is the last for Python 3.8.
NOT_PINNED_BY_US = "PyYAML==6.0.2"

# ROS packages are known by their package.xml; these have none, and genpy and rosbag need them.
BESIDE_ROS = ("rospkg", "catkin_pkg", "pyparsing", "distro", "gnupg.py", "Cryptodome")
DISTRIBUTION = Path("/usr/lib/python3/dist-packages")

# In a campaign, too, the other Python runs the tests as make test does.
NOT_INHERITED = ("ROS_HOSTNAME", "CASSANDRA_ROS_CAMPAIGN")

# One file of each part, and the API's contract on a real Cassandra.
SOME = (
    *("messages/test_definition.py", "messages/test_stamps.py", "formats/test_text.py"),
    *("query/test_parse.py", "query/test_cursor.py", "store/test_scan.py"),
    *("client/test_api.py", "bag/test_order.py"),
)

IMPORT_ALL = """
import importlib, pkgutil, cassandra_ros
for module in pkgutil.walk_packages(cassandra_ros.__path__, "cassandra_ros."):
    try:
        importlib.import_module(module.name)
        print("imported", module.name)
    except Exception as exc:
        assert "tf2_py" in str(exc) or "roslz4" in str(exc), (module.name, exc)
"""


def found_pythons():
    """Other Pythons of this machine, oldest first: on the PATH or of pyenv."""
    pyenv = os.environ.get("PYENV_ROOT") or str(Path.home() / ".pyenv")
    for minor in MINORS:
        candidates = [shutil.which(f"python3.{minor}")]
        candidates += sorted(glob.glob(f"{pyenv}/versions/3.{minor}.*/bin/python3"))
        for python in filter(None, candidates):
            # A pyenv shim exists for Pythons, too, that it then refuses to run.
            asked = "import sys, ensurepip, venv; print(sys.version_info[1])"
            done = subprocess.run([python, "-c", asked], capture_output=True, text=True)
            if done.returncode == 0 and done.stdout.strip() == str(minor):
                yield f"3.{minor}", python
                break


FOUND = dict(found_pythons())


@pytest.fixture(scope="module", params=list(FOUND)[: None if LENGTH == "long" else 1] or [None])
def other_python(request):
    """A Python with our requirements in a venv, and an environment that finds ROS."""
    if request.param is None:
        pytest.skip(
            f"no Python 3.8 to 3.12 but 3.{sys.version_info[1]} is on the PATH or under pyenv; "
            "make one with: pyenv install 3.8"
        )
    folder = WORKSPACE / f"python{request.param}"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        make_venv(FOUND[request.param], folder)
        link_ros(folder / "ros")
    return folder / "venv/bin/python", {
        **{name: value for name, value in os.environ.items() if name not in NOT_INHERITED},
        "PYTHONPATH": os.pathsep.join(map(str, (ROOT / "src", GENERATED, folder / "ros"))),
        "PYTHONDONTWRITEBYTECODE": "1",
    }


def make_venv(python, folder):
    """Install what is pinned, once for each text of the files."""
    files = sorted(ROOT.glob("requirements*.txt"))
    text = "".join(path.read_text() for path in files) + NOT_PINNED_BY_US + python
    wanted = hashlib.sha256(text.encode()).hexdigest()
    stamp = folder / "installed"
    if stamp.is_file() and stamp.read_text() == wanted:
        return
    run([python, "-m", "venv", "--clear", folder / "venv"])
    pip = [folder / "venv/bin/python", "-m", "pip", "--disable-pip-version-check"]
    install = [*pip, "install", "-q", "--only-binary=:all:", "-c", ROOT / "requirements-dev.txt"]
    tables = ROOT / "requirements-tables.txt"
    run([*install, "-r", tables, "pytest", "hypothesis", NOT_PINNED_BY_US])
    # What lint and demo need beside it is only resolved, which takes no space.
    run([*install, "--dry-run", "-r", ROOT / "requirements-dev.txt"])
    stamp.write_text(wanted)


def link_ros(folder):
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for path in DISTRIBUTION.iterdir():
        ros = Path("/usr/share", path.name, "package.xml").is_file()
        if (ros and not any(path.rglob("*.so"))) or path.name in BESIDE_ROS:
            (folder / path.name).symlink_to(path)


def run(command, **options):
    done = subprocess.run(
        list(map(str, command)),
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        **options,
    )
    assert done.returncode == 0, done.stdout[-6000:]
    return done.stdout


@pytest.mark.long
def test_every_module_is_imported(other_python):
    python, env = other_python
    imported = run([python, "-c", IMPORT_ALL], env=env).count("imported ")
    assert imported > 0.9 * len(list((ROOT / "src/cassandra_ros").rglob("*.py")))


@pytest.mark.long
def test_what_needs_no_master_passes(other_python, cassandra):
    python, env = other_python
    env = {**env, SERVER_VARIABLE: f"{cassandra.host}:{cassandra.port}"}
    said = run(
        [python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-W", "ignore"]
        + [f"test/{name}" for name in SOME],
        env=env,
    )
    assert " passed" in said.splitlines()[-1], said
