# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag check as it is typed: each kind of damage is done by hand, told, and mended."""

from __future__ import annotations

import json

import pytest
from std_msgs.msg import Float64, Int64, String, UInt8MultiArray
from topics.test_run_states import T0, add, age, begin

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.store.rows.orphans import old_us, orphans, remove_orphans
from cassandra_ros.store.tables.directory import BucketRow, BucketTotals
from cassandra_ros.store.tables.row_table import LARGE_MESSAGE_CHUNK_BYTES
from cassandra_ros.topics.upkeep.store_check import _agrees


@pytest.fixture
def store(rosCas):
    """/n by rows, /p in blocks, a large message, and one under a name; no writer is active."""
    rosCas.addTopic("/p", format="packed", msg_type="std_msgs/Int64")
    with begin(rosCas, 7, "run") as writer:
        add(writer, 5, "/p")
    rosCas.addTopic("/big").addData(
        UInt8MultiArray(data=bytes(2 * LARGE_MESSAGE_CHUNK_BYTES)), key=T0
    )
    rosCas.addTopic("/maps", key_format="manual").addData(Int64(0), key="kitchen")
    return rosCas


def damages(call, *options):
    status, out, err = call("check", "--json", *options)
    found = json.loads(out)
    assert err == "" and status == (1 if found["left"] else 0)
    return {(each["kind"], each["topic"], each["mended"]) for each in found["damages"]}


@pytest.mark.suite("test", "each kind of damage that check mends")
def test_check(store, call, cql, connect):
    status, out, err = call("check")
    assert (status, err) == (0, "")
    assert f"keyspace {store.keyspace}: 12 messages" in out and "0 damages, 0 mended" in out
    assert call("check", "-q") == (0, "", "")
    store.close()  # what it holds open is closed

    space = connect(keyspace=store.keyspace)
    tables = {topic.name: topic.tables[0] for topic in space.getAllTopics()}
    of = f"{store.keyspace}.cr_bucket"
    where = "tbl = %s AND node = 'husky' AND slot = %s AND bucket = %s"

    def place(name, n):
        bucket = tables[name].bucket_of(T0 + n * SECOND_NS)
        return tables[name].name, bucket // 4096, bucket

    # The directory: a wrong count, and a bucket that is in none.
    cql.execute(f"UPDATE {of} SET n = 7 WHERE {where} AND writer = 7", place("/n", 0))
    cql.execute(f"DELETE FROM {of} WHERE {where}", place("/n", 4))
    assert space.getTopic("/n").countTopicData(nodeID="husky") == 7 + 2
    assert damages(call, "/p", "/big") == set()
    late = f"{T0 // SECOND_NS + 4}"
    assert damages(call, "--start", late) == {("not listed", "/n", False)}
    found = {("count", "/n", False), ("not listed", "/n", False)}
    assert damages(call) == found == damages(call, "-e", "/[n]")
    assert damages(call, "--end", late) == found  # the bucket in which a range ends is in it
    status, out, err = call("check", "/n", "--repair")
    assert (status, err) == (0, "") and "2 damages, 2 mended" in out
    assert out.count("mended: ") == 2
    assert damages(call) == set()
    assert space.getTopic("/n").countTopicData() == 5
    assert [msg.data for _, msg in space.getTopic("/n").items()] == [*range(5)]
    cql.execute(f"DELETE FROM {store.keyspace}.cr_node WHERE tbl = %s", (tables["/n"].name,))
    assert space.getTopic("/n").countTopicData() == 0
    assert damages(call) == {("not listed", "/n", False)}
    assert damages(call, "--repair") == {("not listed", "/n", True)}
    assert [msg.data for _, msg in space.getTopic("/n").items()] == [*range(5)]

    # What cannot be read: a block, a large message, a row without a size; and under a name.
    row = space.getTopic("/p").getRow(T0)
    key = '"_node" = %s AND "_bucket" = %s AND "_t" = %s AND "_seq" = %s'
    block = ("husky", tables["/p"].bucket_of(T0), T0, row.block[0].seq)
    number = f'UPDATE {tables["/p"].qualified} SET "_n" = %s WHERE {key}'
    cql.execute(number, (0, *block))
    assert damages(call, "/p") == {("count", "/p", False)}
    cql.execute(number, (5, *block))
    cql.execute(f'UPDATE {tables["/p"].qualified} SET "_crc" = 1 WHERE {key}', block)
    big = space.getTopic("/big").getRow(T0)
    large = ("", tables["/big"].bucket_of(T0), T0, big.seq)
    chunks = f"{store.keyspace}.{tables['/big'].name}_c"
    cql.execute(f'DELETE FROM {chunks} WHERE {key} AND "_chunk" = 1', large)
    ghost = ("husky", tables["/n"].bucket_of(T0), T0, 7 << 32)
    cql.execute(f'UPDATE {tables["/n"].qualified} SET "_size" = null WHERE {key}', ghost)
    (kept,) = space.getTopic("/maps").items()
    named = key.replace("_bucket", "_key")
    name = ("", "kitchen", kept[0].t, kept[0].seq)
    cql.execute(f'UPDATE {tables["/maps"].qualified} SET "_size" = 9 WHERE {named}', name)
    bad = {("message", topic, False) for topic in ("/n", "/p", "/big", "/maps")}
    assert bad <= damages(call)
    assert bad <= damages(call, "--repair")  # nothing brings them back
    status, out, err = call("check", "/p")
    assert (status, err) == (1, "")
    assert out.startswith("damaged: message, /p, husky, 2017-07-14T02:40:00Z to ")
    assert "5 messages of topic /p of node husky" in out and "wrong checksum" in out

    # What rows refer to, and what is left of others.
    cql.execute(
        f"DELETE FROM {store.keyspace}.cr_connection WHERE tbl = %s AND conn = %s",
        (tables["/n"].name, space.getTopic("/n").getRow(T0 + SECOND_NS).conn),
    )
    (definition,) = cql.execute(f"SELECT md5sum, hash FROM {store.keyspace}.cr_definition").all()[
        :1
    ]
    text = "UPDATE {}.cr_definition SET text = 0x00 WHERE md5sum = %s AND hash = %s"
    cql.execute(text.format(store.keyspace), definition)
    cql.execute(f"DELETE FROM {tables['/big'].qualified} WHERE {key}", large)
    past = "USING TIMESTAMP 1500000000000000"
    orphan = f'INSERT INTO {chunks} ("_node", "_bucket", "_t", "_seq", "_chunk", "_data") VALUES '
    cql.execute(f"{orphan} ('', 1, 2, 3, 0, 0x00) {past}")
    cql.execute(f"INSERT INTO {store.keyspace}.cr_node (tbl, slot, node) VALUES ('t_gone', 0, '')")
    found = {kind for kind, *_ in damages(call)}
    assert {"connection", "definition", "orphan", "leftover"} <= found
    assert ("orphan", "/big", True) in damages(call, "--repair")
    left = {kind for kind, *_ in damages(call)}
    assert left == {"message", "connection", "definition"}
    # Pieces that may still get their message stay, and what an import that is repeated brings anew.
    cql.execute(f"{orphan} ('', 1, 4, 5, 0, 0x00) {past}")
    until_us = old_us(space.cassandra)
    lost = orphans(space.cassandra, space.keyspace, tables["/big"], until_us)
    assert [tuple(each) for each in lost] == [("", 1, 4, 5)]
    cql.execute(f"{orphan} ('', 1, 4, 5, 0, 0x01)")
    remove_orphans(space.cassandra, tables["/big"], lost, until_us)
    (piece,) = cql.execute(f'SELECT "_data" FROM {chunks} WHERE {key}', ("", 1, 4, 5))
    assert piece == (b"\x01",)
    # A topic that cannot be read at all does not hide the others.
    comment = tables["/n"].metadata.with_(definition="no definition").to_comment()
    cql.execute(f"ALTER TABLE {tables['/n'].qualified} WITH comment = '{comment}'")
    assert ("definition", "/n", False) in damages(call, "/n")
    assert {("definition", "/n", False), ("message", "/p", False)} <= damages(call)
    # Nor is what it needs deleted if its comment is not even readable.
    before = space.getTopic("/p").tables[0]
    worse = before.metadata.to_comment().replace('"bucket_ns": ', '"bucket_ns": -')
    cql.execute(f"ALTER TABLE {before.qualified} WITH comment = '{worse}'")
    status, out, _ = call("check", "--repair")
    assert status == 1
    assert f"the comment of table {before.name} was changed by hand" in out
    cql.execute(f"ALTER TABLE {before.qualified} WITH comment = '{before.metadata.to_comment()}'")
    headers = cql.execute(
        f"SELECT count(*) FROM {store.keyspace}.cr_connection WHERE tbl = %s ALLOW FILTERING",
        (before.name,),
    )
    assert headers.one()[0] == 1
    space.close()


def test_what_is_being_written_is_no_damage(rosCas, call, cql, monkeypatch):
    # Its buckets stay open, however long the check takes: a writer closes idle ones by itself.
    monkeypatch.setattr("cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 1e9)
    with begin(rosCas, 7, "live", count=3) as writer:
        status, out, err = call("check")
        assert (status, err) == (0, "") and "the counts of 2 buckets could not be compared" in out
        writer.flush()
        age(cql, rosCas.keyspace)  # the recorder died
        status, out, _ = call("check", "--repair")
        assert status == 0 and "compared" not in out
        states = cql.execute(f"SELECT state FROM {rosCas.keyspace}.cr_bucket").all()
        assert {state for (state,) in states} == {"closed"}


@pytest.mark.suite("all", "make test asks others of its kind")
def test_what_is_removed_meanwhile_is_no_damage(rosCas, connect):
    large = UInt8MultiArray(data=bytes(2 * LARGE_MESSAGE_CHUNK_BYTES))
    for name, fmt in (("/blocks", "packed"), ("/rows", "ros")):
        topic = rosCas.addTopic(name, format=fmt)
        for n in range(3):
            topic.addData(large, key=T0 + n)
        read = []

        def delete(done, total, topic=topic, read=read):
            read.append(done)
            assert topic.removeData(T0, T0 + 2) == (3 if len(read) == 1 else 0)

        report = rosCas.upkeep.check([name], progress=delete)
        assert read and (report.damages, report.messages) == ([], 1)

    def remove(done, total):
        with connect(keyspace=rosCas.keyspace) as other:
            other.removeTopic("/x")

    rosCas.addTopic("/x").addData(Int64(1), key=T0)
    assert rosCas.upkeep.check(["/x"], progress=remove).damages == []


@pytest.mark.suite("all", "make test asks others of its kind")
def test_what_a_conversion_leaves_noted_is_no_damage(store, call, monkeypatch):
    monkeypatch.setattr("cassandra_ros.store.tables.replacement.SETTLE_SEC", 0.05)
    for target in ("packed", "yaml", "packed"):
        store.convertTopic("/n", target)
        assert damages(call) == set()
    assert call("check", "-q") == (0, "", "")


BOUNDS = {
    "a maximum": ('"_max.data"', 2),
    "a minimum": ('"_min.data"', 3),
    "no maximum": ('"_max.data"', None),
    "a NaN": ('"_nan"', {"data"}),
}


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("what", BOUNDS)
def test_bounds_of_a_block_are_measured_again(store, call, cql, what):
    column, value = BOUNDS[what]
    (table,) = store.getTopic("/p").tables
    row = store.getTopic("/p").getRow(T0)
    assert damages(call) == set()
    cql.execute(
        f'UPDATE {table.qualified} SET {column} = %s WHERE "_node" = %s AND "_bucket" = %s '
        'AND "_t" = %s AND "_seq" = %s',
        (value, "husky", table.bucket_of(T0), T0, row.block[0].seq),
    )
    assert damages(call) == {("bounds", "/p", False)}
    status, out, _ = call("check", "/p")
    assert status == 1 and column.strip('"') in out and "of a block of 5 messages" in out


def test_bounds_of_any_values_agree_with_what_was_stored(rosCas, call):
    numbers = [0.0, -0.0, float("nan"), float("inf"), -1e300, 5e-324]
    topic = rosCas.addTopic("/f", format="packed", msg_type="std_msgs/Float64")
    for n, number in enumerate(numbers):
        topic.addData(Float64(number), key=T0 + n)
    big = rosCas.addTopic("/big", format="packed", msg_type="std_msgs/UInt8MultiArray")
    big.addData(UInt8MultiArray(data=bytes(2 * LARGE_MESSAGE_CHUNK_BYTES)), key=T0)
    texts = rosCas.addTopic("/s", format="packed", msg_type="std_msgs/String")
    for n, text in enumerate(["", "x" * 200, "\U0010ffff" * 40, "grün"]):
        texts.addData(String(text), key=T0 + n)
    topic.removeData(T0 + 1)
    assert damages(call) == set()


def test_messages_without_a_checksum_are_counted(store, call):
    out = call("check")[1]
    # 5 of /n and the one under a name; /p has blocks, the large one pieces.
    assert "6 messages lie in rows without a checksum" in out
    assert json.loads(call("check", "--json")[1])["unsummed"] == 6


LISTED = {"rows": 5, "bytes": 40, "largest": 8, "t_min": 100, "t_max": 200, "odd": 1}


@pytest.mark.parametrize(
    ("changed", "agrees"),
    [
        ({}, True),
        ({"rows": 4}, False),
        ({"bytes": 41}, False),
        ({"t_min": 99}, False),
        ({"t_max": 201}, False),
        ({"odd": 2}, True),  # readers look at more
        ({"odd": 0}, False),
        ({"rows": 0, "bytes": 0, "t_min": 0, "t_max": 0, "odd": 0}, False),
    ],
)
def test_each_number_of_the_directory_is_compared(changed, agrees):
    row = BucketRow("r", 1, 7, True, None, age_sec=0.0, **{**LISTED, **changed})
    assert _agrees(row, BucketTotals(**LISTED)) == agrees


def test_an_empty_bucket_is_never_a_damage():
    row = BucketRow("r", 1, 7, True, None, 0, 0, 8, 5, 6, 0, age_sec=0.0)
    assert _agrees(row, BucketTotals())


def test_pieces_beside_a_row_that_has_none_are_orphans(store, cql):
    """The row holds the whole message; the writer that stored it in pieces died."""
    row = store.getTopic("/n").getRow(T0)
    large = store.getTopic("/big").getRow(T0)
    (table,) = store.getTopic("/big").tables
    store.getTopic("/big").addData(UInt8MultiArray(data=b"x"), key=T0 + 1)
    small = store.getTopic("/big").getRow(T0 + 1)
    assert (row.chunked, large.chunked, small.chunked) == (False, True, False)
    place = ("", table.bucket_of(small.t), small.t, small.seq)
    cql.execute(
        f'INSERT INTO {store.keyspace}.{table.name}_c ("_node", "_bucket", "_t", "_seq", "_chunk", '
        '"_data") VALUES (%s, %s, %s, %s, 0, 0x00) USING TIMESTAMP 1500000000000000',
        place,
    )
    lost = orphans(store.catalog.keyspace.cassandra, store.keyspace, table, 2**62)
    assert [tuple(each) for each in lost] == [place]
