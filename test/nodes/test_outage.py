# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A store that goes away while it is recorded into: few words, nothing lost, a way out."""

from __future__ import annotations

import signal

import pytest
from nodes.children import await_true, start_recorder
from nodes.raw_publisher import RawPublisher, header_of, message
from proxy import Proxy
from std_msgs.msg import String


def text(n):
    return message(String(str(n)))


@pytest.fixture
def proxy(cassandra):
    with Proxy(cassandra.host, cassandra.port) as running:
        yield running


@pytest.fixture
def one(roscore):
    with RawPublisher(roscore.uri, "/a", header_of(String)) as publisher:
        yield publisher


@pytest.mark.fault
def test_a_store_that_goes_away(roscore, proxy, keyspace, rosCas, one):
    """Told in two lines, with all that comes meanwhile kept; a second Ctrl-C drops that."""
    proxy.cut()
    with start_recorder(roscore, proxy, keyspace, "/a", "--wait", "60") as child:
        child.await_line("waiting up to 60 s for the store: no Cassandra answers at")
        proxy.mend()
        child.await_line("recording 1 topic")
        assert sum("rror" in line for line in child.lines) == 1
        one.await_subscribers().publish(text(0))
        await_true(lambda: rosCas.existTopic("/a") and rosCas.getTopic("/a").countTopicData() == 1)
        proxy.cut()
        one.publish(*map(text, range(1, 1001)))
        gone = child.await_line("has not answered since")
        assert f"the store at {proxy.host} port {proxy.port}" in gone
        assert "1000 messages (" in gone
        assert "kept in memory until 256 MB wait" in gone
        proxy.mend()
        child.await_line("answers again after")
        await_true(lambda: len(list(rosCas.getTopic("/a").rows())) == 1001)
        told = [line for line in child.lines if "[WARN]" in line or "rror" in line]
        assert len(told) == 1 + 2, child.output
        proxy.cut()
        one.publish(*map(text, range(77)))
        await_true(lambda: child.output.count("has not answered since") == 2)
        child.process.send_signal(signal.SIGINT)
        child.await_line("77 messages (0.0 MB) wait for the store; they are dropped if")
        assert child.end() == 1, child.output
    assert "recorder: 77 messages were lost" in child.output
    assert [row.wire for row in rosCas.getTopic("/a").rows()] == [text(n) for n in range(1001)]
