# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Fields read out of many messages at once are those that are cut out of each."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from messages.random_wire import DefinitionMaker
from messages.test_message_stacks import manyWires
from suites import search

from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.query.arrays import table_values
from cassandra_ros.query.arrays.batch import row_batches
from cassandra_ros.query.arrays.table_values import TableValues
from cassandra_ros.query.rows.name_resolution import Findings
from cassandra_ros.query.tree.field_names import all_fields
from cassandra_ros.query.tree.parse import parse_select


def gathered(definition, names, wires):
    table = SimpleNamespace(
        name="t",
        definition=definition,
        msg_type=definition.type,
        named=False,
        by_field=False,
        columns=("_data",),
    )
    select = parse_select(f"select KEY, {', '.join(names)} from /t", ())
    values = TableValues(select, table, Findings(select.text))
    rows = [
        SimpleNamespace(t=n, key=n, node="", seq=n, name="", table=table, wire=wire, size=len(wire))
        for n, wire in enumerate(wires)
    ]
    for batch in row_batches(rows, lambda _: values.parts):
        values.add(batch)
    values.flush()
    kinds = dict(pair for group in values.groups for pair in group)
    return bool(values._stacked), {
        name: values.pop_column(name, kind) for name, kind in kinds.items()
    }


def same(one, other):
    if isinstance(one, np.ndarray):
        same_type = one.dtype == other.dtype and one.shape == other.shape
        if one.dtype.kind == "O":
            return same_type and all(map(same, one, other))
        return same_type and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    return one == other


@search(80)
@given(seed=st.integers(0, 2**32))
def test_all_at_once_is_one_by_one(seed):
    definition = parse_definition(*DefinitionMaker(seed).make())
    refs = [ref for ref in all_fields(definition) if not ref.arrays]
    names = [ref.name for ref in refs]
    names += [f"{ref.name}[1]" for ref in refs if ref.is_array]
    times = [ref for ref in refs if ref.type in ("time", "duration") and not ref.is_array]
    names += [f"{ref.name}.{part}" for ref in times for part in ("secs", "nsecs")]
    wires, stacked = manyWires(definition, seed), False
    for name in names:
        try:
            was, found = gathered(definition, [name], wires)
        except Exception as exc:  # noqa: BLE001 (a fixed array may have no second element)
            assert "counted from 0" in str(exc) or "elements" in str(exc)
            continue
        stacked = stacked or was
        able, table_values.StackedField.is_able = table_values.StackedField.is_able, False
        try:
            was, expected = gathered(definition, [name], wires)
        finally:
            table_values.StackedField.is_able = able
        assert not was and list(found) == list(expected)
        for column, (values, missing) in found.items():
            assert same(missing, expected[column].missing), column
            assert same(values, expected[column].values), column
