# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Shadow columns: made and dropped step by step, filled without ghosts, gone with their rows."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
from std_msgs.msg import Float64, String
from topics.by_index import await_built

from cassandra_ros import RosCassandra
from cassandra_ros.arguments import MAX_TTL_SEC, check_ttl
from cassandra_ros.errors import InvalidOption, SchemaConflict, StoreUnavailable, TopicNotFound
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.store.rows.backfill import Backfill, ShadowUpdate
from cassandra_ros.store.tables import index_builds
from cassandra_ros.store.tables import schema as schema_module
from cassandra_ros.store.tables.directory import BucketTotals
from cassandra_ros.store.tables.side_tables import SchemaLock

SEC = 10**9
T0 = 1_500_000_000 * SEC


def store(rosCas, name, count, cls=String, **options):
    """Store texts '0', '1', … in one bucket, as a recording that has ended; return the table."""
    with rosCas.messageWriter(**options) as writer:
        handle = writer.connect(
            api_connection(name, definition_of(cls), "/w"), bucket_ns=3600 * SEC
        )
        for number in range(count):
            message = cls(str(number) if cls is String else float(number))
            writer.write(handle, T0 + number, number, serialize(message))
    return handle.table


def add(rosCas, table, cql_type="text", field="data"):
    """Make an index without filling it; return its column."""
    rosCas.catalog.keyspace.indexes.add_index(
        table.metadata.topic, field, lambda metadata: cql_type
    )
    return rosCas.catalog.keyspace.tables.by_name(table.name).metadata.indexes[field]


def select(cql, table, what):
    return [tuple(row) for row in cql.execute(f"SELECT {what} FROM {table.qualified}")]


def index_names(cql, rosCas, table):
    rows = cql.execute(
        "SELECT index_name FROM system_schema.indexes WHERE keyspace_name = %s AND table_name = %s",
        (rosCas.keyspace, table.name),
    )
    return {row[0][len(table.name) :] for row in rows}


def test_a_row_deleted_between_read_and_write_stays_deleted(rosCas, cql):
    table = store(rosCas, "/t", 20)
    backfill = Backfill(table, add(rosCas, table))
    (page,) = backfill.pages("", table.bucket_of(T0), 10)
    assert rosCas.getTopic("/t").removeData(T0 + 3, T0 + 9) == 7
    backfill.write(
        [ShadowUpdate(written, None if n % 5 == 4 else b"v") for n, written in enumerate(page)]
    )
    rows = select(cql, table, '"_t", "_conn", "_ix0", "_odd"')
    assert [t - T0 for t, *_ in rows] == [0, 1, 2, *range(10, 20)]
    assert all(conn is not None for _, conn, *_ in rows)
    assert [value for *_, value, _ in rows].count("v") == 11
    assert [t - T0 for t, *_, odd in rows if odd] == [14, 19]
    assert len(list(rosCas.getTopic("/t").rows())) == 13


def test_a_row_written_anew_keeps_its_new_value(rosCas, cql):
    table = store(rosCas, "/t", 2, writer_id=9)
    shadow = add(rosCas, table)
    backfill = Backfill(table, shadow)
    (page,) = backfill.pages("", table.bucket_of(T0), 10)
    cql.execute(
        f'UPDATE {table.qualified} SET "_ix0" = \'newer\' WHERE "_node" = \'\' AND "_bucket" = %s '
        'AND "_t" = %s AND "_seq" = %s',
        (table.bucket_of(T0), T0, page[0].row.seq),
    )
    backfill.write([ShadowUpdate(written, b"older") for written in page])
    assert select(cql, table, '"_ix0"') == [("newer",), ("older",)]


def test_pages_are_small_where_messages_are_large(rosCas):
    table = store(rosCas, "/t", 2500)
    backfill = Backfill(table, add(rosCas, table))
    for largest, most in ((10, 1000), (2 * 1024 * 1024 // 7, 6), (10**8, 1)):
        pages = backfill.pages("", table.bucket_of(T0), largest)
        sizes = [len(page) for _, page in zip(range(4), pages)]
        assert max(sizes) == sizes[0] == most
    every = [w.row.seq for page in backfill.pages("", table.bucket_of(T0), 10) for w in page]
    assert len(every) == len(set(every)) == 2500


def test_a_value_stays_as_long_as_its_row(rosCas, cql):
    table = store(rosCas, "/t", 10, ttl=1000)
    assert rosCas.getTopic("/t").createIndex("data") == 10
    left = select(cql, table, 'TTL("_conn"), TTL("_ix0")')
    assert len(left) == 10 and all(900 < row <= mine <= row + 60 for row, mine in left)
    rows = cql.execute(f"SELECT TTL(filled), TTL(odd) FROM {rosCas.keyspace}.cr_bucket")
    assert all(900 < value <= 1900 for row in rows for value in row)


@pytest.mark.suite("all", "it waits for seconds")
def test_what_is_left_of_a_row_when_it_expires_is_no_row(rosCas, cql):
    # The rows must live until the index is there, and then soon expire.
    for ttl in (5, 20, 80):
        topic_name = f"/t{ttl}"
        table = store(rosCas, topic_name, 20, ttl=ttl)
        backfill = Backfill(table, add(rosCas, table))
        pages = list(backfill.pages("", table.bucket_of(T0), 10))
        for page in pages:
            # As if the server had been slow: the values stay much longer.
            backfill.write([ShadowUpdate(written._replace(ttl=600), b"v") for written in page])
        if sum(map(len, pages)) == 20:
            break
    topic = rosCas.getTopic(topic_name)
    deadline = time.monotonic() + 300
    while any(conn is not None for (conn,) in select(cql, table, '"_conn"')):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    assert len(select(cql, table, '"_conn"')) == 20  # there they are
    assert list(topic.rows()) == list(topic.rows(reverse=True)) == []
    assert topic.getData(T0, default=None) is None and topic.first() is None
    assert topic.countTopicData(T0, T0 + 3) == 0
    assert [page for page in backfill.pages("", table.bucket_of(T0), 10) if page] == []


def test_arrays_leave_out_what_is_left_of_rows_that_have_expired(rosCas, cql):
    table = store(rosCas, "/t", 200, ttl=1000)
    topic = rosCas.getTopic("/t")
    topic.createIndex("data")
    found = cql.execute(
        "SELECT column_name, kind FROM system_schema.columns "
        "WHERE keyspace_name = %s AND table_name = %s",
        (rosCas.keyspace, table.name),
    )
    kinds = dict(map(tuple, found))
    expired = [f'"{n}"' for n, kind in kinds.items() if kind == "regular" and n != "_ix0"]
    keys = [f'"{n}"' for n, kind in kinds.items() if kind in ("partition_key", "clustering")]
    for row in list(cql.execute(f"SELECT {', '.join(keys)} FROM {table.qualified}"))[::7]:
        where = " AND ".join(f"{name} = %s" for name in keys)
        cql.execute(f"DELETE {', '.join(expired)} FROM {table.qualified} WHERE {where}", row)
    assert len(select(cql, table, '"_ix0"')) == 200
    wanted = [(T0 + n, str(n)) for n in range(200) if n % 7]
    found = topic.getArrays(["KEY", "data"])
    assert list(zip(found["KEY"].tolist(), found["data"].tolist())) == wanted
    columns = topic.toArrow().read_all()
    times = columns["KEY"].cast("int64").to_pylist()
    assert sorted(zip(times, columns["data"].to_pylist())) == wanted


def test_without_a_ttl_a_value_stays(rosCas, cql):
    table = store(rosCas, "/t", 5)
    rosCas.getTopic("/t").createIndex("data")
    assert select(cql, table, 'TTL("_ix0")') == [(None,)] * 5
    stamps = select(cql, table, 'WRITETIME("_conn"), WRITETIME("_ix0")')
    assert all(row == mine for row, mine in stamps)


def test_what_a_recount_says_fails_where_something_changed(rosCas):
    table = store(rosCas, "/t", 5, writer_id=7)
    directory = rosCas.catalog.keyspace.directory
    place = (table.name, "", table.bucket_of(T0), 7)
    (row,) = directory.find(*place[:3])
    assert row.closed and row.filled == frozenset()
    time.sleep(0.005)
    directory.mark(place, 0, {"_ix0"})
    wanted = row._replace(filled=frozenset({"_ix1"}))
    assert directory.put_recount(table.name, wanted, BucketTotals(), 0) is False
    (row,) = directory.find(*place[:3])
    assert not row.closed and row.filled == {"_ix0"} and row.rows == 5
    wanted = row._replace(filled=row.filled | {"_ix1"})
    totals = BucketTotals(5, 50, 10, T0, T0 + 4, 3)
    assert directory.put_recount(table.name, wanted, totals, 0) is True
    (row,) = directory.buckets_by_robot(table.name, *(table.bucket_of(T0),) * 2)
    assert row.closed and row.filled == {"_ix0", "_ix1"} and (row.rows, row.odd) == (5, 3)
    directory.mark(place, 0, (), totals, closed=True)
    assert directory.find(*place[:3])[0].filled == frozenset()


def test_rows_of_an_earlier_release_fill_nothing(rosCas, cql):
    table = store(rosCas, "/t", 5)
    directory, ends = rosCas.catalog.keyspace.directory, (table.bucket_of(T0),) * 2
    (row,) = directory.buckets_by_robot(table.name, *ends)
    cql.execute(
        f"DELETE filled FROM {rosCas.keyspace}.cr_bucket "
        "WHERE tbl = %s AND node = '' AND slot = %s AND bucket = %s AND writer = %s",
        (table.name, row.bucket // 4096, row.bucket, row.writer),
    )
    (row,) = directory.buckets_by_robot(table.name, *ends)
    assert row.filled == frozenset() and row.closed
    assert rosCas.getTopic("/t").createIndex("data") == 5


def test_a_writer_does_not_list_what_its_earlier_rows_lack(rosCas):
    table = store(rosCas, "/t", 10, writer_id=9)
    assert add(rosCas, table) == "_ix0"
    store(rosCas, "/t", 5, writer_id=9)
    store(rosCas, "/t", 5, writer_id=10)
    ends = (table.bucket_of(T0),) * 2
    rows = {
        row.writer: row.filled
        for row in rosCas.catalog.keyspace.directory.buckets_by_robot(table.name, *ends)
    }
    assert rows == {9: frozenset(), 10: {"_ix0"}}
    assert rosCas.getTopic("/t").createIndex("data") == 10


class Crash(Exception):
    pass


@pytest.mark.parametrize("step", ["create_sai_index", "set_comment"])
def test_a_crash_between_the_steps_is_completed(rosCas, cql, monkeypatch, step):
    table = store(rosCas, "/t", 5)
    topic, schema = rosCas.getTopic("/t"), rosCas.catalog.keyspace.schema

    def crash(*args):
        raise Crash

    with monkeypatch.context() as broken:
        broken.setattr(schema, step, crash)
        with pytest.raises(Crash):
            topic.createIndex("data")
    # The table works, for reading and for a new writer.
    schema.tables(fresh=True)
    assert topic.getMeta["indexes"] == []
    store(rosCas, "/t", 8, writer_id=3)
    assert topic.countTopicData() == 13
    assert topic.createIndex("data") == 13
    # The column that was left is taken: no comment had listed it.
    assert dict(topic.tables[0].metadata.indexes) == {"data": "_ix0"}
    assert index_names(cql, rosCas, table) == {"_ix0"}
    await_built(rosCas)
    found = cql.execute(f"SELECT count(*) FROM {table.qualified} WHERE \"_ix0\" = '3'").one()
    assert found[0] == 2


def compaction(cql, rosCas, table):
    query = (
        "SELECT compaction FROM system_schema.tables WHERE keyspace_name = %s AND table_name = %s"
    )
    return dict(cql.execute(query, (rosCas.keyspace, table.name)).one()[0])


def test_files_are_not_merged_while_an_index_is_made(rosCas, cql, monkeypatch):
    table = store(rosCas, "/t", 5)
    topic, schema = rosCas.getTopic("/t"), rosCas.catalog.keyspace.schema
    cql.execute(
        f"ALTER TABLE {table.qualified} WITH compaction = "
        "{'class': 'LeveledCompactionStrategy', 'sstable_size_in_mb': '10'}"
    )
    before = compaction(cql, rosCas, table)
    make, seen = schema.create_sai_index, []

    def look(*args):
        seen.append(compaction(cql, rosCas, table))
        make(*args)

    monkeypatch.setattr(schema, "create_sai_index", look)
    topic.createIndex("data")
    assert seen == [{**before, "enabled": "false"}]
    assert compaction(cql, rosCas, table) == before
    for change in (topic.createIndex, topic.removeIndex, topic.createIndex):
        # As one that died in the middle leaves it.
        pairs = ", ".join(f"'{name}': '{value}'" for name, value in seen[0].items())
        cql.execute(f"ALTER TABLE {table.qualified} WITH compaction = {{{pairs}}}")
        change("data")
        assert compaction(cql, rosCas, table) == before


def test_no_index_is_made_while_files_are_merged(rosCas, cql, monkeypatch):
    table = store(rosCas, "/t", 5)
    topic, before = rosCas.getTopic("/t"), compaction(cql, rosCas, table)
    with monkeypatch.context() as busy:
        busy.setattr(index_builds, "MERGES_END_SEC", 0.2)
        busy.setattr(
            index_builds.IndexBuilds, "tasks", lambda *args: {"node": [("compaction", 0.5)]}
        )
        with pytest.raises(StoreUnavailable, match="compaction, 50 % done"):
            topic.createIndex("data")
    assert index_names(cql, rosCas, table) == set()
    assert compaction(cql, rosCas, table) == before
    assert topic.createIndex("data") == 5


@pytest.mark.parametrize("step", ["_alter", "_await_quiet"])
def test_a_pause_that_fails_is_told(rosCas, cql, monkeypatch, caplog, step):
    table = store(rosCas, "/t", 5)
    topic, before = rosCas.getTopic("/t"), compaction(cql, rosCas, table)

    def gone(*args):
        raise StoreUnavailable("the server is gone")

    with monkeypatch.context() as broken:
        broken.setattr(index_builds.IndexBuilds, step, gone)
        with pytest.raises(StoreUnavailable, match="is gone"):
            topic.createIndex("data")
    assert len(warnings(caplog)) == 1 and index_names(cql, rosCas, table) == set()
    assert topic.createIndex("data") == 5
    assert compaction(cql, rosCas, table) == before


@pytest.fixture
def busy(monkeypatch):
    """As if each node were building another index for ever; context manager."""

    @contextmanager
    def nobody_begins():
        with monkeypatch.context() as patched:
            patched.setattr(index_builds, "BUILD_START_SEC", 0)
            patched.setattr(schema_module, "NEW_TABLE_BUILD_SEC", 0)
            patched.setattr(index_builds, "begun", lambda names, *state: not names)
            yield

    return nobody_begins


def warnings(caplog):
    return [record.getMessage() for record in caplog.records if "not merged" in record.getMessage()]


def test_an_index_that_is_not_built_yet_is_not_taken_back(rosCas, cql, busy, caplog):
    table = store(rosCas, "/t", 5)
    topic, before = rosCas.getTopic("/t"), compaction(cql, rosCas, table)
    for _ in range(2):
        with busy(), pytest.raises(StoreUnavailable, match="one after the other"):
            topic.createIndex("data")
        # To drop it would not end its build: nothing is merged before that has begun.
        assert index_names(cql, rosCas, table) == {"_ix0"} and topic.getMeta["indexes"] == []
        assert compaction(cql, rosCas, table) == {**before, "enabled": "false"}
    assert len(warnings(caplog)) == 1
    assert "createIndex or removeIndex is called for its topic" in warnings(caplog)[0]
    assert topic.createIndex("data") == 5
    assert dict(topic.tables[0].metadata.indexes) == {"data": "_ix0"}
    assert compaction(cql, rosCas, table) == before


def test_an_index_that_is_refused_leaves_nothing(rosCas, cql, monkeypatch, caplog):
    table = store(rosCas, "/t", 5)
    topic, before = rosCas.getTopic("/t"), compaction(cql, rosCas, table)

    def refuse(*args):
        raise SchemaConflict("the server refuses the statement: too many indexes")

    with monkeypatch.context() as patched:
        patched.setattr(rosCas.catalog.keyspace.schema, "create_sai_index", refuse)
        with pytest.raises(SchemaConflict, match="too many"):
            topic.createIndex("data")
    assert compaction(cql, rosCas, table) == before and not warnings(caplog)
    assert topic.createIndex("data") == 5


def test_the_first_error_is_told(rosCas, cql, monkeypatch, caplog):
    table = store(rosCas, "/t", 5)
    topic, before = rosCas.getTopic("/t"), compaction(cql, rosCas, table)

    def gone(*args, **options):
        raise StoreUnavailable("the server is gone for good")

    def first(*args):
        monkeypatch.setattr(rosCas.cassandra, "execute_once", gone)
        raise StoreUnavailable("the server is gone")

    monkeypatch.setattr(rosCas.catalog.keyspace.schema, "create_sai_index", first)
    with pytest.raises(StoreUnavailable, match="is gone$"):
        topic.createIndex("data")
    monkeypatch.undo()
    assert len(warnings(caplog)) == 1
    assert "the schema lock runs out by itself within 120 s: the server is gone" in caplog.text
    assert compaction(cql, rosCas, table) == {**before, "enabled": "false"}
    cql.execute(f"DELETE FROM {rosCas.keyspace}.cr_lock WHERE name = 'schema'")
    assert topic.createIndex("data") == 5
    assert compaction(cql, rosCas, table) == before


def test_an_interrupted_index_is_made_anew(rosCas, cql, monkeypatch, caplog):
    table = store(rosCas, "/t", 5)
    topic, before = rosCas.getTopic("/t"), compaction(cql, rosCas, table)
    make = rosCas.catalog.keyspace.schema.create_sai_index

    def interrupted(*args):
        make(*args)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(rosCas.catalog.keyspace.schema, "create_sai_index", interrupted)
        with pytest.raises(KeyboardInterrupt):
            topic.createIndex("data")
    assert len(warnings(caplog)) == 1
    assert topic.getMeta["indexes"] == []
    assert compaction(cql, rosCas, table) == {**before, "enabled": "false"}
    assert topic.createIndex("data") == 5
    assert compaction(cql, rosCas, table) == before


@pytest.mark.suite("all", "it waits for seconds")
@pytest.mark.parametrize("again", ["its own", "another", "of another type", "removed"])
def test_an_index_that_no_comment_lists_is_waited_for(rosCas, cql, busy, again):
    """Its client died after it had made the index, before it let files be merged again."""
    table = store(rosCas, "/t", 5)
    topic, before = rosCas.getTopic("/t"), compaction(cql, rosCas, table)
    topic.createIndex("data")
    with busy(), pytest.raises(StoreUnavailable):
        add(rosCas, table, "text", "other")
    ask = {
        "its own": lambda: add(rosCas, table, "text", "other"),
        "another": lambda: topic.createIndex("data"),
        "of another type": lambda: rosCas.catalog.keyspace.indexes.add_index(
            "/t", "third", lambda metadata: None
        ),
        "removed": lambda: topic.removeIndex("data"),
    }[again]
    with busy(), pytest.raises(StoreUnavailable, match="has not begun to build"):
        ask()
    rosCas.catalog.keyspace.schema.tables(fresh=True)
    assert index_names(cql, rosCas, table) == {"_ix0", "_ix1"}
    assert topic.getMeta["indexes"] == ["data"]
    assert compaction(cql, rosCas, table) == {**before, "enabled": "false"}
    ask()
    assert compaction(cql, rosCas, table) == before


def test_an_index_that_was_made_while_files_were_merged_is_made_anew(rosCas, cql, monkeypatch):
    table = store(rosCas, "/t", 5)
    topic, cassandra, sent = rosCas.getTopic("/t"), rosCas.cassandra, []
    cql.execute(f'ALTER TABLE {table.qualified} ADD "_ix0" text')
    rosCas.catalog.keyspace.schema.create_sai_index(table.name, "_ix0")
    change = cassandra.schema_change

    def look(statement, *, what):
        sent.append(statement)
        change(statement, what=what)

    monkeypatch.setattr(cassandra, "schema_change", look)
    assert topic.createIndex("data") == 5
    steps = [" ".join(statement.split()[:2]) for statement in sent]
    assert steps == ["DROP INDEX", "ALTER TABLE", "CREATE INDEX", "ALTER TABLE", "ALTER TABLE"]


BUILT, WAITING = False, True


@pytest.mark.parametrize(
    "listed, at_work, expected",
    [
        ({"a": BUILT, "b": BUILT}, False, True),
        ({"a": BUILT, "b": WAITING}, True, True),
        ({"a": BUILT, "b": WAITING}, False, False),
        # It is building the one or the other.
        ({"a": WAITING, "b": WAITING}, True, False),
        ({"a": BUILT, "b": BUILT, "of somebody else": WAITING}, False, False),
        # The node has not heard of it.
        ({"a": BUILT}, False, False),
        ({"a": WAITING}, True, False),
        ({}, True, False),
    ],
)
def test_when_a_node_has_begun(listed, at_work, expected):
    assert index_builds.begun({"a", "b"}, listed, at_work) is expected


def watch_a_build(rosCas, monkeypatch, topic, rows):
    """Make an index from a file of some rows; return what the server listed until it was built."""
    cassandra, keyspace, names, seen = rosCas.cassandra, rosCas.keyspace, set(), []
    table = store(rosCas, topic, rows)

    def look(names, listed, at_work):
        seen.append((set(names), dict(listed), at_work))
        return listed == dict.fromkeys(names, False)

    monkeypatch.setattr(index_builds, "begun", look)
    monkeypatch.setattr(index_builds, "PAUSE_SEC", 0)
    with SchemaLock(cassandra, keyspace) as lock, ThreadPoolExecutor(1) as other:
        builds = index_builds.IndexBuilds(cassandra, keyspace, table.name, lock)
        # The first writes the rows to a file, the second is built from it.
        for column in ("_conn", "_size"):
            seen.clear()
            names.add(table.name + column)
            index = f'{table.name}{column} ON {table.qualified} ("{column}")'
            # The statement ends when all agree upon the schema, perhaps after the build.
            made = other.submit(
                cassandra.schema_change, f"CREATE INDEX {index} USING 'sai'", what="making an index"
            )
            builds.await_builds(names, 600)
            made.result()
    monkeypatch.undo()
    return [look for look in seen if any(look[1].values())]


@pytest.mark.suite("all", "it waits for seconds")
def test_a_build_is_known_by_its_name(rosCas, monkeypatch):
    """What a real server lists while it builds an index of many rows."""
    # A build may end between two looks; that of more rows takes longer.
    for rows in (30_000, 60_000, 120_000, 240_000):
        waiting = watch_a_build(rosCas, monkeypatch, f"/of_{rows}", rows)
        if any(index_builds.begun(*look) for look in waiting):
            return
    pytest.fail(f"a build was never listed: {waiting[-5:]}")


def test_nobody_finds_a_table_before_its_indexes_are_made(rosCas, cql, monkeypatch):
    schema, seen = rosCas.catalog.keyspace.schema, []
    make = schema.create_sai_index

    def look(table, shadow):
        with RosCassandra(rosCas.cassandra.hosts, rosCas.cassandra.port) as other:
            other.connectToKeyspace(rosCas.keyspace)
            seen.append(list(other.getAllTopics()))
        seen.append(compaction(cql, rosCas, SimpleNamespace(name=table))["enabled"])
        make(table, shadow)

    monkeypatch.setattr(schema, "create_sai_index", look)
    # Another test may let the server build a large one.
    monkeypatch.setattr(schema_module, "NEW_TABLE_BUILD_SEC", 120.0)
    rosCas.addTopic("/t", index=["data"]).addData(String("a"))
    assert seen == [[], "false"]
    topic = rosCas.getTopic("/t")
    assert topic.hasIndex("data")
    plain = rosCas.addTopic("/plain", msg_type="std_msgs/String").tables[0]
    assert compaction(cql, rosCas, topic.tables[0]) == compaction(cql, rosCas, plain)


def test_a_message_does_not_wait_for_ever_for_an_index(rosCas, cql, busy, caplog):
    topic = rosCas.addTopic("/t", index=["data"], ttl=500)
    with busy():
        topic.addData(String("a"))
    assert [message.data for _, message in topic.items()] == ["a"]
    assert len(warnings(caplog)) == 1
    (table,) = topic.tables
    options = compaction(cql, rosCas, table)
    assert options.pop("enabled") == "false"
    topic.createIndex("data")
    assert compaction(cql, rosCas, table) == options


def test_a_table_that_was_left_without_its_indexes_is_no_topic(rosCas, cql, monkeypatch):
    def crash(*args):
        raise Crash

    with monkeypatch.context() as broken:
        broken.setattr(rosCas.catalog.keyspace.schema, "create_sai_index", crash)
        with pytest.raises(Crash):
            rosCas.addTopic("/t", index=["data"]).addData(String("a"))
    assert list(rosCas.info()) == []
    rows = cql.execute(
        "SELECT comment FROM system_schema.tables WHERE keyspace_name = %s", (rosCas.keyspace,)
    )
    assert sum("client that died, is empty, and may be dropped" in row[0] for row in rows) == 1
    rosCas.getTopic("/t").addData(String("b"))
    assert [message.data for _, message in rosCas.getTopic("/t").items()] == ["b"]


def test_a_column_that_was_left_of_another_type_is_passed_over(rosCas, cql):
    table = store(rosCas, "/t", 5, Float64)
    cql.execute(f'ALTER TABLE {table.qualified} ADD "_ix0" text')
    rosCas.getTopic("/t").createIndex("data")
    metadata = rosCas.getTopic("/t").tables[0].metadata
    assert (dict(metadata.indexes), metadata.next_shadow) == ({"data": "_ix1"}, 2)


def test_an_index_that_its_comment_lists_is_made_where_it_is_missing(rosCas, cql):
    table = store(rosCas, "/t", 5)
    topic = rosCas.getTopic("/t")
    topic.createIndex("data")
    cql.execute(f'DROP INDEX {rosCas.keyspace}."{table.name}_ix0"')
    assert topic.createIndex("data") == 0
    assert index_names(cql, rosCas, table) == {"_ix0"}


def test_numbers_are_never_used_again(rosCas, cql):
    table = store(rosCas, "/t", 5)
    topic = rosCas.getTopic("/t")
    for number in range(3):
        topic.createIndex("data")
        assert dict(topic.tables[0].metadata.indexes) == {"data": f"_ix{number}"}
        assert index_names(cql, rosCas, table) == {f"_ix{number}"}
        topic.removeIndex("data")
    assert index_names(cql, rosCas, table) == set()
    # The columns stay: another client may be writing into them.
    assert {"_ix0", "_ix1", "_ix2"} < set(rosCas.catalog.keyspace.schema.columns(table.name))


def test_a_crash_while_removing_is_completed(rosCas, cql, monkeypatch):
    table = store(rosCas, "/t", 5)
    topic, cassandra = rosCas.getTopic("/t"), rosCas.cassandra
    topic.createIndex("data")
    change = cassandra.schema_change

    def crash(statement, *, what):
        if statement.startswith("DROP INDEX"):
            raise Crash
        change(statement, what=what)

    with monkeypatch.context() as broken:
        broken.setattr(cassandra, "schema_change", crash)
        with pytest.raises(Crash):
            topic.removeIndex("data")
    rosCas.catalog.keyspace.schema.tables(fresh=True)
    assert topic.getMeta["indexes"] == []
    assert index_names(cql, rosCas, table) == {"_ix0"}
    topic.removeIndex("data")
    assert index_names(cql, rosCas, table) == set()


def test_a_topic_that_is_gone(rosCas):
    store(rosCas, "/t", 5)
    topic = rosCas.getTopic("/t")
    rosCas.removeTopic("/t")
    for change in (topic.createIndex, topic.removeIndex):
        with pytest.raises(TopicNotFound):
            change("data")


def test_a_number_that_its_comment_lists_is_not_given_again():
    """Also where the count was changed by hand."""
    wrong = TopicMetadata("/t", "a/B", "0" * 32, "ros", SEC, indexes={"data": "_ix0"})
    assert (wrong.index_count, wrong.next_shadow) == (0, 1)
    assert wrong.without_index("data").next_shadow == 1
    assert TopicMetadata("/t", "a/B", "", "ros", SEC).next_shadow == 0


def test_what_is_no_ttl_is_refused(rosCas):
    wrong = ["abc", "10", b"10", None, float("inf"), float("nan"), 1.5, -1, True, MAX_TTL_SEC + 1]
    for ttl in (*wrong, 10**400):
        with pytest.raises(InvalidOption, match="ttl=.*cannot be used"):
            check_ttl(ttl)
        with pytest.raises(InvalidOption):
            rosCas.addTopic("/t", ttl=ttl)


@pytest.mark.parametrize("ttl", [0, 1, 60.0, MAX_TTL_SEC])
def test_what_is_a_ttl(ttl):
    assert check_ttl(ttl) == ttl and type(check_ttl(ttl)) is int


def test_a_slot_is_noted_again_while_it_is_written(rosCas, monkeypatch):
    from cassandra_ros.store.tables import directory as listing

    # Only the test's own.
    monkeypatch.setattr("cassandra_ros.store.rows.writer.HEARTBEAT_SEC", 1e9)
    writer = rosCas.messageWriter(ttl=500)
    handle = writer.connect(api_connection("/t", definition_of(String), "/w"), bucket_ns=600 * SEC)

    noted = []
    directory = writer._rows._directory
    add_node = directory.add_node

    def counting(table, slot, node, ttl=0):
        noted.append(ttl)
        add_node(table, slot, node, ttl)

    monkeypatch.setattr(directory, "add_node", counting)
    clock = [time.monotonic()]
    monkeypatch.setattr(listing, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    wire = serialize(String(data="x"))
    writer.write(handle, T0, 0, wire)
    writer.write(handle, T0 + 600 * SEC, 1, wire)
    assert noted == [500 + 7200]
    (bucket, _) = writer._rows._buckets.values()
    clock[0] += 3599
    writer._rows._put(bucket, None)
    assert len(noted) == 1
    clock[0] += 2
    writer._rows._put(bucket, None)  # the heartbeat of a bucket that is written all the time
    assert len(noted) == 2
    clock[0] += 3601
    writer._rows._reopen(bucket)  # a bucket that lay idle
    assert len(noted) == 3
    clock[0] += 3601
    writer.write(handle, T0 + 1200 * SEC, 2, wire)  # another bucket of the slot
    assert len(noted) == 4
    monkeypatch.undo()
    writer.close()
