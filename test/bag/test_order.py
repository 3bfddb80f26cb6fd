# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Order and headers through bag → store → bag: publishers, equal stamps, clocks that run back."""

from __future__ import annotations

import random

import pytest
from bag.truth import read_with_rosbag, string_connection, string_wire
from suites import FEW_FORMATS, sparing

from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.keys import MAX_NS
from cassandra_ros.metadata import FORMAT_NAMES

SEC = 10**9
Y2038 = 2**31 * SEC
HEADERS = [
    {"callerid": "/first", "latching": "1"},
    {"callerid": "/second"},
    {"callerid": "/second"},  # the same header twice is two connections
    {"latching": "0", "callerid": "/fourth", "tcp_nodelay": "0", "überall": "☃"},
    {"callerid": b"\xff\0\xfe".decode("latin-1")},
]
TIMES = [
    *[5 * SEC] * 200,
    *((1000 - n // 2) * SEC for n in range(200)),
    *[0, 0, 1, Y2038 - 1, Y2038, Y2038 + SEC, MAX_NS - 1, MAX_NS, MAX_NS] * 20,
    *random.Random(3).sample([n // 4 * SEC // 3 for n in range(200)], 200),
]


def _place(message):
    # rosbag does not sort a bag whose times run backwards over several chunks.
    number, position = map(int, message.data[4:].split())
    return message.t_ns, number, position


@pytest.mark.parametrize("form", sparing(FORMAT_NAMES, FEW_FORMATS, "campaign"))
def test_order_and_headers_come_back(rosCas, tmp_path, form):
    path, rand, wires = tmp_path / "a.bag", random.Random(7), []
    with BagWriter(path, chunk_bytes=2000) as writer:
        numbers = [
            writer.connection(string_connection(f"/t{n % 2}", **fields))
            for n, fields in enumerate(HEADERS * 2)
        ]
        for n, t_ns in enumerate(TIMES):
            number = rand.choice(numbers)
            wires.append(string_wire(f"{number} {n}"))
            writer.write(number, t_ns, wires[-1])
    import_bag(rosCas, path, format=form)
    assert verify_bag(rosCas, path).equal
    export_bag(rosCas, tmp_path / "out.bag")
    connections, messages = read_with_rosbag(path)
    again, exported = read_with_rosbag(tmp_path / "out.bag")
    assert again == connections
    assert exported == sorted(messages, key=_place)
    with BagReader(path) as original, BagReader(tmp_path / "out.bag") as copy:
        assert copy.connections == original.connections
        assert all(c.header == original.connections[n].header for n, c in copy.connections.items())
    # In the store: by time, and between equal times as they lay in the bag.
    rows = [(row.t, row.wire) for row in rosCas.readMessages()]
    in_order = sorted(range(len(TIMES)), key=lambda n: (TIMES[n], n))
    assert rows == [(TIMES[n], wires[n]) for n in in_order]
