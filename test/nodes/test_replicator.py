# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The node replicator: what it copies, its services, and what it says on /diagnostics."""

from __future__ import annotations

import pytest
from nodes.children import await_true, start_client, start_node
from nodes.raw_subscriber import RawSubscriber
from std_msgs.msg import Int64

T0 = 1_500_000_000 * 10**9


@pytest.fixture
def home(keyspaces, connect):
    """The store to which is copied."""
    with keyspaces.lend() as name, connect(keyspace=name) as store:
        yield store


def add(store, number):
    store.addTopic("/t").addData(Int64(number), key=T0 + number)
    store.catalog.adder.close()


def count(store):
    return store.getTopic("/t").countTopicData() if store.existTopic("/t") else 0


@pytest.fixture
def client(roscore):
    with start_client(roscore) as child:
        yield child


def test_it_copies_and_answers(rosCas, home, roscore, cassandra, client):
    add(rosCas, 1)
    words = [
        *("--to", f"{cassandra.host}:{cassandra.port}/{home.keyspace}", "--max-size", "1G"),
        *("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", rosCas.keyspace),
        "__name:=replicator_of_test",
    ]
    with start_node(roscore, "replicator", *words) as child:
        child.await_line("services under /replicator_of_test")
        await_true(lambda: count(home) == 1)
        child.await_line("following")
        add(rosCas, 2)
        await_true(lambda: count(home) == 2)

        def status():
            return client.call("/replicator_of_test/status")

        await_true(lambda: [each["copied"] for each in status()["topics"]] == [2])
        answer = status()
        assert (answer["success"], answer["state"]) == (True, "following")
        assert answer["target"].endswith(home.keyspace)
        assert [each["waiting"] for each in answer["topics"]] == [0]
        name = "/replicator_of_test"  # others may have published there and be gone
        with RawSubscriber(roscore.uri, "/diagnostics", publisher=name) as diagnostics:
            text = diagnostics.read()
        assert b"replicator_of_test: maximum size" in text
        assert b"replicator_of_test: /t" in text
        assert client.call("/replicator_of_test/pause")["success"]
        await_true(lambda: status()["state"] == "paused")
        assert client.call("/replicator_of_test/resume")["success"]
        add(rosCas, 3)
        await_true(lambda: count(home) == 3)
        assert child.end() == 0


def test_wrong_usage_is_told(roscore):
    with start_node(roscore, "replicator", "__name:=replicator_without_target") as child:
        assert child.wait() == 2
        assert "say where to copy" in child.output
    words = ["--to", "nowhere", "--drop-uncopied", "__name:=replicator_without_size"]
    with start_node(roscore, "replicator", *words) as child:
        assert child.wait() == 2
        assert "--drop-uncopied needs --max-size" in child.output
