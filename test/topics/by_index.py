# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What an index finds, beside what a plain reading finds: the rule that queries go by."""

from __future__ import annotations

import time

from cassandra_ros.read import Read, TimeRange, Whose

FIRST, LAST = -(2**63), 2**63 - 1


def directory_rows(rosCas, table):
    return rosCas.catalog.keyspace.directory.buckets_by_robot(table.name, FIRST, LAST)


def filled(rosCas, topic, field):
    """How many (bucket, writer) list the index of the field, and how many there are."""
    done = every = 0
    for table in topic.tables:
        rows = directory_rows(rosCas, table)
        index = table.index_fields.get(field)
        every += len(rows)
        done += sum(index is not None and index.shadow in row.filled for row in rows)
    return done, every


def await_built(rosCas):
    """Wait until every node has built the indexes of the keyspace."""
    deadline = time.monotonic() + 120
    query = "SELECT is_queryable FROM system_views.sai_column_indexes WHERE keyspace_name = ?"
    while True:
        nodes = rosCas.cassandra.execute_on_each(query, (rosCas.keyspace,), what="asking for them")
        if all(built for rows in nodes.values() for (built,) in rows):
            return nodes
        assert time.monotonic() < deadline, nodes
        time.sleep(0.1)


def _keys(rows, of, values):
    found = {value: set() for value in values}
    for row in rows:
        for value in of(row.message()):
            if value in found:
                found[value].add((row.t, row.node, row.seq))
    return found


def by_index(rosCas, topic, field, of, values):
    """Keys of the messages by value: by the index where every writer filled it, else by reading.

    Args:
        of: The values of the field in a message.
        values: Those that are asked for.
    """
    found = {value: set() for value in values}
    for table in topic.tables:
        index = table.index_fields.get(field)
        buckets = {}
        for row in directory_rows(rosCas, table):
            buckets.setdefault((row.node, row.bucket), []).append(row)
        for (node, bucket), writers in buckets.items():
            ends = (bucket * table.metadata.bucket_ns, (bucket + 1) * table.metadata.bucket_ns - 1)
            rows = rosCas.catalog.keyspace.rows.read(
                [table], Read(TimeRange(*ends), Whose((node,)))
            )
            parts = []
            if index is not None and all(index.shadow in row.filled for row in writers):
                parts.append(_indexed(rosCas, table, index, (node, bucket), values))
                if any(row.odd or not row.closed for row in writers):
                    parts.append(_keys((row for row in rows if row.odd), of, values))
            else:
                parts.append(_keys(rows, of, values))
            for part in parts:
                for value in values:
                    found[value] |= part[value]
    return found


def _indexed(rosCas, table, index, place, values):
    operator = "CONTAINS" if index.many else "="
    answers = rosCas.cassandra.execute_many(
        f'SELECT "_t", "_seq" FROM {table.qualified} WHERE "_node" = ? AND "_bucket" = ? '
        f'AND "{index.shadow}" {operator} ?',
        [(*place, value) for value in values],
        what="asking an index",
    )
    return {v: {(t, place[0], seq) for t, seq in rows} for v, rows in zip(values, answers)}


def check(rosCas, topic, field, of, *values):
    """Compare both while others may write: what was there before is found, and nothing else.

    Returns:
        How many messages were found by each value.
    """
    before = _keys(topic.rows(), of, values)
    found = by_index(rosCas, topic, field, of, values)
    after = _keys(topic.rows(), of, values)
    for value in values:
        assert before[value] <= found[value] <= after[value], (field, value)
    return [len(found[value]) for value in values]
