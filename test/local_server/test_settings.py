# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server import LocalCluster, cluster_settings, free_port
from cassandra_ros.local_server.cluster_settings import (
    change_settings,
    load_settings,
    new_settings,
    own_heap_mb,
    parse_heap,
    save_settings,
)
from cassandra_ros.local_server.server_security import Security


@pytest.mark.parametrize(
    ("text", "mib"), [("512M", 512), ("2G", 2048), ("2g", 2048), ("300", 300), ("1GiB", 1024)]
)
def test_heap_sizes(text, mib):
    assert parse_heap(text) == mib


@pytest.mark.parametrize(
    ("memory_gib", "nodes", "mib"),
    [
        *((1, 1, 512), (2, 1, 512), (4, 1, 1024), (8, 1, 2048), (16, 1, 4096), (64, 1, 4096)),
        *((4, 3, 512), (12, 3, 1024), (64, 2, 2048)),
    ],
)
def test_the_heap_follows_the_memory_that_all_nodes_share(memory_gib, nodes, mib):
    assert own_heap_mb(nodes, memory_gib << 30) == mib


def test_a_default_heap_is_not_stored(tmp_path):
    settings = new_settings()
    assert 512 <= settings.java_heap_mb == own_heap_mb(1) <= 4096
    assert change_settings(settings, heap="768M").java_heap_mb == 768
    assert change_settings(change_settings(settings, heap="768M"), heap="0") == settings
    save_settings(tmp_path, settings)
    assert load_settings(tmp_path).heap_mb == 0


@pytest.mark.parametrize("text", ["", "much", "-1", "1.5G", "512K"])
def test_heap_that_is_no_size(text):
    with pytest.raises(ServerError, match="512M or 2G"):
        parse_heap(text)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"host": "0.0.0.0"}, "loopback only"),  # noqa: S104 (it is refused)
        ({"host": "192.168.1.7"}, "loopback only"),
        ({"host": "localhost"}, "loopback only"),
        ({"host": "127.255.255.254", "nodes": 3}, "loopback only"),
        ({"nodes": 0}, "1 to 3"),
        ({"nodes": 4}, "1 to 3"),
        ({"port": 0}, "65535"),
        ({"port": 70000}, "65535"),
        ({"heap": "64M"}, "256M or more"),
    ],
)
def test_options_that_cannot_be(options, words):
    with pytest.raises(ServerError, match=words):
        change_settings(new_settings(), **options)


def test_options_that_are_not_given_stay():
    old = change_settings(new_settings(), port=9999, heap="1G")
    assert change_settings(old, nodes=2) == change_settings(old, nodes=2, port=9999, heap="1G")


def test_what_is_saved_is_loaded(tmp_path):
    settings = change_settings(new_settings(), nodes=3, host="127.0.0.7", port=9123)
    save_settings(tmp_path, settings)
    assert load_settings(tmp_path) == settings
    assert [settings.address(i) for i in (1, 2, 3)] == ["127.0.0.7", "127.0.0.8", "127.0.0.9"]


SAVE = """
import resource, sys
from pathlib import Path
from cassandra_ros.local_server.cluster_settings import (
    change_settings, load_settings, save_settings)

directory = Path(sys.argv[1])
wanted = change_settings(load_settings(directory), heap="4G")
resource.setrlimit(resource.RLIMIT_FSIZE, (10, resource.RLIM_INFINITY))
save_settings(directory, wanted)
"""


def test_settings_that_cannot_be_written_whole_leave_the_old_ones(tmp_path):
    settings = change_settings(new_settings(), port=9123)
    save_settings(tmp_path, settings)
    child = subprocess.run(
        [sys.executable, "-c", SAVE, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2] / "src")},
        stderr=subprocess.PIPE,
        text=True,
    )
    assert "File too large" in child.stderr
    assert load_settings(tmp_path) == settings


def test_who_reads_settings_while_they_change_has_the_old_ones_whole(tmp_path):
    settings = change_settings(new_settings(), port=9123)
    save_settings(tmp_path, settings)
    with (tmp_path / "cluster.json").open() as opened:
        save_settings(tmp_path, change_settings(settings, port=9124))
        assert json.load(opened)["port"] == 9123
    assert load_settings(tmp_path).port == 9124


def test_two_clusters_have_two_names():
    assert new_settings().cluster_name != new_settings().cluster_name


def test_a_new_directory_has_no_settings(tmp_path):
    assert load_settings(tmp_path / "new") is None
    (tmp_path / "jars").mkdir()
    (tmp_path / "studio").mkdir()  # the viewer's, of the same home
    (tmp_path / "spool").mkdir()  # a recorder's
    assert load_settings(tmp_path) is None


def test_a_foreign_directory_is_refused(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "commitlog").mkdir()
    with pytest.raises(ServerError, match=r"commitlog, data.*another Cassandra.*--dir"):
        LocalCluster(tmp_path)


def test_a_login_folder_of_another_program_is_foreign(tmp_path):
    (tmp_path / "login").mkdir()  # to clear the cluster would remove it
    with pytest.raises(ServerError, match="login"):
        LocalCluster(tmp_path)


def test_what_a_start_leaves_that_was_killed_is_not_foreign(tmp_path):
    (tmp_path / "lock").touch()
    (tmp_path / "cluster.draft").write_text("{")
    assert load_settings(tmp_path) is None


def test_what_another_start_makes_meanwhile_is_not_foreign(tmp_path, monkeypatch):
    def too_early(path, **_):
        save_settings(tmp_path, new_settings())
        (tmp_path / "node1").mkdir()
        raise FileNotFoundError(path)

    with monkeypatch.context() as patched:
        patched.setattr(cluster_settings, "open_regular", too_early)
        assert load_settings(tmp_path) is None
    assert load_settings(tmp_path)


def test_a_file_is_no_directory(tmp_path):
    path = tmp_path / "file"
    path.write_text("")
    with pytest.raises(ServerError, match="is a file|cannot be read"):
        LocalCluster(path)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"cluster_name": 1, "nodes": "x"}', "{}"])
def test_damaged_settings_say_which_file(tmp_path, text):
    (tmp_path / "cluster.json").write_text(text)
    with pytest.raises(ServerError, match="cluster.json cannot be read"):
        LocalCluster(tmp_path)


def test_stop_and_clear_know_what_was_started_meanwhile(tmp_path):
    early = LocalCluster(tmp_path)
    save_settings(tmp_path, change_settings(new_settings(), nodes=3))
    assert early.stop() is False
    assert len(early.nodes) == 3
    early = LocalCluster(tmp_path / "other")
    (tmp_path / "other").mkdir()
    assert early.clear() is False
    save_settings(tmp_path / "other", new_settings())
    assert early.clear() is True
    assert not early.exists


def test_a_cluster_that_cannot_be_made_secure_stays_as_it_was(tmp_path, monkeypatch):
    save_settings(tmp_path, change_settings(new_settings(), port=free_port()))

    def make_files(self, java):
        raise ServerError("keytool did not end")

    monkeypatch.setattr(Security, "make_files", make_files)
    with pytest.raises(ServerError, match="keytool did not end"):
        LocalCluster(tmp_path, secure=True).start()
    assert not load_settings(tmp_path).secure
