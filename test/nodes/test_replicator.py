# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The node replicator: what it copies, its services, and what it says on /diagnostics."""

from __future__ import annotations

import pytest
from nodes.children import await_true, services_of, start_client, start_node
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


def named(texts, message):
    """Return which of some texts are in a message; None = its publisher has gone."""
    assert message is not None
    return {text for text in texts if text in message}


@pytest.fixture
def client(roscore):
    with start_client(roscore) as child:
        yield child


@pytest.mark.suite("test", "the services of the replicator")
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

        def is_done():
            answer = status()
            copied = [(each["copied"], each["waiting"]) for each in answer["topics"]]
            return (answer["success"], answer["state"], copied) == (True, "following", [(2, 0)])

        await_true(is_done)
        assert status()["target"].endswith(home.keyspace)
        name = "/replicator_of_test"  # others may have published there and be gone
        with RawSubscriber(roscore.uri, "/diagnostics", publisher=name) as diagnostics:
            wanted = {b"replicator_of_test: maximum size", b"replicator_of_test: /t"}
            # The first of them may come before the size of the store was measured.
            await_true(lambda: not wanted.difference(named(wanted, diagnostics.read())))
        assert client.call("/replicator_of_test/pause")["success"]
        await_true(lambda: status()["state"] == "paused")
        assert client.call("/replicator_of_test/resume")["success"]
        add(rosCas, 3)
        await_true(lambda: count(home) == 3)
        assert child.end() == 0


@pytest.mark.suite("test", "a promise of SECURITY.md")
def test_no_services(rosCas, home, roscore, cassandra):
    add(rosCas, 1)
    words = [
        *("--to", f"{cassandra.host}:{cassandra.port}/{home.keyspace}"),
        *("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", rosCas.keyspace),
        *("__name:=silent_replicator", "_no_services:=true"),
    ]
    with start_node(roscore, "replicator", *words) as child:
        child.await_line("/silent_replicator offers no services")
        await_true(lambda: count(home) == 1)
        assert services_of(roscore, "/silent_replicator") == set()
        assert child.end() == 0


@pytest.mark.suite("all", "it starts many programs")
def test_wrong_usage_is_told(roscore):
    words = ["--to", "nowhere", "_no_services:=perhaps", "__name:=replicator_in_doubt"]
    with start_node(roscore, "replicator", *words) as child:
        assert child.wait() == 2
        assert "parameter ~no_services: 'perhaps' is neither true nor false" in child.output
    with start_node(roscore, "replicator", "__name:=replicator_without_target") as child:
        assert child.wait() == 2
        assert "say where to copy" in child.output
    words = ["--to", "nowhere", "--drop-uncopied", "__name:=replicator_without_size"]
    with start_node(roscore, "replicator", *words) as child:
        assert child.wait() == 2
        assert "--drop-uncopied needs --max-size" in child.output
