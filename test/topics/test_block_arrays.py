# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""getArrays of messages that lie together, as in blocks, gives what it gives row by row."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from std_msgs.msg import Header

from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.query.arrays import batch
from cassandra_ros.query.arrays.batch import StackedBatch
from cassandra_ros.query.arrays.table_values import TableValues
from cassandra_ros.topics import row_reader
from cassandra_ros.topics.row_reader import RowReader
from cassandra_ros.topics.stored_row import StoredRow

T0 = 1_600_000_000 * SECOND_NS
FIELDS = ["KEY", "NODE", "RUN", "seq", "stamp", "frame_id"]
LARGE = "x" * 600_000


CONDITIONS = (
    "seq > 40",
    "seq < 200 AND frame_id = 'ffff'",
    "NOT seq > 40",
    "seq IS NULL",
    "frame_id LIKE 'fff%' AND NODE = 'a'",
    "RUN = '4' OR seq IN (5, 6)",
    "seq * 2 > 90 AND stamp.nsecs != 50",
    f"KEY >= {T0 + SECOND_NS // 4} AND KEY < {T0 + SECOND_NS} AND seq >= 5",
    f"KEY >= {T0 + SECOND_NS // 4}",
)
"""Conditions that numpy answers, in whole or in part, or for each message."""


def fill(rosCas, format="packed"):
    """Two nodes, one of them with two writers at once: equal stamps, all sizes, some large."""
    definition = definition_of(Header)
    for node, writer_id, count in (("b", 2, 300), ("a", 3, 300), ("a", 4, 90)):
        with rosCas.messageWriter(nodeID=node, writer_id=writer_id, format=format) as writer:
            handle = writer.connect(api_connection("/p", definition, "/x"), bucket_ns=SECOND_NS)
            for n in range(count):
                text = LARGE if n == 70 else "f" * (n % 11)
                message = Header(seq=n + writer_id, frame_id=text)
                message.stamp.nsecs = n
                wire = b"no message" if n == 77 else serialize(message)
                writer.write(handle, T0 + n // 2 * SECOND_NS // 100, n, wire)
    return rosCas.getTopic("/p")


def row_by_row(reader, tables, read, together):
    """Read messages of a RowReader row by row."""
    return reader.read(tables, read)


@pytest.mark.parametrize("format", ["packed", "ros", "binary"])
def test_what_lies_together_gives_what_single_rows_give(rosCas, monkeypatch, format):
    topic = fill(rosCas, format)
    assert topic.removeData(T0 + SECOND_NS // 100, T0 + SECOND_NS // 10) > 10
    asked = [
        {},
        {"nodeID": "a"},
        {"run": "4"},
        {"key": T0 + SECOND_NS // 2, "to_key": T0 + SECOND_NS},
        *({"where": where} for where in CONDITIONS),
        {"where": ("stamp.nsecs < ?", [90]), "nodeID": "b"},
        {"where": "seq IS NOT NULL", "key": T0 + SECOND_NS // 2, "run": "2"},
    ]
    stacked = []

    class Counted(StackedBatch):
        def __init__(self, *args):
            super().__init__(*args)
            stacked.append(self)

    with monkeypatch.context() as patch:
        patch.setattr(RowReader, "read", lambda *_: pytest.fail("they are read row by row"))
        patch.setattr(row_reader, "StackedBatch", Counted)
        whole = topic.toArrow().read_all()
        assert len(stacked) >= 4
        blocks = [topic.getArrays(FIELDS, **options) for options in asked]
        tables = [topic.toArrow(["seq"], **options).read_all() for options in asked]
    # Only the keys are needed here, but the condition needs large messages, too.
    counts = [topic.countTopicData(**options) for options in asked]
    assert topic.getArrays("seq")["seq"].count() == len(topic.getArrays("KEY")["KEY"]) - 3
    monkeypatch.setattr(RowReader, "in_order", row_by_row)
    single = topic.toArrow().read_all()
    assert sorted(map(str, whole.to_pylist())) == sorted(map(str, single.to_pylist()))
    for options, found, table, count in zip(asked, blocks, tables, counts):
        wanted = topic.getArrays(FIELDS, **options)
        assert len(wanted["KEY"]) > 20 or "IS NULL" in options["where"]
        assert topic.countTopicData(**options) == count == len(table) == len(wanted["KEY"])
        for name in FIELDS:
            assert found[name].dtype == wanted[name].dtype
            mask = np.ma.getmaskarray(wanted[name])
            assert np.array_equal(np.ma.getmaskarray(found[name]), mask)
            assert np.array_equal(found[name][~mask], wanted[name][~mask])


@pytest.mark.parametrize("format", ["packed", "ros", "binary"])
def test_keys_alone_need_no_large_message(rosCas, monkeypatch, format):
    topic = fill(rosCas, format)
    monkeypatch.setattr(StoredRow, "wire", property(lambda row: pytest.fail("it is read")))
    assert len(topic.getArrays(["KEY", "NODE", "RUN"])["KEY"]) == 690
    assert topic.toArrow(["KEY"]).read_all().num_rows == 690


@pytest.mark.suite("all", "large messages, to see how much memory they take")
@pytest.mark.parametrize("where", [None, "seq >= 0"])
@pytest.mark.parametrize("format", ["packed", "ros", "binary"])
def test_large_messages_that_were_turned_into_arrays_are_let_go(rosCas, monkeypatch, format, where):
    monkeypatch.setattr(batch, "ROW_BATCH_BYTES", len(LARGE))
    definition = definition_of(Header)
    with rosCas.messageWriter(format=format) as writer:
        handle = writer.connect(api_connection("/p", definition, "/x"))
        for n in range(6):
            message = Header(seq=n, frame_id=LARGE)
            writer.write(handle, T0 + n, n, serialize(message))
    held, add = [], TableValues.add
    gc.collect()
    others = {id(o): o for o in gc.get_objects() if type(o) is StoredRow}  # of earlier tests

    def counted(self, added):
        add(self, added)
        rows = (o for o in gc.get_objects() if type(o) is StoredRow and id(o) not in others)
        held.append(sum(row.was_read for row in rows))

    monkeypatch.setattr(TableValues, "add", counted)
    found = rosCas.getTopic("/p").getArrays(["seq", "frame_id"], where=where)
    assert found["seq"].tolist() == [0, 1, 2, 3, 4, 5]
    assert len(held) == 6
    assert max(held) <= 2
