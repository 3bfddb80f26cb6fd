# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A store goes down during a recording: few warnings, no loss, and the recorder can be ended."""

from __future__ import annotations

import signal

import pytest
from nodes.children import await_true, start_client, start_recorder, told
from nodes.raw_publisher import RawPublisher, header_of, message
from proxy import BATCH, EXECUTE, Proxy
from std_msgs.msg import String

pytestmark = pytest.mark.suite("all", "it kills or cuts something, and waits")


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
    """Two warnings, and messages are kept meanwhile; a second Ctrl-C drops them."""
    proxy.cut()
    arguments = ("/a", "--wait", "600", "--no-spool")
    with start_recorder(roscore, proxy, keyspace, *arguments) as child, start_client(
        roscore
    ) as client:
        child.await_line("waiting up to 600 s for the store, messages wait in memory: no Cassandra")
        proxy.mend()
        child.await_line("recording 1 topic")
        assert sum("rror" in line for line in told(child, outages=True)) == 1
        one.await_subscribers().publish(text(0))
        # By the answer, which may come later than the row: what has none is waiting, too.
        await_number(client, 1, "stored")
        assert rosCas.getTopic("/a").countTopicData() == 1
        # All have come, and none is stored, before the store is away: so the warning knows them.
        held = proxy.catch(lambda frame: frame.opcode in (BATCH, EXECUTE), failed=False).hold()
        one.publish(*map(text, range(1, 1001)))
        await_number(client, 1001)
        proxy.cut()
        held.release()
        gone = child.await_line("has not answered since")
        assert f"the store at {proxy.host} port {proxy.port}" in gone
        assert "1000 messages (" in gone
        assert "kept in memory until 256 MB wait" in gone
        proxy.mend()
        child.await_line("answers again after")
        await_true(lambda: len(list(rosCas.getTopic("/a").rows())) == 1001)
        # Two of each time that it was away: a busy machine may let it stand still once more.
        warned = [line for line in told(child, outages=True) if "[WARN]" in line or "rror" in line]
        times_away = sum("answers again after" in line for line in warned)
        assert len(warned) == 1 + 2 * times_away, child.output
        proxy.cut()
        one.publish(*map(text, range(77)))
        await_true(lambda: child.output.count("has not answered since") > times_away)
        child.process.send_signal(signal.SIGINT)
        child.await_line("77 messages (0.0 MB) wait for the store; they are dropped if")
        assert child.end() == 1, child.output
    assert "recorder: 77 messages were lost" in child.output
    assert [row.wire for row in rosCas.getTopic("/a").rows()] == [text(n) for n in range(1001)]


def await_number(client, count, of="received"):
    def is_there():
        topics = client.call("/recorder/status")["topics"]
        return sum(topic[of] for topic in topics if topic["topic"] == "/a") == count

    await_true(is_there)


@pytest.mark.suite("all", "it stops the way to the store, and waits")
@pytest.mark.fault
def test_what_comes_before_the_store_answers_is_recorded(roscore, proxy, keyspace, rosCas, one):
    proxy.cut()
    arguments = ("/a", "--wait", "600", "-O", "early", "--no-spool")
    with start_recorder(roscore, proxy, keyspace, *arguments) as child, start_client(
        roscore
    ) as client:
        child.await_line("waiting up to 600 s for the store, messages wait in memory: no Cassandra")
        child.await_line("recording 1 topic")
        one.await_subscribers().publish(*map(text, range(500)))
        await_number(client, 500)
        status = client.call("/recorder/status")
        assert (status["state"], status["run"]) == ("waiting", "early")
        (topic,) = [each for each in status["topics"] if each["topic"] == "/a"]
        assert (topic["stored"], topic["lost"], topic["subscribed"]) == (0, 0, True)
        assert status["held_bytes"] > 500 * 300
        child.await_line("no store yet: 500 messages (")
        proxy.mend()
        child.await_line("the store answers after ")
        await_true(lambda: client.call("/recorder/status")["state"] == "recording")
        one.publish(text(500))
        await_number(client, 501)
        assert child.end() == 0, child.output
    assert [row.wire for row in rosCas.getTopic("/a").rows()] == [text(n) for n in range(501)]
    assert rosCas.losses() == []
    assert [run.name for run in rosCas.runs()] == ["early"]


@pytest.mark.fault
def test_what_does_not_fit_before_the_store_answers_is_told(roscore, proxy, keyspace, rosCas, one):
    proxy.cut()
    wires = [message(String(f"{n:05}" + 1000 * "x")) for n in range(2000)]
    with start_recorder(
        roscore, proxy, keyspace, "/a", "--wait", "600", "-b", "1", "--no-spool"
    ) as child:
        child.await_line("recording 1 topic")
        with start_client(roscore) as client:
            one.await_subscribers().publish(*wires)
            await_number(client, 2000)
        proxy.mend()
        await_true(lambda: rosCas.existTopic("/a"))
        assert child.end() == 1, child.output
    stored = [row.wire for row in rosCas.getTopic("/a").rows()]
    lost = 2000 - len(stored)
    assert 1000 < lost < 2000
    assert stored == wires[lost:]
    assert f"recorder: {lost} messages were lost" in child.output
    assert f"/a: {lost} lost: buffer full" in child.output
    assert sum(loss.count for loss in rosCas.losses(["/a"])) == lost


@pytest.mark.fault
def test_an_end_before_the_store_answers(roscore, proxy, keyspace, one):
    """After the first Ctrl-C messages wait for the store; the second one drops them."""
    proxy.cut()
    with start_recorder(roscore, proxy, keyspace, "/a", "--wait", "600", "--no-spool") as child:
        child.await_line("recording 1 topic")
        with start_client(roscore) as client:
            one.await_subscribers().publish(*map(text, range(7)))
            await_number(client, 7)
        child.process.send_signal(signal.SIGINT)
        child.await_line("7 messages (0.0 MB) wait for the store; they are dropped if")
        assert child.end() == 1, child.output
    assert "recorder: the store did not answer before the recording ended" in child.output
    assert "recorder: 7 messages were lost" in child.output


def test_a_store_that_does_not_come(roscore, proxy, keyspace):
    proxy.cut()
    with start_recorder(roscore, proxy, keyspace, "/nothing", "--wait", "2") as child:
        assert child.wait() == 1
    assert "recorder: no Cassandra answers at" in child.output
