# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The archive of classes: made once, used at each start, and never a reason why a start fails."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from nodes.children import await_true

from cassandra_ros.local_server import LocalCluster, free_port
from cassandra_ros.local_server.class_archive import make_class_archive, takes_archives
from cassandra_ros.local_server.jars import find_java, jars_directory
from cassandra_ros.local_server.nodes import find_archive


@pytest.fixture
def jars(tmp_path, monkeypatch):
    """A folder of its own with Cassandra's jars."""
    folder = tmp_path / "jars"
    folder.mkdir()
    for path in jars_directory().iterdir():
        if path.suffix != ".jsa":
            os.symlink(path, folder / path.name)
    monkeypatch.setenv("CASSANDRA_ROS_JARS", str(folder))
    return folder


def uses_archive(cluster):
    """Start the cluster, which has to answer; return whether Java has mapped an archive of ours."""
    cluster.start(die_with_us=True)
    try:
        await_true(lambda: cluster.status()[0].answers)  # a busy one may take longer than 2 s
        (status,) = cluster.status()
        return "/classes-" in Path(f"/proc/{status.pid}/maps").read_text()
    finally:
        cluster.stop()


@pytest.mark.suite("all", "it starts a Cassandra")
def test_an_archive_is_made_once_and_used_where_it_fits(jars, tmp_path):
    said = []
    cluster = LocalCluster(tmp_path / "server", port=free_port(), heap="512M")
    if not takes_archives(find_java()):
        assert not make_class_archive(said.append)
        assert "takes none" in said[0]
        pytest.skip("this Java takes no archives")
    assert make_class_archive(said.append)
    assert not make_class_archive(said.append)
    assert len(said) == 1
    assert [path.name for path in jars.parent.glob(".classes-*")] == []
    assert uses_archive(cluster)
    archive = find_archive(find_java(), jars)
    whole = archive.read_bytes()
    archive.write_bytes(whole[: len(whole) // 2])
    assert find_archive(find_java(), jars) is None  # Java would crash with it
    archive.write_bytes(bytes(len(whole)))
    assert not uses_archive(cluster)
    archive.write_bytes(whole)
    (jars / "zzz-1.0.jar").write_bytes((jars / "slf4j-api-2.0.17.jar").read_bytes())
    (jars / "jcl-over-slf4j-2.0.17.jar").unlink()
    assert not uses_archive(cluster)
