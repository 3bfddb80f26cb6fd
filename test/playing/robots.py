# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Recordings for the tests of what is played: texts at times that are easy to read."""

from __future__ import annotations

from bag.truth import string_connection, string_wire

from cassandra_ros.store.tables.registry import Run

SEC = 10**9
T0 = 1_500_000_000 * SEC


class Robot:
    """Writes messages of one run: times in seconds from T0."""

    def __init__(self, rosCas, writer_id, node="", bucket_ns=SEC):
        run = Run(node, writer_id, "recording", name=f"run {writer_id}")
        self._writer = rosCas.messageWriter(writer_id=writer_id, nodeID=node, run=run)
        self._bucket_ns = bucket_ns
        self._count = 0
        self._handles = {}

    def __enter__(self):
        return self

    def __exit__(self, *exc_info):
        self._writer.close()

    def flush(self):
        self._writer.flush()

    def send(self, topic, t, text, caller="/a", latched=False, count=None):
        key = (topic, caller, latched)
        if key not in self._handles:
            fields = {"latching": "1"} if latched else {}
            connection = string_connection(topic, callerid=caller, **fields)
            self._handles[key] = self._writer.connect(connection, bucket_ns=self._bucket_ns)
        t_ns = T0 + round(t * SEC)
        self._count = self._count if count is None else count
        self._writer.write(self._handles[key], t_ns, self._count, string_wire(text))
        self._count += 1


def text_of(row):
    return row.wire[4:].decode()


def played(stream, t=None):
    return [(p.topic, (p.t - T0) / SEC, text_of(p.row)) for p in stream.messages(t)]


def texts(rows):
    return [text_of(row) for row in rows]
