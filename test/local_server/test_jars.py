# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import hashlib
import re
import shutil
import sys

import pytest

from cassandra_ros.errors import MissingDependency, ServerError
from cassandra_ros.local_server import jars

JAR = f"cassandra-all-{jars.cassandra_version()}.jar"
POM = jars.server_file("pom.xml")

# Stands for Maven: fails as often as the file 'failures' says, then "downloads" one jar.
_MAVEN = """#!/bin/sh
cd "$(dirname "$0")"
echo "$*" >>calls
left=$(cat failures)
if [ "$left" -gt 0 ]; then
  echo $((left - 1)) >failures
  echo '[ERROR] Could not transfer artifact: Connection reset'
  exit 1
fi
for word in "$@"; do
  case $word in -DoutputDirectory=*) printf jar >"${word#*=}/{jar}" ;; esac
done
"""

# Stands for maven-artifact: "downloads" a jar, or fails once where the file 'fail' names it.
_MAVEN_ARTIFACT = """
import os, sys
coordinates, path = sys.argv[1:]
here = os.path.dirname(__file__)
open(os.path.join(here, "calls"), "a").write(coordinates + "\\n")
fail = os.path.join(here, "fail")
if os.path.exists(fail) and open(fail).read() in coordinates:
    os.remove(fail)
    sys.exit("Connection reset")
open(path, "w").write("jar")
"""


@pytest.fixture
def maven(tmp_path, monkeypatch):
    folder = tmp_path / "maven"
    folder.mkdir()
    (folder / "mvn").write_text(_MAVEN.replace("{jar}", JAR))
    (folder / "mvn").chmod(0o755)
    (folder / "failures").write_text("0")
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")
    monkeypatch.setenv("CASSANDRA_ROS_JARS", str(tmp_path / "home" / "jars"))
    monkeypatch.setattr(jars, "_PAUSE_SEC", 0)
    make_list(tmp_path, monkeypatch, [f"g:cassandra-all:{jars.cassandra_version()}"])
    return folder


def make_list(tmp_path, monkeypatch, coordinates, content=b"jar"):
    """Let the package hold a jars.txt of these jars beside the files that it has."""
    server = tmp_path / "list" / "server"
    server.mkdir(parents=True, exist_ok=True)
    shutil.copy(POM, server)
    digest = hashlib.sha256(content).hexdigest()
    (server / "jars.txt").write_text("# a list\n" + "".join(f"{digest} {c}\n" for c in coordinates))
    monkeypatch.setattr(jars, "server_file", server.joinpath)


@pytest.fixture
def maven_artifact(maven, tmp_path, monkeypatch):
    """No Maven, and a package maven_artifact, which jars.txt gives three jars to fetch."""
    (maven / "mvn").unlink()
    monkeypatch.setattr(shutil, "which", lambda name: None)
    package = tmp_path / "packages" / "maven_artifact"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "main.py").write_text(_MAVEN_ARTIFACT)
    monkeypatch.syspath_prepend(str(package.parent))
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    monkeypatch.delitem(sys.modules, "maven_artifact", raising=False)
    wanted = [f"g:cassandra-all:{jars.cassandra_version()}", "g:b:jar:linux:2", "g.h:c:3"]
    make_list(tmp_path, monkeypatch, wanted)
    yield package
    sys.modules.pop("maven_artifact", None)


def calls(maven):
    return (maven / "calls").read_text().splitlines() if (maven / "calls").exists() else []


def test_what_is_there_is_not_fetched_again(maven):
    said = []
    assert not jars.jars_installed()
    assert jars.install_jars(said.append) is True
    assert jars.jars_installed()
    assert jars.install_jars(said.append) is False
    assert len(calls(maven)) == 1
    assert len(said) == 1


def test_a_failed_download_is_tried_again_past_mavens_memory(maven):
    (maven / "failures").write_text("2")
    said = []
    assert jars.install_jars(said.append)
    first, second, third = calls(maven)
    assert not first.endswith("-U")
    assert second.endswith("-U")
    assert third.endswith("-U")
    assert "Connection reset" in said[1]


def test_a_download_that_never_works_says_so_and_leaves_nothing(maven):
    (maven / "failures").write_text("99")
    with pytest.raises(ServerError, match=r"4 times(.|\n)*Connection reset(.|\n)*network"):
        jars.install_jars(lambda text: None)
    assert not jars.jars_installed()
    assert not [p for p in jars.jars_directory().parent.iterdir() if p.is_dir()]


def test_another_version_in_the_pom_is_fetched(maven, monkeypatch):
    jars.install_jars(lambda text: None)
    (jars.jars_directory() / "complete").write_text("the digest of an older pom")
    assert jars.install_jars(lambda text: None)


def test_without_maven_the_listed_jars_are_fetched_one_by_one(maven_artifact):
    said = []
    assert jars.install_jars(said.append) is True
    names = sorted(path.name for path in jars.jars_directory().glob("*.jar"))
    assert names == ["b-2-linux.jar", "c-3.jar", JAR]
    assert sorted(calls(maven_artifact)) == sorted(c for _, c in jars.listed_jars().values())
    assert "with maven-artifact" in said[0]
    assert jars.install_jars(said.append) is False


def test_only_the_jar_that_failed_is_fetched_again(maven_artifact):
    (maven_artifact / "fail").write_text("g:b:")
    said = []
    jars.install_jars(said.append)
    asked = calls(maven_artifact)
    assert asked.count("g:b:jar:linux:2") == 2
    assert asked.count("g.h:c:3") == 1
    assert "Connection reset" in said[1]


def test_neither_maven_nor_maven_artifact(maven, monkeypatch):
    (maven / "mvn").unlink()
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "maven_artifact", None)
    with pytest.raises(MissingDependency, match=r"pip install -r .*/requirements/java.txt"):
        jars.install_jars(lambda text: None)


@pytest.mark.parametrize("listed", [[], [f"g:cassandra-all:{jars.cassandra_version()}", "g:x:1"]])
def test_jars_that_are_not_the_listed_ones_are_not_kept(maven, tmp_path, monkeypatch, listed):
    make_list(tmp_path, monkeypatch, listed)
    name = "x-1.jar" if listed else JAR
    with pytest.raises(ServerError, match=rf"1 differ, as {name} .*m2/repository"):
        jars.install_jars(lambda text: None)
    assert not jars.jars_installed()
    assert not jars.jars_directory().exists()


def test_a_jar_of_another_content_is_not_kept(maven, tmp_path, monkeypatch):
    make_list(tmp_path, monkeypatch, [f"g:cassandra-all:{jars.cassandra_version()}"], b"another")
    with pytest.raises(
        ServerError, match=r"1 differ, as cassandra-all.*\(SHA-256 \w{64}, listed: \w{64}"
    ):
        jars.install_jars(lambda text: None)


@pytest.mark.suite("all", "it reads each jar")
def test_the_list_is_what_make_setup_has_installed():
    there = {path.name: jars._digest(path) for path in jars.jars_directory().glob("*.jar")}
    assert there == {name: digest for name, (digest, _) in jars.listed_jars().items()}
    assert JAR in there


def test_no_space(maven, monkeypatch):
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=5 << 20))
    with pytest.raises(ServerError, match="no space .* 5 MiB free"):
        jars.install_jars(lambda text: None)


def test_the_version_is_new_enough():
    version = tuple(int(n) for n in re.findall(r"\d+", jars.cassandra_version()))
    assert version >= (5, 0, 8)


def test_jars_in_a_folder_of_another_user_need_no_lock(maven, monkeypatch):
    assert jars.install_jars(lambda text: None) is True

    def refused(path):
        raise PermissionError(path)

    monkeypatch.setattr(jars, "locked", refused)
    assert jars.install_jars(lambda text: None) is False
