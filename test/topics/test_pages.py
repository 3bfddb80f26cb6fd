# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows of an answer that are read together are those that are read one by one."""

from __future__ import annotations

import io
import random

import pytest
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from cassandra_ros import Stamp
from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.store.connection.protocol import RawPage

T = 1_400_000_000_123_456_789


def transforms(rng):
    """A tf message: of few layouts, of equal size in wire bytes or in rows, or odd."""
    frames = rng.choice([("a", "b"), ("map", "odom"), ("x" * 30, "y" * 31), ("ä", "é")])
    message = TFMessage()
    for _ in range(rng.choice((0, 1, 1, 1, 2))):
        part = TransformStamped(child_frame_id=frames[1])
        part.header.frame_id, part.header.stamp.secs = frames[0], rng.randrange(2**32)
        part.transform.rotation.w = rng.random()
        message.transforms.append(part)
    wire = bytearray(serialize(message))
    if rng.random() < 0.02 and len(wire) > 20:
        wire[12:16] = b"\xff" * 4  # nsecs
    return bytes(wire)


def headers(rng):
    frame = rng.choice(("", "a", "x" * rng.randrange(300), "é"))
    wire = bytearray(serialize(Header(rng.randrange(2**32), None, frame)))
    if rng.random() < 0.02:
        wire += b"surplus"
    return bytes(wire)


def store(rosCas, topic, cls, wires, fmt, **options):
    header = {"type": cls._type, "md5sum": cls._md5sum, "topic": topic}
    header["message_definition"] = cls._full_text
    if options:
        rosCas.addTopic(topic, format=fmt, msg_type=cls._type, **options)
    with rosCas.messageWriter(format=fmt) as writer:
        handle = writer.connect(live_connection(topic, header))
        for n, wire in enumerate(wires):
            writer.write(handle, T + n, n, wire)
    return rosCas.getTopic(topic)


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("fmt", ["ros", "binary"])
@pytest.mark.parametrize("make", [transforms, headers])
def test_every_message_comes_back(rosCas, fmt, make):
    rng = random.Random(fmt)
    wires = [make(rng) for _ in range(2000)]
    wires[500:900] = wires[500:501] * 400  # all of a page are alike, but for one
    wires[700] = make(rng)
    topic = store(rosCas, "/t", TFMessage if make is transforms else Header, wires, fmt)
    rows = list(topic.rows())
    assert [row.wire for row in rows] == wires
    assert [row.t for row in rows] == list(range(T, T + len(wires)))
    assert [row.wire for row in topic.rows(reverse=True)] == wires[::-1]
    some = topic.rows(Stamp.from_ns(T + 300), Stamp.from_ns(T + 1700))
    assert [row.wire for row in some] == wires[300:1701]
    # As columns, one by one.
    assert [topic.getRow(row.key).wire for row in rows[::100]] == wires[::100]
    together = sum(not row.columns for row in rows)
    assert together > (1500 if fmt == "binary" or make is headers else 300)


def test_a_key_in_the_message_leaves_the_time_of_reception(rosCas):
    rng = random.Random(1)
    wires = [headers(rng) for _ in range(300)]
    key = {"key_format": "msg_part", "key_part": "stamp"}
    topic = store(rosCas, "/t", Header, wires, "ros", **key)
    rows = sorted(topic.rows(), key=lambda row: row.received)
    assert [(row.received - T, row.wire) for row in rows] == list(enumerate(wires))
    assert any(not row.columns for row in rows)


def test_what_somebody_else_changed_is_not_taken_for_a_message(rosCas, cql):
    rng = random.Random(1)
    wires = [serialize(Header(n, None, "frame")) for n in range(200)]
    topic = store(rosCas, "/t", Header, wires, "ros")
    row = next(iter(topic.rows(Stamp.from_ns(T + rng.randrange(200)), limit=1)))
    table, n = topic.tables[0], row.t - T
    where = f'"_node" = \'\' AND "_bucket" = {table.bucket_of(row.t)}'
    where += f' AND "_t" = {row.t} AND "_seq" = {row.seq}'
    cql.execute(f"UPDATE {table.qualified} SET frame_id = 'other' WHERE {where}")
    found = list(topic.rows())
    for at, (one, wire) in enumerate(zip(found, wires)):
        if at != n:
            assert one.wire == wire
    cql.execute(f"UPDATE {table.qualified} SET frame_id = 'longer' WHERE {where}")
    found = list(topic.rows())
    assert [one.wire for at, one in enumerate(found) if at != n] == wires[:n] + wires[n + 1 :]
    with pytest.raises(Exception, match="instead of"):
        _ = found[n].wire


def test_rows_before_one_that_somebody_else_made_are_given(rosCas, cql):
    wires = [serialize(Header(n, None, "frame")) for n in range(200)]
    topic = store(rosCas, "/t", Header, wires, "ros")
    table = topic.tables[0]
    names = f'INSERT INTO {table.qualified} ("_node", "_bucket", "_t", "_seq", frame_id)'
    cql.execute(f"{names} VALUES ('', {table.bucket_of(T)}, {T + 150}, 0, 'other')")
    rows, found = topic.rows(), []
    with pytest.raises(CorruptMessage, match="something else"):
        while True:
            found.append(next(rows).wire)
    assert found == wires[:150]


def page_of(rows):
    """A page of rows of two columns: 8 bytes, and one of any size."""
    body = io.BytesIO()
    body.write(b"head" + len(rows).to_bytes(4, "big"))
    for row in rows:
        for value in row:
            body.write((-1 if value is None else len(value)).to_bytes(4, "big", signed=True))
            body.write(value or b"")
    return RawPage(body.getvalue(), 4, 2, lambda: rows)


def test_a_page_knows_where_rows_lie():
    rows = [(b"aaaa", b"123"), (b"bbbb", b""), (b"aaaa", b"345"), (b"aaaa", b"6"), (b"aaaa", b"")]
    page = page_of(rows)
    starts, ends = page.bounds(4, b"\0\0\0\x04")
    assert [page.row(int(at)) for at in starts] == rows
    assert [page.end(int(at)) for at in starts] == ends.tolist()
    assert len(page) == 5 and page[-1] == rows[-1] and page[1:] == rows[1:]
    assert list(page) == rows
    # What looks like a row, but is the end of one.
    rows = [(b"aaaa", b""), (b"aaaa", b"\0\0\0\x04aaaa\0\0\0\0"), (b"aaaa", b"")]
    bounds = page_of(rows).bounds(4, b"\0\0\0\x04")
    assert bounds is None or len(bounds[0]) == 3
    assert page_of([]).bounds(4, b"") is None
