# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import sys
from pathlib import Path

import pytest
import yaml

from cassandra_ros.local_server.cluster_settings import change_settings, new_settings
from cassandra_ros.local_server.nodes import Node


def node(number=1, directory="/data/node1", **options):
    settings = change_settings(new_settings(), **options)
    return Node(number, Path(directory), settings)


def test_the_configuration_is_yaml_with_what_was_asked():
    config = yaml.safe_load(node(2, nodes=3, port=9999).render_yaml())
    assert config["listen_address"] == config["rpc_address"] == "127.0.0.2"
    assert config["native_transport_port"] == 9999
    seeds = config["seed_provider"][0]["parameters"][0]["seeds"]
    assert seeds == "127.0.0.1:0,127.0.0.2:0,127.0.0.3:0"


@pytest.mark.parametrize("nodes", [1, 2, 3])
def test_tokens_share_the_ring_evenly(nodes):
    tokens = [
        yaml.safe_load(node(i + 1, nodes=nodes).render_yaml())["initial_token"]
        for i in range(nodes)
    ]
    gaps = {(b - a) % 2**64 for a, b in zip(tokens, tokens[1:] + tokens[:1])} or {2**64}
    assert all(-(2**63) <= token < 2**63 for token in tokens)
    assert max(gaps) - min(gaps) <= nodes


def test_nothing_listens_beyond_loopback():
    config = yaml.safe_load(node().render_yaml())
    assert {config[key] for key in config if key.endswith("_address")} == {"127.0.0.1"}
    command = node().command(sys.executable, Path("/jars"))
    assert not [word for word in command if "jmx" in word and "port" in word]


def test_the_memory_follows_the_heap():
    small, large = (yaml.safe_load(node(heap=heap).render_yaml()) for heap in ("512M", "2G"))
    assert small["memtable_heap_space"] == "96MiB"
    assert large["memtable_heap_space"] == "384MiB"
    command = node(heap="2G").command(sys.executable, Path("/jars"))
    assert "-Xmx2048M" in command
    assert "-Xms2048M" in command
    assert "-Xms512M" in node().command(sys.executable, Path("/jars"))  # the rest when it is needed
    assert "-XX:MaxDirectMemorySize=2048M" in node(heap="4G").command(sys.executable, Path("/jars"))
    # Cassandra's own bounds of what is in the air are parts of the heap.
    assert not [key for key in small if "in_flight" in key]


@pytest.mark.parametrize("before", [None, 0o755, 0o777])
def test_other_users_read_neither_data_nor_logs(tmp_path, before):
    """Also where the folders stood before. test_secure.py has clusters with a login."""
    made = node(directory=tmp_path / "cluster" / "node1")
    if before is not None:
        for folder in (made.directory, made.directory / "logs"):
            folder.mkdir(parents=True)
            folder.chmod(before)
    made.write_config()
    for folder in (made.directory, made.log.parent):
        assert folder.stat().st_mode & 0o777 == 0o700
    assert made.config.stat().st_mode & 0o777 == 0o600


def test_a_folder_with_odd_letters_becomes_a_url():
    command = node(directory="/my data/nöde").command(sys.executable, Path("/jars"))
    assert "-Dcassandra.config=file:///my%20data/n%C3%B6de/cassandra.yaml" in command
    assert "-Dcassandra.storagedir=/my data/nöde" in command
