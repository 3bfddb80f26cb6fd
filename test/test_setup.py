# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""requirements/setup.sh: what it refuses, what it skips, what it says."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from cassandra_ros.local_server.class_archive import takes_archives
from cassandra_ros.local_server.jars import find_java

ROOT = Path(__file__).resolve().parents[1]


def set_up(folder, path=""):
    return subprocess.run(
        ["bash", "requirements/setup.sh"],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        env={**os.environ, "PATH": f"{path}:{os.environ['PATH']}"},
        timeout=300,
    )


def checkout(folder):
    """A copy of what setup.sh reads before its first step."""
    (folder / "requirements").mkdir(parents=True)
    shutil.copy(ROOT / "requirements" / "setup.sh", folder / "requirements")
    shutil.copy(ROOT / "Makefile", folder)
    return folder


@pytest.mark.suite("all", "it runs make setup")
def test_a_second_set_up_skips_every_step():
    done = set_up(ROOT)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    # A Java that takes no archive of classes, as that of PyPI, is told each time.
    told = [] if takes_archives(find_java()) else ["cassandra"]
    assert [line.split(":")[1].strip() for line in lines[:-1]] == [
        "packages",
        "python",
        *told,
        "cassandra",
        "studio",
        "workspace",
    ]
    steps = [line for line in lines[:-1] if "skipped" in line or "was already" in line]
    others = [line for line in lines[:-1] if line not in steps]
    assert len(others) == len(told) and all("takes none" in line for line in others)
    assert "source .ws/devel/setup.bash" in lines[-1]


@pytest.mark.parametrize("sign", [".catkin_workspace", ".catkin_tools", "src/CMakeLists.txt"])
def test_in_somebodys_workspace_it_stops_and_prints_their_command(tmp_path, sign):
    theirs = tmp_path / "their_ws"
    folder = checkout(theirs / "src" / "robots" / "cassandra_ros")
    if sign == ".catkin_tools":
        (theirs / sign).mkdir()
    else:
        (theirs / sign).write_text("catkin_workspace()\n")
    done = set_up(folder)
    assert done.returncode == 1
    assert done.stdout == ""
    assert f"cd {theirs} && catkin_make -DPYTHON_EXECUTABLE=" in done.stderr
    assert f"pip install -r {folder}/requirements/runtime.txt" in done.stderr
    assert not (folder / ".ws").exists()


# Installed is what the file 'installed' beside it matches.
_DPKG_QUERY = """#!/bin/sh
[ "$1 $2 $3" = '-W -f \\n${db:Status-Status} ${Package} ' ] || exit 2
shift 3
for package; do
  echo "$package" | grep -Eqx "$(cat "$(dirname "$0")/installed")" && state= || state=not-
  printf '\\n%sinstalled %s ' "$state" "$package"
done
"""


def without_root(folder, installed):
    """Stubs of what asks for the user and the packages."""
    folder.mkdir()
    for name, text in (("id", "#!/bin/sh\necho 1000"), ("sudo", "#!/bin/sh\nexit 1")):
        (folder / name).write_text(f"{text}\n")
    (folder / "dpkg-query").write_text(_DPKG_QUERY)
    (folder / "installed").write_text(installed)
    for name in ("id", "sudo", "dpkg-query"):
        (folder / name).chmod(0o755)
    return str(folder)


def test_without_root_and_sudo_it_prints_the_one_command(tmp_path):
    done = set_up(checkout(tmp_path / "checkout"), path=without_root(tmp_path / "bin", "nothing"))
    assert done.returncode == 1
    commands = [line for line in done.stderr.splitlines() if "apt-get install" in line]
    assert len(commands) == 1
    assert commands[0].strip().startswith("sudo sh -c 'apt-get update && apt-get install")
    assert "python3-venv" in commands[0]
    assert not [word for word in ("openjdk", "maven", "chromium") if word in commands[0]]


@pytest.mark.suite("all", "it installs packages")
def test_without_root_what_only_tests_need_is_named_in_one_line(tmp_path):
    folder = checkout(tmp_path / "checkout")
    # The next step stops: it installs what no file names.
    (folder / "requirements/dev.txt").write_text("-r not-there.txt\n")
    for name in ("requirements/java.txt", "requirements/runtime.txt"):
        (folder / name).touch()
    stubs = without_root(tmp_path / "bin", ".*(ros|tf|msgs|srvs|gcc|g\\+\\+|cmake|venv).*")
    (Path(stubs) / "sleep").write_text("#!/bin/sh\n")
    (Path(stubs) / "sleep").chmod(0o755)
    done = set_up(folder, path=stubs)
    lines = [line for line in done.stdout.splitlines() if "apt-get install" in line]
    assert len(lines) == 1
    assert "zsh curl openssl" in lines[0]
    assert "rospy" not in lines[0]
    assert "setup: python: installing requirements/dev.txt" in done.stdout
