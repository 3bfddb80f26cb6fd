# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import re
import shutil

import pytest

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server import jars

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
  case $word in -DoutputDirectory=*) touch "${word#*=}/{jar}" ;; esac
done
"""


@pytest.fixture
def maven(tmp_path, monkeypatch):
    folder = tmp_path / "maven"
    folder.mkdir()
    jar = f"cassandra-all-{jars.cassandra_version()}.jar"
    (folder / "mvn").write_text(_MAVEN.replace("{jar}", jar))
    (folder / "mvn").chmod(0o755)
    (folder / "failures").write_text("0")
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")
    monkeypatch.setenv("CASSANDRA_ROS_JARS", str(tmp_path / "home" / "jars"))
    monkeypatch.setattr(jars, "_PAUSE_SEC", 0)
    return folder


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


def test_no_maven(maven, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ServerError, match="apt-get install maven"):
        jars.install_jars(lambda text: None)


def test_no_space(maven, monkeypatch):
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=5 << 20))
    with pytest.raises(ServerError, match="no space .* 5 MiB free"):
        jars.install_jars(lambda text: None)


def test_the_version_is_new_enough():
    version = tuple(int(n) for n in re.findall(r"\d+", jars.cassandra_version()))
    assert version >= (5, 0, 8)
