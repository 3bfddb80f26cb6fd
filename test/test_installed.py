# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The package where it is installed: by pip from a wheel, by catkin_make install, as a .deb."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest
from conftest import ROOT

VERSION = re.search("<version>(.*)</version>", (ROOT / "package.xml").read_text())[1]
BUILT = (".git", ".venv", ".ws", "build", "demo-output", ".mypy_cache", ".ruff_cache")
SHARED = ("config/recorder.yaml", "launch/play.launch", "msg/Row.msg", "requirements/runtime.txt")
PACKAGE = ROOT / "src/cassandra_ros"
NOT_INSTALLED = ("README.md", "tsconfig.json")
"""Files of the package that only its developers need."""
PACKAGES = next(path for path in sys.path if path.endswith("site-packages"))


def run(words, env, cwd):
    done = subprocess.run(
        [*map(str, words)], env=env, cwd=cwd, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return done.stdout


def plain_env(**more):
    """Return an environment that knows no workspace."""
    names = ("HOME", "PATH", "LC_ALL", "PIP_INDEX_URL", "PIP_CONFIG_FILE")
    return {**{name: os.environ[name] for name in names if name in os.environ}, **more}


def check_installed(env, share, cwd, python):
    """Check that programs, services and shared files are those of the installation."""
    shown = run(["rosrun", "cassandra_ros", "recorder", "--version"], env, cwd)
    assert shown.startswith(f"recorder {VERSION} ")
    launch = run(["roslaunch", "--files", "cassandra_ros", "play.launch"], env, cwd)
    assert launch.strip() == str(share / "launch/play.launch")
    code = "import cassandra_ros, cassandra_ros.srv as s; print(cassandra_ros.__file__);"
    code += "from cassandra_ros.installation import requirements_file;"
    code += "print(s.GetData._type, requirements_file('viewer.txt'))"
    file, service, viewer = run([python, "-c", code], env, cwd).split()
    assert not file.startswith(str(ROOT)) and service == "cassandra_ros/GetData"
    assert viewer == str(share / "requirements/viewer.txt")
    for name in SHARED:
        assert (share / name).read_bytes() == (ROOT / name).read_bytes()
    for path in PACKAGE.rglob("*"):
        if path.is_file() and path.name not in NOT_INSTALLED and path.suffix != ".pyc":
            installed = Path(file).parent / path.relative_to(PACKAGE)
            assert installed.read_bytes() == path.read_bytes()


@pytest.fixture
def copy(tmp_path):
    """A copy of the files that git knows, so that nothing is built in the checkout."""
    target = tmp_path / "src" / "cassandra_ros"
    target.mkdir(parents=True)
    leave = [f"--exclude=./{name}" for name in BUILT]
    pack = subprocess.Popen(["tar", "-c", *leave, "."], cwd=ROOT, stdout=subprocess.PIPE)
    subprocess.run(["tar", "-x"], cwd=target, stdin=pack.stdout, check=True)
    assert pack.wait() == 0
    return target


@pytest.mark.suite("all", "it installs the package")
def test_a_wheel_is_built_and_installed_beside_ros(copy, tmp_path):
    env = plain_env()
    build = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation"]
    run([*build, "-q", "-w", tmp_path, copy], env, tmp_path)
    (wheel,) = tmp_path.glob("*.whl")
    home = tmp_path / "venv"
    venv.create(home, system_site_packages=True, with_pip=False, symlinks=True)
    (packages,) = home.glob("lib/python3*/site-packages")
    (packages / "tested.pth").write_text(PACKAGES)  # what requirements/runtime.txt pins is there
    python = home / "bin/python"
    run([python, "-m", "pip", "install", "-q", "--no-deps", wheel], env, tmp_path)
    share = home / "share"
    env.update(
        PATH=f"{home / 'bin'}:{env['PATH']}", ROS_PACKAGE_PATH=f"{share}:/usr/share:/opt/ros/noetic"
    )
    check_installed(env, share / "cassandra_ros", tmp_path, python)
    assert run(["cassandra_bag", "--version"], env, tmp_path).startswith("cassandra_bag ")


@pytest.mark.suite("all", "it installs the package")
def test_catkin_make_install(copy, tmp_path):
    env = plain_env()
    run(["catkin_make", f"-DPYTHON_EXECUTABLE={sys.executable}", "install"], env, tmp_path)
    share = tmp_path / "install/share/cassandra_ros"
    (packages,) = tmp_path.glob("install/lib/python3*/*-packages")
    env.update(
        CMAKE_PREFIX_PATH=str(tmp_path / "install"),
        PYTHONPATH=str(packages),
        ROS_PACKAGE_PATH=f"{tmp_path / 'install/share'}:/usr/share:/opt/ros/noetic",
    )
    check_installed(env, share, tmp_path, sys.executable)
    typed = (
        f"source {tmp_path}/install/setup.bash && which cassandra_bag && cassandra_bag --version"
    )
    where, _, version = run(["bash", "-c", typed], plain_env(), tmp_path).partition("\n")
    assert where == str(tmp_path / "install/bin/cassandra_bag")
    assert version.startswith(f"cassandra_bag {VERSION} ")


@pytest.mark.suite("campaign", "it downloads 30 MB and takes minutes")
@pytest.mark.skipif(not shutil.which("dh"), reason="the program dh of debhelper is not installed")
def test_a_deb_holds_all_that_debian_lacks(tmp_path):
    run(["make", "deb"], plain_env(), ROOT)
    (deb,) = (ROOT / "build").glob(f"cassandra-ros_{VERSION}_*.deb")
    run(["dpkg-deb", "-x", deb, tmp_path], plain_env(), tmp_path)
    pure = [
        tmp_path / "usr/lib" / name for name in ("python3/dist-packages", "cassandra_ros_python")
    ]
    env = plain_env(
        PATH="/usr/bin:/bin",
        PYTHONPATH=":".join(map(str, pure)),
        ROS_PACKAGE_PATH=f"{tmp_path / 'usr/share'}:/usr/share",
        CMAKE_PREFIX_PATH=f"{tmp_path / 'usr'}:/usr",
    )
    program = tmp_path / "usr/lib/cassandra_ros/recorder"
    assert program.read_text().startswith("#!/usr/bin/python3\n")
    assert run([program, "--version"], env, tmp_path).startswith(f"recorder {VERSION} ")
    on_path = tmp_path / "usr/bin/cassandra_bag"
    assert on_path.read_text().startswith("#!/usr/bin/python3\n")
    assert run([on_path, "--version"], env, tmp_path).startswith(f"cassandra_bag {VERSION} ")
    code = "import cassandra_ros as c, cassandra_ros.srv; print(c.RosCassandra)"
    run(["/usr/bin/python3", "-c", code], env, tmp_path)
