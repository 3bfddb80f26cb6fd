# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The package as catkin and rosrun see it."""

from __future__ import annotations

import os
import re
import stat
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted(path.name for path in (ROOT / "scripts").iterdir())
LAUNCH = ROOT / "launch" / "cassandra_ros.launch"


def files_of_the_checkout():
    """Files, what was built or installed (.ws, .venv) left out."""
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [name for name in folders if not name.startswith((".", "__"))]
        yield from (Path(folder) / name for name in names)


def test_the_scripts_are_those_of_the_build_file():
    listed = re.findall(r"^  scripts/(\w+)$", (ROOT / "CMakeLists.txt").read_text(), re.M)
    assert listed == SCRIPTS
    assert SCRIPTS == ["cassandra_bag", "local_cassandra", "query_server", "recorder"]


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_is_not_executable_and_names_its_module(name):
    path = ROOT / "scripts" / name
    assert not path.stat().st_mode & (stat.S_IXUSR | stat.S_IXGRP | stat.S_IXOTH)
    module = f"cassandra_ros.cli.{name}"
    assert path.read_text().endswith(
        f'from cassandra_ros.cli.script import run_script\n\nrun_script("{module}")\n'
    )


def test_no_other_file_has_a_scripts_name():
    """Rosrun would find two programs and ask which one is meant."""
    names = [path for path in files_of_the_checkout() if path.name in SCRIPTS]
    assert sorted(names) == [ROOT / "scripts" / name for name in SCRIPTS]


def test_the_messages_are_those_of_the_build_file():
    text = (ROOT / "CMakeLists.txt").read_text()
    for folder in ("msg", "srv"):
        files = sorted(path.name for path in (ROOT / folder).iterdir())
        assert re.findall(rf"^  (\w+\.{folder})$", text, re.M) == files


@pytest.mark.parametrize("name", SCRIPTS)
def test_rosrun_finds_every_script_once(name, ros_env):
    done = subprocess.run(
        ["rosrun", "cassandra_ros", name, "--help"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        env=ros_env,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"usage: {name} ")
    assert "non-unique" not in done.stdout + done.stderr


def test_the_workspace_holds_links_to_items_never_to_the_root():
    package = ROOT / ".ws" / "src" / "cassandra_ros"
    assert package.is_dir()
    assert not package.is_symlink()
    for link in package.iterdir():
        assert link.is_symlink()
        assert link.resolve() == ROOT / link.name


def test_python_of_the_workspace_imports_library_and_services(ros_env):
    program = (
        "import sys; from cassandra_ros import RosCassandra, Stamp, CassandraRosError; "
        "from cassandra_ros.srv import GetData, LookupTransform, Range, ExecuteCQL; "
        "from cassandra_ros.msg import StoredMessage, Row; print(sys.prefix)"
    )
    done = subprocess.run(
        [ROOT / ".venv/bin/python", "-c", program],
        cwd="/",
        capture_output=True,
        text=True,
        env=ros_env,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(ROOT / ".venv")


def test_a_launch_file_argument_for_every_parameter():
    text = (ROOT / "config" / "query_server.yaml").read_text()
    parameters = yaml.safe_load(text)
    arguments = {arg.get("name") for arg in ElementTree.parse(LAUNCH).getroot().findall("arg")}  # noqa: S314 (our own file)
    assert set(parameters) == {"host", "port", "keyspace", "allow_writes"} <= arguments
    assert all(value == f"$(arg {name})" for name, value in parameters.items())


def test_the_licence_is_the_same_everywhere():
    manifest = (ROOT / "package.xml").read_text()
    assert '<license file="LICENSE">BSD-3-Clause</license>' in manifest
    assert (ROOT / "LICENSE").read_text().startswith("BSD 3-Clause License")


def test_every_dependency_is_pinned_with_a_reason():
    for name in ("requirements.txt", "requirements-tables.txt", "requirements-dev.txt"):
        before = ""
        for line in (ROOT / name).read_text().splitlines():
            if line and not line.startswith(("#", "-r")):
                assert re.match(r"[\w-]+==[\w.]+(; python_version [<>]=? \"3\.9\")?$", line), line
                assert before.startswith("#") or before.split("==")[0] == line.split("==")[0], line
            before = line


def test_public_names_are_what_is_said():
    import cassandra_ros

    for name in cassandra_ros.__all__:
        assert getattr(cassandra_ros, name).__name__ == name
    with pytest.raises(AttributeError):
        getattr(cassandra_ros, "nothing")  # noqa: B009 (only the lookup matters)
