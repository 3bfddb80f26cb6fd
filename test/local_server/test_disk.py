# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is told of a full disk; that it is full is made believe."""

from __future__ import annotations

import shutil
from functools import partial
from itertools import chain, combinations

import pytest

from cassandra_ros.cli.local_cassandra import main
from cassandra_ros.local_server import disk
from cassandra_ros.local_server.cluster_settings import change_settings, new_settings, save_settings
from cassandra_ros.local_server.disk import (
    disk_trouble,
    full_disk,
    local_directory,
    local_nodes,
)
from cassandra_ros.local_server.nodes import Node


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The default directory, with a cluster of two nodes that does not run."""
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    folder = tmp_path / "cassandra_ros"
    folder.mkdir()
    save_settings(folder, change_settings(new_settings(), nodes=2, port=9177))
    return folder


def set_free(monkeypatch, mib):
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=mib << 20))


def test_the_local_server_is_known_by_its_address(folder):
    assert local_directory("127.0.0.1", 9177) == local_directory("localhost", 9177) == folder
    assert local_directory("127.0.0.2", 9177) == folder  # the second node
    for other in (("127.0.0.3", 9177), ("127.0.0.1", 9178), ("192.0.2.1", 9177), ("no.such.", 1)):
        assert local_directory(*other) is None


def test_a_full_disk_has_a_name(folder, monkeypatch, capsys):
    set_free(monkeypatch, 100)
    assert full_disk(folder) == ""
    assert "node 1 of" in disk_trouble(folder) and "does not run" in disk_trouble(folder)
    set_free(monkeypatch, 12)
    text = f"the disk of {folder} is full: 12 MiB are free; make room there"
    assert disk_trouble(folder) == full_disk(folder) == text
    main(["status"])
    assert text in capsys.readouterr().out


def pid_of(running, config, pid_file):
    """Return a pid if the server of a folder is among those that run; else 0."""
    return int(config.parent == pid_file.parent and config.parent in running)


@pytest.mark.parametrize("nodes", [1, 2, 3])
def test_the_first_node_that_does_not_run_is_named(folder, monkeypatch, nodes):
    set_free(monkeypatch, 100)
    save_settings(folder, change_settings(new_settings(), nodes=nodes, port=9177))
    numbers = range(1, nodes + 1)
    for down in chain.from_iterable(combinations(numbers, n) for n in range(nodes + 1)):
        stopped = [folder / f"node{number}" for number in down]
        running = {folder / f"node{number}" for number in numbers}.difference(stopped)
        monkeypatch.setattr(disk, "find_server", partial(pid_of, running))
        trouble = disk_trouble(folder)
        assert bool(trouble) == bool(down)
        if down:
            log = Node(down[0], stopped[0], new_settings()).log
            words = f"Cassandra node {down[0]} of {folder} does not run; its log is {log}"
            assert trouble == words
        assert local_nodes(folder) == (0 if len(down) == nodes else nodes)
        assert full_disk(folder) == ""


def test_a_disk_that_was_full_is_read_from_the_log(folder, monkeypatch):
    set_free(monkeypatch, 1000)
    settings = change_settings(new_settings(), nodes=2, port=9177)
    log = Node(2, folder / "node2", settings).log
    log.parent.mkdir(parents=True)
    full = "java.io.IOException: No space left on device\n"
    log.write_text(f"Starting listening for CQL clients\n{full}")
    assert f"{log} tells of it" in full_disk(folder)
    log.write_text(f"{full}Starting listening for CQL clients\n")  # before this start
    assert full_disk(folder) == ""
