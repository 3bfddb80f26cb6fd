# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows, blocks, the directory and comments that somebody changed with the bare driver."""

from __future__ import annotations

import json

import pytest
from geometry_msgs.msg import Twist
from hostile.mutate import LONGS, changed_bytes, changed_json, changed_text
from mapping.room import T0, Drive

from cassandra_ros.store.connection.cql_names import quote_name, quote_text
from cassandra_ros.topics.overview.timeline.lanes import Timeline, View

SIDE_TABLES = ("cr_bucket", "cr_node", "cr_connection", "cr_definition", "cr_run")
WORDS = ["", "a", "/tf", "/cmd_vel", "open", "closed", "é", "x" * 70_000, "\x1b[31m", "_ix0"]
TOPICS = ("/tf", "/odom", "/scan", "/cmd_vel", "/text")


def fill(store):
    """Store a drive in blocks, some messages as rows, others as text, and one in chunks."""
    Drive().store(store, ("/tf", "/tf_static", "/odom", "/scan"), "a")
    for name, form in (("/cmd_vel", "ros"), ("/text", "yaml")):
        topic = store.addTopic(name, format=form)
        for n in range(20):
            message = Twist()
            message.linear.x = n / 4
            topic.addData(message, key=T0 + n * 10**8, nodeID="a")
    store.getTopic("/cmd_vel").createIndex("linear.x")


class Changer:
    """Changes a value of a row, and puts back what was there.

    Args:
        cql: A session of the bare driver.
        store: The store whose rows are changed.
    """

    def __init__(self, cql, store):
        self._cql, self._space = cql, store.keyspace
        topics = {t.name: topic.name for topic in store.getAllTopics() for t in topic.tables}
        self._topics = topics
        self.tables = [*SIDE_TABLES, *topics]
        self._columns = {name: self._columns_of(name) for name in self.tables}
        self._rows = {
            name: list(cql.execute(f"SELECT {self._names(name)} FROM {self._place(name)}"))
            for name in self.tables
        }
        self.tables = [name for name in self.tables if self._rows[name]]

    def _columns_of(self, table):
        found = self._cql.execute(
            "SELECT column_name, type, kind FROM system_schema.columns "
            "WHERE keyspace_name = %s AND table_name = %s",
            (self._space, table),
        )
        return list(found)

    def _place(self, table):
        return f"{self._space}.{quote_name(table)}"

    def _names(self, table):
        return ", ".join(quote_name(name) for name, _, _ in self._columns[table])

    def change(self, chance):
        """Change one value, or put in a row with another key.

        Returns:
            The topic whose rows may be others now, and what undoes the change.
        """
        table = chance.choice(self.tables)
        columns = self._columns[table]
        row = list(chance.choice(self._rows[table]))
        keys = [n for n, column in enumerate(columns) if column[2] != "regular"]
        values = [n for n, column in enumerate(columns) if column[2] == "regular"]
        changed = list(row)
        for _ in range(chance.choice((1, 1, 2))):
            at = chance.choice(values if values and chance.random() < 0.85 else keys)
            changed[at] = another(chance, row[at], columns[at][1], columns[at][2] != "regular")
        self._put(table, changed)

        def undo():
            where = " AND ".join(f"{quote_name(columns[n][0])} = %s" for n in keys)
            self._cql.execute(
                f"DELETE FROM {self._place(table)} WHERE {where}", [changed[n] for n in keys]
            )
            self._put(table, row)

        named = dict(zip(self._names_of(table), row)).get("tbl", table)
        name = self._topics.get(named)
        return name or chance.choice(TOPICS), undo

    def _names_of(self, table):
        return [name for name, _, _ in self._columns[table]]

    def _put(self, table, row):
        marks = ", ".join("%s" for _ in row)
        self._cql.execute(
            f"INSERT INTO {self._place(table)} ({self._names(table)}) VALUES ({marks})", row
        )


def another(chance, value, kind, key):
    """Return another value of a CQL type; in a key no null and no text that is too long."""
    if not key and chance.random() < 0.15:
        return None
    bits = {"bigint": 64, "int": 32, "smallint": 16, "tinyint": 8}.get(kind)
    if bits:
        number = chance.choice((*LONGS, (value or 0) + 1, (value or 0) - 1, -(value or 0)))
        return (number + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)
    if kind == "text":
        text = changed_text(chance, value or "", WORDS)
        return text.encode("utf-8", "replace")[:60_000].decode("utf-8", "replace") or "x"
    if kind == "blob":
        return changed_bytes(chance, value or b"")[:60_000] or b"x"
    if kind == "boolean":
        return not value
    if kind in ("double", "float"):
        return chance.choice((float("nan"), float("inf"), -0.0, 1e30))
    if kind == "timestamp":
        return chance.choice((0, 4102444800000, -1, 2**53, 2**62, -(2**62)))  # ms
    if "set<text>" in kind:
        return {chance.choice(("_ix0", "", "é", "linear.x")) for _ in range(2)}
    if "set<int>" in kind:
        return {chance.choice((0, -1, 2**31 - 1, 5)) for _ in range(2)}
    if "map<text, text>" in kind:
        return {chance.choice(WORDS[:7]): chance.choice(WORDS[:7])}
    if "map<text, bigint>" in kind:
        return {chance.choice(WORDS[:7]): chance.choice((0, -1, 2**63 - 1))}
    if "list<text>" in kind:
        return [chance.choice(WORDS[:7]) for _ in range(chance.choice((0, 1, 5)))]
    return value


def read(chance, store, name):
    """Ask the store for something about a topic, as programs and pages do."""

    def some_items():
        for row in store.getTopic(name).rows(limit=40):
            assert len(row.wire) == row.size

    def statement():
        field = {"/tf": "transforms.header.stamp", "/text": "linear.x", "/cmd_vel": "linear.x"}
        wanted = chance.choice(("KEY", "count(*)", "*", field.get(name, "header.stamp")))
        store.executeCQL(f"SELECT {wanted} FROM {name} WHERE KEY > {T0 + 10**9} LIMIT 10")

    def condition():
        store.executeCQL("SELECT KEY FROM /cmd_vel WHERE linear.x > 2")

    asked = chance.choice(
        (
            some_items,
            some_items,
            some_items,
            statement,
            statement,
            condition,
            store.info,
            lambda: repr(list(store.runs())),
            lambda: store.getTopic(name).getData(T0 + 10**9, nearest="either"),
            lambda: store.getTopic(name).getArrays(["KEY"], key=T0, to_key=T0 + 10**9),
            lambda: (store.getTopic(name).first(), store.getTopic(name).last()),
            lambda: store.getTopic(name).countTopicData(T0, T0 + 3 * 10**9),
            lambda: Timeline(store.catalog).picture(View(T0, T0 + 9 * 10**9, 50, [name])),
            lambda: store.lookupTransform("odom", "base", T0 + 2 * 10**9),
            lambda: repr(store.upkeep.check([name])),
        )
    )
    return asked()


@pytest.mark.suite("all", "a search over changed inputs")
def test_changed_rows(give, rosCas, cql):
    fill(rosCas)
    changer = Changer(cql, rosCas)

    def attempt(chance):
        name, undo = changer.change(chance)
        try:
            read(chance, rosCas, name)
        finally:
            undo()

    give("rows, blocks and directory", 400, attempt)


@pytest.mark.suite("all", "a search over changed inputs")
def test_changed_comments(give, rosCas, cql):
    fill(rosCas)
    tables = {
        table.name: table.metadata.to_comment()
        for topic in rosCas.getAllTopics()
        for table in topic.tables
    }
    listing = rosCas.catalog.keyspace.schema.listing
    words = [*WORDS[:7], "packed", "binary", "hash", "manual", "std_msgs/String"]

    def comment(table, text):
        cql.execute(
            f"ALTER TABLE {rosCas.keyspace}.{quote_name(table)} WITH comment = {quote_text(text)}"
        )
        listing(fresh=True)

    def attempt(chance):
        table = chance.choice(list(tables))
        text = json.dumps(changed_json(chance, json.loads(tables[table]), words))
        if chance.random() < 0.2:
            text = changed_text(chance, text, [*words, "{", "NaN", "Infinity", '"'])
        text = text.replace("\0", "").encode("utf-8", "replace").decode()
        try:
            comment(table, text)
            rosCas.info()
            read(chance, rosCas, chance.choice(TOPICS))
        finally:
            comment(table, tables[table])

    give("comments of tables in a store", 12, attempt)
