# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A server that is killed or frozen under an import and under a recorder: numbered messages are
counted afterwards, and each is there once."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import threading
from types import SimpleNamespace

import pytest
from bag.test_import_process import write_bag
from nodes.children import await_true, start_recorder
from nodes.raw_publisher import RawPublisher, header_of, message
from std_msgs.msg import String

from cassandra_ros import RosCassandra
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.local_server import LocalCluster, free_port
from cassandra_ros.metadata import FORMAT_NAMES

GONE = "has not answered since"
COUNT = 20_000
HOW = [
    "killed",
    pytest.param(
        "frozen", marks=pytest.mark.suite("campaign", "the fault table has a store that is frozen")
    ),
]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A server of these tests alone."""
    running = LocalCluster(tmp_path_factory.mktemp("server"), port=free_port(), heap="512M")
    running.start(die_with_us=True)
    yield running
    running.stop()


@contextlib.contextmanager
def struck(cluster, how):
    """Kill or freeze the server; at the end it is there again."""
    (node,) = cluster.status()
    os.kill(node.pid, {"killed": signal.SIGKILL, "frozen": signal.SIGSTOP}[how])
    try:
        yield
    finally:
        if how == "frozen":
            os.kill(node.pid, signal.SIGCONT)
        else:
            cluster.start(die_with_us=True)


def place_of(cluster):
    return SimpleNamespace(host=cluster.settings.host, port=cluster.settings.port)


@pytest.mark.suite("all", "it kills a Cassandra")
@pytest.mark.fault
@pytest.mark.parametrize("how", HOW)
def test_an_import_survives_its_server(cluster, tmp_path, caplog, how):
    share, form = random.uniform(0.1, 0.9), random.choice(list(FORMAT_NAMES))
    told = f"struck after {share} of an import in format {form}"
    path = write_bag(tmp_path / "numbered.bag", COUNT, 100)
    reached, go_on, done, reports = threading.Event(), threading.Event(), [0], []
    place = place_of(cluster)

    def progress(messages, size):
        done[0] += messages
        if done[0] > share * COUNT and not reached.is_set():
            reached.set()
            assert go_on.wait(300)

    with RosCassandra(place.host, place.port, keyspace=f"import_{how}") as rosCas:

        def work():
            reports.append(import_bag(rosCas, path, format=form, progress=progress))

        importing = threading.Thread(target=work, daemon=True)
        importing.start()
        assert reached.wait(300), told
        with struck(cluster, how):
            go_on.set()
            await_true(lambda: GONE in caplog.text or not importing.is_alive())
        importing.join(400)
        assert not importing.is_alive(), told
    with RosCassandra(place.host, place.port, keyspace=f"import_{how}") as rosCas:
        assert [(report.messages, report.lost) for report in reports] == [(COUNT, {})], told
        verified = verify_bag(rosCas, path)
        assert verified.equal and verified.equal_messages == COUNT, (told, verified.first)
        assert sum(info.count for info in rosCas.info()) == COUNT, told
        assert sum(1 for _ in rosCas.readMessages()) == COUNT, told


@pytest.mark.suite("campaign", "the fault table has a store that is killed under a recorder")
@pytest.mark.fault
@pytest.mark.parametrize("how", HOW)
def test_a_recording_survives_its_server(roscore, cluster, how):
    form, place, keyspace = random.choice(list(FORMAT_NAMES)), place_of(cluster), f"recorder_{how}"
    options = ("/numbered", "--format", form, "--block-age", "0.2")
    sent = [message(String(f"{number}")) for number in range(3000)]

    def count():
        # A new client each time: what an old one knows of its server says nothing of the recorder.
        with RosCassandra(place.host, place.port, keyspace=keyspace) as rosCas:
            return sum(info.count for info in rosCas.info())

    with RawPublisher(roscore.uri, "/numbered", header_of(String)) as publisher, start_recorder(
        roscore, place, keyspace, *options
    ) as child:
        child.await_line("recording 1 topic")
        publisher.await_subscribers().publish(*sent[:1000])
        await_true(lambda: count() == 1000)
        with struck(cluster, how):
            publisher.publish(*sent[1000:2000])
            child.await_line(GONE)
        child.await_line("answers again after", timeout_sec=400)
        publisher.publish(*sent[2000:])
        await_true(lambda: count() == len(sent))
        assert child.end() == 0, (form, child.output)
    with RosCassandra(place.host, place.port, keyspace=keyspace) as rosCas:
        assert [row.wire for row in rosCas.readMessages()] == sent, form
        assert rosCas.losses() == [], form
