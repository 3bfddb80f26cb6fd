# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Blocks put into a table one by one, so that a test says what lies in each."""

from __future__ import annotations

import zlib

from std_msgs.msg import String

from cassandra_ros.keys import writer_of
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.blocks.codec import pack_block
from cassandra_ros.store.tables.directory import BucketTotals, slot_of
from cassandra_ros.store.tables.row_table import bind, encode_int, encode_long

SEC = 10**9
MS = 10**6
T0 = 1_500_000_000 * SEC
COLUMNS = ["_t", "_seq", "_conn", "_size", "_last", "_n", "_crc", "_gone", "_data"]


def make_table(rosCas, topic="/p", msg_class=String, **said):
    """Make the table of a topic in format packed, with a bucket_ns and a span_ns that are said."""
    definition = definition_of(msg_class)
    metadata = TopicMetadata(
        topic,
        definition.type,
        definition.md5sum,
        "packed",
        said.pop("bucket_ns", 100 * MS),
        definition=definition.text,
        span_ns=said.pop("span_ns", 20 * MS),
        **said,
    )
    table = rosCas.catalog.keyspace.new_tables.make(metadata, definition)
    with rosCas.messageWriter() as writer:
        handle = writer.connect(api_connection(topic, definition, "/x"), format="packed")
    assert handle.table is table
    return table, handle.conn


def put_block(rosCas, table, node, conn, messages, received=None, **changed):
    """Put one block: messages are (t, seq, wire), sorted; changed = columns with other bytes."""
    times, seqs, wires = zip(*messages)
    data = pack_block(times, seqs, wires, received)
    values = {
        "_t": encode_long(times[0]),
        "_seq": encode_long(seqs[0]),
        "_conn": encode_long(conn),
        "_size": encode_int(sum(map(len, wires))),
        "_last": encode_long(times[-1]),
        "_n": encode_int(len(wires)),
        "_crc": encode_long(zlib.crc32(data)),
        "_gone": None,
        "_data": data,
    }
    bounds, _, odd = table.format.zones(wires)
    values.update(zip(table.zone_columns, bounds))
    values.update({"_odd": b"\x01"} if odd else {})
    values = {name: raw for name, raw in values.items() if raw is not None or name == "_gone"}
    values.update(changed)
    names = ", ".join(f'"{name}"' for name in ["_node", "_bucket", *values])
    marks = ", ".join("?" * (len(values) + 2))
    statement = rosCas.cassandra.prepare(
        f"INSERT INTO {table.qualified} ({names}) VALUES ({marks})"
    )
    place = table.partition_key(node, table.bucket_of(times[0]))
    table.send(bind(statement, (*place, *values.values()))).page()


def list_blocks(rosCas, table, node, blocks, *, closed=True):
    """Note in the directory what lies in the buckets of some blocks."""
    directory, totals = rosCas.catalog.keyspace.directory, {}
    for messages in blocks:
        for t, seq, wire in messages:
            place = table.name, node, table.bucket_of(t), writer_of(seq)
            totals.setdefault(place, BucketTotals()).count(t, len(wire), False, False)
    for place, counted in totals.items():
        directory.add_node(table.name, slot_of(place[2]), node)
        directory.mark(place, 0, totals=counted, closed=closed)
