# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The columns of a statement from a batch of messages, beside its rows from one after the other."""

from __future__ import annotations

import random
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from hypothesis import given
from hypothesis import strategies as st
from query.brute_force import Message, Types, Writer
from query.kinds import KINDS
from query.random_statements import Asker
from query.test_sift import similar, tableOf
from sensor_msgs.msg import Image, Imu, JointState, LaserScan
from suites import random_statements
from tf2_msgs.msg import TFMessage

from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.messages.wire.message_stacks import by_size
from cassandra_ros.query.arrays.batch import StackedBatch
from cassandra_ros.query.arrays.result_columns import ResultColumns
from cassandra_ros.query.rows.projection import Projections
from cassandra_ros.query.rows.result_groups import analyse_select, rows_of
from cassandra_ros.query.tree.field_names import all_fields
from cassandra_ros.query.tree.parse import parse_select

T0 = 1_400_000_000 * 10**9
WRITERS = (10, 11)


class Topic:
    """Messages of one table and robot: as a batch, and as rows."""

    def __init__(self, table, wires, node="husky", unsure=None):
        table.runs = SimpleNamespace(text=lambda writer: f"run {writer}")
        self.table, self.unsure = table, unsure
        self.rows, self.seqs = [], []
        for n, wire in enumerate(wires):
            writer = WRITERS[3 * n // len(wires) % 2]
            seq = writer << 32 | n
            key = Stamp.from_ns(T0 + n, node, seq, table.name)
            row = {"t": T0 + n, "key": key, "node": node, "run": f"run {writer}", "name": ""}
            row.update(wire=wire, table=table, columns=(), topic="/topic")
            self.rows.append(SimpleNamespace(**row))
            self.seqs.append(seq)
        times = np.array([row.t for row in self.rows], np.int64)
        seqs = np.array(self.seqs, np.int64)
        groups = list(by_size(wires))
        self.batch = StackedBatch(table, node, times, seqs, groups, unsure=unsure)

    def answers(self, text, params=(), tables=(), shared=False):
        """The rows of a statement out of the batch, None where it cannot be asked, and of rows."""
        tables = tables or [self.table]
        select = analyse_select(parse_select(text, params), tables)
        projection = Projections(select, tables).of(self.table)
        one_by_one = [shown for row in self.rows for shown in projection.rows(row)]
        reader = ResultColumns.of(self.table.definition, projection, shared=shared)
        if reader is None:
            return None, one_by_one
        batch, columns = reader.read(self.batch, check=True)
        together = list(rows_of(columns))
        assert all(len(column) == len(batch) for column in columns)
        return together, one_by_one


def keyed(rows):
    """What of rows has to be the same: type and value of each, and the place of a key."""
    return [
        [(type(v), repr(v), getattr(v, "seq", None), getattr(v, "table", None)) for v in row]
        for row in rows
    ]


@pytest.mark.search
@pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")
@pytest.mark.parametrize("name", ["every", "mixed", "scan", "tf", "uint64", "string"])
def test_random_statements(name, caplog):
    caplog.set_level("CRITICAL", "cassandra_ros")
    kind, numbers = KINDS[name], random.Random(name)
    topics, messages = [], []
    for types in kind.types:
        table = tableOf(types)
        wires = similar(types, numbers, 60)
        topics.append(Topic(table, wires))
        value = types.root()
        messages.append(Message(T0, "husky", (10, 0), types, value))
    tables = [topic.table for topic in topics]
    seen = Counter()

    @random_statements(100)
    @given(Asker(kind.types, messages, kind.indexes).statements(), st.integers(0, 2**32))
    def check(statement, seed):
        writer = Writer(seed)
        text = writer.statement(statement, "/topic")
        for topic in topics:
            together, one_by_one = topic.answers(text, writer.params, tables)
            seen["one by one"] += together is None
            if together is not None:
                seen["together"] += 1
                seen["some"] += bool(together)
                assert keyed(together) == keyed(one_by_one), (text, writer.params)

    check()
    assert name == "tf" or min(seen["together"], seen["some"]) > 0, seen


@pytest.mark.parametrize("name", KINDS)
def test_each_field(name, caplog):
    caplog.set_level("CRITICAL", "cassandra_ros")
    numbers, count = random.Random(name), 0
    for types in KINDS[name].types:
        topic = Topic(tableOf(types), similar(types, numbers, 80))
        for field in all_fields(topic.table.definition):
            together, one_by_one = topic.answers(f"select {field.name} from t")
            if together is not None:
                count += 1
                assert keyed(together) == keyed(one_by_one), field.name
    assert count or name in ("tf", "diagnostics"), name


def of(messages, **more):
    table = tableOf(Types(messages[0]._type, messages[0]._full_text))
    assert table.definition == definition_of(type(messages[0]))
    return Topic(table, list(map(serialize, messages)), **more)


def imus(count):
    numbers, messages = random.Random(5), []
    for n in range(count):
        message = Imu()
        message.header.seq, message.header.stamp.secs = n, 1_400_000_000 + n
        message.header.frame_id = "imu" if n % 3 else "imu_link"
        message.orientation.x = numbers.choice([0.0, -0.0, 1.5, float("nan")])
        messages.append(message)
    return messages


def test_own_values_times_and_computed_ones():
    together, rows = of(imus(50)).answers(
        "select KEY, NODE, RUN, header.stamp, header.stamp.secs, header.frame_id, "
        "time(10ns) as slot, orientation.x / 2 + header.seq, orientation.x from t"
    )
    assert len(together) == 50
    assert keyed(together) == keyed(rows)


def test_a_condition_is_checked_where_the_batch_is_not_sure():
    unsure = np.arange(50) < 25
    together, rows = of(imus(50), unsure=unsure).answers(
        "select header.seq from t where not header.seq > 10"
    )
    assert rows == [(n,) for n in range(11)]
    assert together == rows + [(n,) for n in range(25, 50)]


def test_elements_of_arrays_of_several_lengths():
    messages = [JointState(position=[float(n)] * (n % 3)) for n in range(60)]
    together, rows = of(messages).answers("select position[1], header.seq from t")
    assert together == rows
    assert {row[0] for row in together[:3]} == {None, 2.0}


def test_messages_that_share_no_layout_and_damaged_ones(caplog):
    messages = [JointState(name=["j" * (n % 25)], position=[n]) for n in range(100)]
    topic = of(messages)
    wires = [row.wire for row in topic.rows]
    wires[7], wires[60] = wires[7][:-30], b""
    topic = Topic(topic.table, wires)
    together, rows = topic.answers("select position[0], KEY from t")
    assert keyed(together) == keyed(rows)
    assert [row[0] for row in together[6:9]] == [6.0, None, 8.0]
    assert "cannot be read" in caplog.text


@pytest.mark.parametrize(
    "what", ["ranges", "max(ranges)", "len(ranges)", "ranges, intensities", "ranges[2]"]
)
def test_arrays(what):
    messages = [LaserScan(ranges=[n] * (n % 4), intensities=[2.5]) for n in range(40)]
    together, rows = of(messages).answers(f"select {what} from t where len(ranges) != 1")
    assert keyed(together) == keyed(rows)
    assert len(rows) == 30


def test_arrays_of_bytes_of_bools_and_of_fixed_length():
    image = [Image(data=bytes([n, 255]), height=n) for n in range(40)]
    together, rows = of(image).answers("select data, height from t")
    assert keyed(together) == keyed(rows)
    assert together[3][0] == b"\3\xff"
    together, rows = of(imus(40)).answers("select orientation_covariance, header.seq from t")
    assert keyed(together) == keyed(rows)


def test_what_is_inside_an_array_of_messages_is_read_message_by_message():
    together, rows = of([TFMessage([TransformStamped()] * 2)] * 40).answers(
        "select transforms.child_frame_id from t"
    )
    assert together is None
    assert len(rows) == 80


def test_times_are_one_object_only_where_rows_are_gathered():
    table = tableOf(SimpleNamespace(name=Imu._type, text=Imu._full_text, md5sum=Imu._md5sum))
    wires = [serialize(Imu()) for _ in range(40)]
    for shared in (False, True):
        together, _ = Topic(table, wires).answers("SELECT header.stamp FROM /topic", shared=shared)
        assert len({id(value) for (value,) in together}) == (1 if shared else 40)
