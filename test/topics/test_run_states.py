# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs that go on, ended, were killed or failed: what is told of each."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import time

import pytest
from nodes.children import await_true
from std_msgs.msg import Int64
from topics.clients import ROOT

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.store.tables.directory import STALE_SEC
from cassandra_ros.store.tables.registry import Loss, LossKind, Run

T0 = 1_500_000_000 * SECOND_NS
RECORDER = """
    import sys, time
    sys.path.insert(0, sys.argv[4])
    from cassandra_ros import RosCassandra
    from topics.test_run_states import begin
    with RosCassandra(sys.argv[1], int(sys.argv[2]), keyspace=sys.argv[3]) as store:
        writer = begin(store, 7, "killed")
        print("ready", flush=True)
        time.sleep(300)
"""


def begin(store, writer_id, name, kind="recording", count=5):
    """Begin a run and store some messages, of which the directory knows only that there are any."""
    writer = store.messageWriter(
        writer_id=writer_id, run=Run("husky", writer_id, kind, name=name), nodeID="husky"
    )
    add(writer, count)
    return writer


def add(writer, count, topic="/n"):
    header = {"type": Int64._type, "md5sum": Int64._md5sum}
    header["message_definition"] = Int64._full_text
    handle = writer.connect(live_connection(topic, header), bucket_ns=2 * SECOND_NS)
    for n in range(count):
        writer.write(handle, T0 + n * SECOND_NS, n, serialize(Int64(n)))
    writer.flush()


def age(cql, keyspace, seconds=STALE_SEC + 5):
    """Make what was told of all runs so old, by the server's own clock."""
    past = f"toTimestamp(now()) - {int(seconds)}s"
    query = "SELECT table_name FROM system_schema.tables WHERE keyspace_name = %s"
    there = {name for (name,) in cql.execute(query, (keyspace,))}
    for table, column, key in (
        ("cr_run", "started", ("writer", "node")),
        ("cr_bucket", "heartbeat", ("tbl", "node", "slot", "bucket", "writer")),
        ("cr_active", "heartbeat", ("tbl", "slot", "bucket", "node", "writer")),
        ("cr_context", "heartbeat", ("writer", "node")),
    ):
        if table not in there:
            continue  # the run is not told of there
        where = " AND ".join(f"{name} = %s" for name in key)
        for row in cql.execute(f"SELECT {', '.join(key)} FROM {keyspace}.{table}").all():
            cql.execute(f"UPDATE {keyspace}.{table} SET {column} = {past} WHERE {where}", row)


def told(store):
    return {run.name: (run.state, dict(run.stored), run.ended is None) for run in store.runs()}


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_a_killed_run_shows_what_it_stored(cassandra, connect, cql, keyspace):
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(RECORDER)]
        + [cassandra.host, str(cassandra.port), keyspace, str(ROOT / "test")],
        env={**os.environ, "PYTHONPATH": f"{ROOT / 'src'}:{os.environ.get('PYTHONPATH', '')}"},
        stdout=subprocess.PIPE,
        text=True,
    )
    with process, connect(keyspace=keyspace) as store:
        try:
            assert process.stdout.readline() == "ready\n"
            assert told(store) == {"killed": ("recording", {"/n": 5}, True)}
        finally:
            process.kill()
        process.wait()
        store.catalog.keyspace.registry.put_loss(
            Loss("/n", "husky", 7, LossKind.BUFFER_FULL, T0, T0, 3)
        )
        age(cql, keyspace)
        assert told(store) == {"killed": ("interrupted", {"/n": 5}, True)}
        assert [dict(run.lost) for run in store.runs()] == [{"/n": 3}]
        assert [(info.count, info.lost) for info in store.info()] == [(5, 3)]
        assert store.getTopic("/n").countTopicData(run="killed") == 5


def test_a_run_in_which_nothing_comes_is_alive(rosCas, cql, keyspace, monkeypatch):
    monkeypatch.setattr("cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 0.05)
    registry = rosCas.catalog.keyspace.registry
    registry.put_heartbeat(8, "husky")  # the bare driver cannot read a table while it is made
    signs = f"SELECT heartbeat FROM {keyspace}.cr_context WHERE writer = 7 AND node = 'husky'"
    with begin(rosCas, 7, "quiet", count=0):
        await_true(lambda: cql.execute(signs).all())  # its first sign of life
        age(cql, keyspace)
        deadline = time.monotonic() + 180
        while registry.signs()[7, "husky"].age_sec > STALE_SEC and time.monotonic() < deadline:
            time.sleep(0.05)
        assert told(rosCas) == {"quiet": ("recording", {}, True)}
    assert told(rosCas) == {"quiet": ("ended", {}, False)}


def test_an_import_that_fails_and_is_made_again(rosCas):
    with pytest.raises(KeyboardInterrupt), begin(rosCas, 7, "a.bag", "import", 3):
        raise KeyboardInterrupt
    assert told(rosCas) == {"a.bag": ("interrupted", {"/n": 3}, False)}
    with begin(rosCas, 7, "a.bag", "import") as writer:
        assert told(rosCas) == {"a.bag": ("recording", {"/n": 5}, True)}
        add(writer, 5, "/m")
    assert told(rosCas) == {"a.bag": ("ended", {"/n": 5, "/m": 5}, False)}


def test_several_runs_beside_one_another(rosCas):
    with begin(rosCas, 7, "one"), begin(rosCas, 8, "two", count=3):
        assert told(rosCas) == {
            "one": ("recording", {"/n": 5}, True),
            "two": ("recording", {"/n": 3}, True),
        }
    rosCas.truncateTopic("/n")
    assert {state for state, *_ in told(rosCas).values()} == {"ended"}
    names = rosCas.addTopic("/names", msg_type="std_msgs/Int64", key_format="manual")
    third = begin(rosCas, 9, "three", count=0)
    add(third, 4, names.name)
    assert told(rosCas)["three"] == ("recording", {"/names": 4}, True)
    third.close()
