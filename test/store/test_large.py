# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages of 1 byte to 200 MB: their chunks, no orphans, never a torn one."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from cassandra.cluster import Cluster, ResponseFuture
from cassandra.query import BatchStatement, SimpleStatement
from nodes.children import await_true
from std_msgs.msg import UInt8MultiArray

from cassandra_ros import RosCassandra
from cassandra_ros.errors import CorruptMessage, MessageNotFound
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.local_server import LocalCluster, free_port
from cassandra_ros.local_server.cluster_settings import OWN_HEAP_MB
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.connection.requests import MAX_SENT_BYTES, Flight
from cassandra_ros.store.rows.writer import BATCHED_LARGE_BYTES
from cassandra_ros.store.tables.row_table import LARGE_MESSAGE_CHUNK_BYTES

ROOT = Path(__file__).resolve().parents[2]
SEC = 10**9
T0 = 1_500_000_000 * SEC
FRAME_BYTES = len(serialize(UInt8MultiArray()))
MB = 10**6

SIZES = [
    *(FRAME_BYTES, FRAME_BYTES + 1, FRAME_BYTES + 2),
    *(64 * 1024 - 1, 64 * 1024, 64 * 1024 + 1),
    *(LARGE_MESSAGE_CHUNK_BYTES - 1, LARGE_MESSAGE_CHUNK_BYTES, LARGE_MESSAGE_CHUNK_BYTES + 1),
    *(2 * LARGE_MESSAGE_CHUNK_BYTES, 8 * LARGE_MESSAGE_CHUNK_BYTES + 1, 5 * MB),
]


def messageOf(size):
    """Make a message of this serialised size, bytes; no two of its chunks are equal."""
    message = UInt8MultiArray(data=os.urandom(size - FRAME_BYTES))
    message.layout.data_offset = 7
    return message


def connect(writer):
    return writer.connect(api_connection("/big", definition_of(UInt8MultiArray), "/x"))


def chunksOf(cql, rosCas):
    """Count the chunks of each message as the bare driver sees them: (t, seq) → chunks."""
    (table,) = rosCas.getTopic("/big").tables
    found = {}
    for t, seq in cql.execute(f'SELECT "_t", "_seq" FROM {rosCas.keyspace}."{table.name}_c"'):
        found[t, seq] = found.get((t, seq), 0) + 1
    return found


@pytest.mark.parametrize("large", [True, False])
def test_their_table_is_made_before_they_come_where_they_are_foreseen(
    rosCas, connect, monkeypatch, large
):
    connection, made = api_connection("/big", definition_of(UInt8MultiArray), "/x"), []
    change = Cassandra.change_schema
    monkeypatch.setattr(
        Cassandra, "change_schema", lambda self, cql: made.extend(cql) or change(self, cql)
    )
    with rosCas.messageWriter(format="binary") as writer:
        handle = writer.connect(connection, large=large)
        assert len(made) == 1 + large
        writer.write(handle, T0, 0, serialize(messageOf(FRAME_BYTES)))
        writer.flush()
        assert len(made) == 1 + large  # nothing for messages that fit into rows
        writer.write(handle, T0 + 1, 1, serialize(messageOf(MB)))
    assert len(made) == 2
    with connect(keyspace=rosCas.keyspace) as other, other.messageWriter() as writer:
        writer.write(writer.connect(connection, large=large), T0 + 2, 2, serialize(messageOf(MB)))
    assert len(made) == 2
    assert [row.size for row in rosCas.getTopic("/big").rows()] == [FRAME_BYTES, MB, MB]


@pytest.mark.parametrize("format_name", ["binary", "ros"])
def test_every_size_comes_back(rosCas, cql, format_name):
    messages = [messageOf(size) for size in SIZES]
    with rosCas.messageWriter(format=format_name) as writer:
        handle = connect(writer)
        rows = [writer.write(handle, T0 + n, n, serialize(m)) for n, m in enumerate(messages)]
    topic = rosCas.getTopic("/big")
    assert [topic.getData(T0 + n) for n in range(len(SIZES))] == messages
    assert [row.size for row in topic.rows()] == SIZES
    assert rosCas.info()[0].bytes == sum(SIZES)
    assert chunksOf(cql, rosCas) == {
        (T0 + n, rows[n].seq): -(-size // LARGE_MESSAGE_CHUNK_BYTES)
        for n, size in enumerate(SIZES)
        if size > LARGE_MESSAGE_CHUNK_BYTES
    }
    # Their scalar columns are filled even where the bytes lie elsewhere.
    offsets = rosCas.executeCQL("select layout.data_offset from /big")
    assert offsets == [(7,)] * len(SIZES)


@pytest.mark.parametrize(("format_name", "small"), [("binary", 100), ("ros", 100), ("packed", 0)])
def test_rows_of_large_messages_share_a_request(rosCas, monkeypatch, format_name, small):
    """And with small ones; those alone say how large a row may be."""
    sizes = [LARGE_MESSAGE_CHUNK_BYTES + 1, small or LARGE_MESSAGE_CHUNK_BYTES + 2] * 6
    messages, batches, submit = [messageOf(size) for size in sizes], [], Flight.submit

    def counting(flight, statement, *rest):
        if isinstance(statement, BatchStatement):
            batches.append(statement)
        submit(flight, statement, *rest)

    with rosCas.messageWriter(format=format_name, linger_sec=3600) as writer:
        handle = connect(writer)
        monkeypatch.setattr(Flight, "submit", counting)
        for n, message in enumerate(messages):
            writer.write(handle, T0 + n, n, serialize(message))
        writer._rows._flight.wait()
        # What no row tells of yet is kept, and counts as waiting.
        await_true(lambda: batches or writer.pending_bytes >= sum(sizes))
    assert len(batches) == 1
    topic = rosCas.getTopic("/big")
    assert [message for _, message in topic.items()] == messages
    (table,) = topic.tables
    (told,) = rosCas.catalog.keyspace.directory.find(table.name, "", table.bucket_of(T0))
    assert (told.rows, told.bytes, told.largest) == (12, sum(sizes), small)


def test_rows_of_large_messages_do_not_wait_for_ever(rosCas):
    messages = [
        messageOf(LARGE_MESSAGE_CHUNK_BYTES + 1)
        for _ in range(2 * BATCHED_LARGE_BYTES // LARGE_MESSAGE_CHUNK_BYTES)
    ]
    with rosCas.messageWriter(format="binary", linger_sec=3600) as writer:
        handle, topic = connect(writer), rosCas.getTopic("/big")
        for n, message in enumerate(messages):
            writer.write(handle, T0 + n, n, serialize(message))
            assert (
                writer.pending_bytes
                <= BATCHED_LARGE_BYTES + MAX_SENT_BYTES + 2 * LARGE_MESSAGE_CHUNK_BYTES
            )
        await_true(
            lambda: topic.countTopicData() >= BATCHED_LARGE_BYTES // LARGE_MESSAGE_CHUNK_BYTES
        )
        writer._rows._linger_sec = 0.0
        await_true(lambda: topic.countTopicData() == len(messages))


def test_deletes_leave_no_orphan(rosCas, cql):
    topic = rosCas.addTopic("/big", "binary")
    keys = [
        topic.addData(messageOf(LARGE_MESSAGE_CHUNK_BYTES + 1), key=T0 + n * 300 * SEC)
        for n in range(6)
    ]
    topic.addData(messageOf(100), key=T0 + SEC)
    assert len(chunksOf(cql, rosCas)) == 6
    topic.removeData(keys[0])
    assert sorted(t for t, _ in chunksOf(cql, rosCas)) == [key.ns for key in keys[1:]]
    topic.removeData(keys[5].ns)
    assert topic.removeData(T0, keys[3]) == 4
    assert sorted(t for t, _ in chunksOf(cql, rosCas)) == [keys[4].ns]
    assert [key for key, _ in topic.items()] == [keys[4]]
    assert topic.countTopicData() == rosCas.info()[0].count == 1
    topic.removeData(0, keys[4])
    assert chunksOf(cql, rosCas) == {}


HALF_WRITTEN = """
import os, signal, sys
from cassandra_ros import RosCassandra
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.connection.requests import Flight
from cassandra_ros.store.rows.writer import RowWriter
from std_msgs.msg import UInt8MultiArray

host, port, keyspace, where = sys.argv[1:]
rosCas = RosCassandra(host, int(port), keyspace=keyspace)
writer = rosCas.messageWriter(writer_id=77)
handle = writer.connect(api_connection("/big", definition_of(UInt8MultiArray), "/x"))
wires = [serialize(UInt8MultiArray(data=bytes([n]) * 3_000_000)) for n in range(2)]
writer.write(handle, 10**18, 0, wires[0])
writer.flush()
if where == "before the row":
    RowWriter._commit = lambda self: None
else:
    submit, chunks = Flight.submit, []
    def third(flight, statement, *rest):
        chunks.append(statement)
        if len(chunks) == 3:
            flight.wait()
            os.kill(os.getpid(), signal.SIGKILL)
        submit(flight, statement, *rest)
    Flight.submit = third
writer.write(handle, 10**18 + 1, 1, wires[1])
writer._rows._flight.wait()
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.parametrize(("where", "chunks"), [("before the row", 6), ("between chunks", 2)])
@pytest.mark.fault
def test_a_writer_that_is_killed_leaves_no_torn_message(
    rosCas, cassandra, keyspace, cql, where, chunks
):
    child = subprocess.run(
        [sys.executable, "-c", HALF_WRITTEN, cassandra.host, str(cassandra.port), keyspace, where],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        timeout=300,
    )
    assert child.returncode == -signal.SIGKILL
    topic = rosCas.getTopic("/big")
    whole, torn = 10**18, 10**18 + 1
    assert sorted(chunksOf(cql, rosCas).values()) == sorted([6, chunks])
    assert [key.ns for key, _ in topic.items()] == [whole]
    assert [key.ns for key, _ in topic.items(reverse=True)] == [whole]
    assert topic.countTopicData() == rosCas.info()[0].count == 1
    assert topic.getData(torn, default=None) is None
    assert topic.getData(torn, nearest="either").data[:1] == b"\0"
    with pytest.raises(MessageNotFound):
        topic.getData(torn)

    # The next run does the same again, as an import does that is repeated.
    with rosCas.messageWriter(writer_id=77) as writer:
        handle = connect(writer)
        for n in range(2):
            wire = serialize(UInt8MultiArray(data=bytes([n]) * 3_000_000))
            writer.write(handle, 10**18 + n, n, wire)
    assert [m.data[:1] for _, m in topic.items()] == [b"\0", b"\1"]
    assert topic.getData(torn).data == b"\1" * 3_000_000
    assert topic.countTopicData() == rosCas.info()[0].count == 2
    assert sorted(chunksOf(cql, rosCas).values()) == [6, 6]


CHANGES = [
    ('DELETE FROM {} WHERE {} AND "_chunk" = 1', "1 of 3 chunks"),
    ('DELETE FROM {} WHERE {} AND "_chunk" = 2', "2 of 3 chunks"),
    ("DELETE FROM {} WHERE {}", "0 of 3 chunks"),
    ('UPDATE {} SET "_data" = 0x00 WHERE {} AND "_chunk" = 1', "3 of 3 chunks, .* bytes"),
    ('UPDATE {} SET "_data" = $ WHERE {} AND "_chunk" = 1', "wrong checksum"),
]


def test_what_was_changed_is_corrupt_and_the_others_are_not(rosCas, cql):
    topic = rosCas.addTopic("/big", "binary")
    count = len(CHANGES) + 2
    keys = [
        topic.addData(messageOf(2 * LARGE_MESSAGE_CHUNK_BYTES + 9), key=T0 + n)
        for n in range(count)
    ]
    table = topic.tables[0]
    chunk_table = f'{rosCas.keyspace}."{table.name}_c"'

    def change(n, statement):
        where = (
            f'"_node" = \'\' AND "_bucket" = {table.bucket_of(T0 + n)} AND "_t" = {T0 + n} '
            f'AND "_seq" = {keys[n].seq}'
        )
        if "$" in statement:
            rows = cql.execute(f'SELECT "_data" FROM {chunk_table} WHERE {where} AND "_chunk" = 1')
            data = bytearray(rows.one()[0])
            data[5000] ^= 1
            statement = statement.replace("$", "0x" + data.hex())
        cql.execute(statement.format(chunk_table, where))

    for n, (statement, _) in enumerate(CHANGES):
        change(n, statement)
    change(count - 2, 'UPDATE {} SET "_data" = 0x00 WHERE {} AND "_chunk" = 3')  # one too many
    for n, (_, words) in enumerate(CHANGES):
        with pytest.raises(CorruptMessage, match=f"/big at {T0 + n} .*{words}"):
            topic.getData(keys[n])
    for key in keys[len(CHANGES) :]:
        assert topic.getData(key).layout.data_offset == 7
    assert topic.countTopicData() == len(list(topic.rows())) == count


HUGE = """
import hashlib, resource, sys
from cassandra_ros import RosCassandra
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from std_msgs.msg import UInt8MultiArray

host, port, keyspace, verb = sys.argv[1:]
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1000
with RosCassandra(host, int(port), keyspace=keyspace) as rosCas:
    before = peak()
    if verb == "write":
        size = 200 * 10**6
        block = hashlib.sha256(b"1").digest() * 2**15
        last = [block[: size % len(block)]]
        head = bytes(8) + size.to_bytes(4, "little")
        wire = b"".join([head] + [block] * (size // len(block)) + last)
        before = peak()
        with rosCas.messageWriter(format="binary") as writer:
            handle = writer.connect(api_connection("/big", definition_of(UInt8MultiArray), "/x"))
            writer.write(handle, 10**18, 0, wire)
    else:
        wire = rosCas.getTopic("/big").getRow(10**18).wire
    print(len(wire), hashlib.sha256(wire).hexdigest(), peak() - before)
"""


@pytest.fixture
def smallest_server(tmp_path):
    """Yield a server with the least heap that a local one takes unasked."""
    cluster = LocalCluster(tmp_path, port=free_port(), heap=f"{OWN_HEAP_MB[0]}M")
    try:
        cluster.start(die_with_us=True)
        yield cluster
    finally:
        cluster.stop()


@pytest.mark.suite("all", "hundreds of megabytes")
def test_200_megabytes_after_other_work(smallest_server, bags):
    (server,) = smallest_server.status()
    host, port = server.node.address, smallest_server.settings.port
    with RosCassandra(host, port, keyspace="robot") as rosCas:
        import_bag(rosCas, bags / "turtlesim_tf.bag", format="ros")
        _huge(rosCas, host, port)
    (now,) = smallest_server.status()
    assert now.pid == server.pid  # and not one that was started anew


def _chunks(rosCas, host, port):
    """Count the chunks as the bare driver sees them."""
    (table,) = rosCas.getTopic("/big").tables
    # For keys alone the server gathers the whole chunks, the driver's 5000 of them at once: 200 MB
    # in one answer end it with OutOfMemoryError.
    keys = SimpleStatement(f'SELECT "_chunk" FROM robot."{table.name}_c"', fetch_size=8)
    patience = {"connect_timeout": 180, "control_connection_timeout": 180}
    with Cluster([host], port=port, **patience) as cluster:
        return sum(1 for _ in cluster.connect().execute(keys, timeout=180))


def _huge(rosCas, host, port):
    def run(verb):
        child = subprocess.run(
            [sys.executable, "-c", HUGE, host, str(port), rosCas.keyspace, verb],
            env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
            stdout=subprocess.PIPE,
            text=True,
            timeout=600,
            check=True,
        )
        size, digest, more = child.stdout.split()
        return (int(size), digest), int(more)

    written, more_to_write = run("write")
    assert _chunks(rosCas, host, port) == -(-written[0] // LARGE_MESSAGE_CHUNK_BYTES)
    read, more_to_read = run("read")
    assert read == written
    # Over the message itself: what is in the air; its parts once more while they are joined.
    assert more_to_write < 150, more_to_write
    assert more_to_read < 2 * 200 + 150, more_to_read
    print(f"200 MB: {more_to_write} MB more to write, {more_to_read} MB to read")


@pytest.fixture
def no_collector():
    """Python's cyclic collector is off: what it alone would free stays."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def requests_held(before=()):
    """Return the requests that are answered and still in memory, without those of before."""
    # isinstance would ask a weak proxy whose object is gone.
    held = (request for request in gc.get_objects() if type(request) is ResponseFuture)
    earlier = set(map(id, before))
    return [each for each in held if each._event.is_set() and id(each) not in earlier]


@pytest.mark.suite("all", "large messages, to see how much memory they take")
def test_an_answered_request_does_not_stay_in_memory(rosCas, no_collector):
    """A recorder of images grew by the MB until the collector came round, minutes later."""
    # Those of an earlier test's client that was not closed stay as long as it does.
    before = requests_held()
    with rosCas.messageWriter(format="binary") as writer:
        handle = connect(writer)
        for number in range(10):
            writer.write(handle, T0 + number, number, serialize(messageOf(MB)))
        writer.flush()
        await_true(lambda: not requests_held(before))
    assert sum(row.size for row in rosCas.getTopic("/big").rows()) == 10 * MB
    await_true(lambda: not requests_held(before))
