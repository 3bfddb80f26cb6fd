# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Random bags come back from every format byte for byte, as the rosbag module reads them.

A bag has several connections, some of one topic with different types, headers as no publisher of
ours sends them, stamps that are equal or run back, messages that do not fit their definition or
need chunks of their own, and one of the compressions.
"""

from __future__ import annotations

import random

import genpy.dynamic
import pytest
from bag.truth import read_with_rosbag, string_connection, string_wire
from compiled import packed_by_rosbag
from messages.random_wire import DefinitionMaker, WireMaker, fuzzed
from suites import FEW_FORMATS, examples, sparing

from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.connection_header import Connection, live_connection
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.metadata import FORMAT_NAMES

SEC = 10**9
TOPICS = ("/tf", "no_slash", "/camera/image raw", "/käse", "/'; DROP\"", "/a//b")
FIELDS = (
    {"callerid": "/node"},
    {"callerid": b"\xff\0\xfe".decode("latin-1"), "latching": "1"},
    {"latching": "0", "tcp_nodelay": "1", "überall": "☃ = ☃"},
    {},
)
STARTS = (0, 1, 1_400_000_000 * SEC, 2**31 * SEC, MAX_NS - 10**12)
STEPS = (0, 1, SEC // 1000, SEC, 3600 * SEC)


class BagMaker:
    """Writes one random bag; the same seed gives the same bag."""

    def __init__(self, seed):
        self.random = random.Random(seed)

    def write(self, path):
        """Write it; return its messages as (connection, time, wire bytes) in the bag's order."""
        rand, messages = self.random, []
        kind, chunk = rand.choice(packed_by_rosbag()), rand.choice((500, 5000, 768 * 1024))
        with BagWriter(path, compression=kind, chunk_bytes=chunk) as writer:
            sources = [self._connection() for _ in range(rand.randint(1, 7))]
            numbers = [writer.connection(connection) for connection, _ in sources]
            each = range(len(sources))
            turns = [*each, *rand.choices(each, k=rand.choice((3, 120)))]
            for turn, t_ns in zip(turns, self._times(len(turns))):
                wire = sources[turn][1]()
                writer.write(numbers[turn], t_ns, wire)
                messages.append((turn, t_ns, wire))
        return messages

    def _times(self, count):
        t_ns, step = self.random.choice(STARTS), self.random.choice(STEPS)
        for _ in range(count):
            yield t_ns
            moved = t_ns + self.random.choice((0, 0, 1, 1, 1, 2, -1)) * step
            t_ns = min(max(moved, 0), MAX_NS)

    def _connection(self):
        """Return a connection and what makes its messages."""
        rand = self.random
        topic, fields = rand.choice(TOPICS), rand.choice(FIELDS)
        if rand.random() < 0.3:
            texts = ["", "a", "b" * 3000, "c" * 600_000]
            weights = (5, 5, 5, 1)
            return string_connection(topic, **fields), lambda: string_wire(
                rand.choices(texts, weights)[0]
            )
        definition = self._definition()
        header = {"topic": topic, "type": definition.type, "md5sum": definition.md5sum}
        header.update(message_definition=definition.text, **fields)
        items = list(header.items())
        rand.shuffle(items)
        maker = WireMaker(definition, rand.getrandbits(32), odd=rand.random() < 0.5)

        def make():
            wire = maker.make()
            return fuzzed(wire, rand.getrandbits(32)) if rand.random() < 0.1 else wire

        return Connection(topic, live_connection(topic, dict(items)).header), make

    def _definition(self):
        """Return a random definition of which genpy can make a class: rosbag needs one."""
        while True:
            seed = self.random.getrandbits(32)
            name, text = DefinitionMaker(seed, depth=seed % 4).make()
            try:
                made = genpy.dynamic.generate_dynamic(name, text)
            except (genpy.MessageException, SyntaxError, ValueError, KeyError):
                continue
            definition = parse_definition(name, text)
            assert definition.md5sum == made[name]._md5sum
            return definition


def compare(path, back, in_order):
    """Compare a bag and its export as rosbag reads them, and the export with what was written."""
    connections, read = read_with_rosbag(path)
    again, exported = read_with_rosbag(back)
    assert again == connections, path
    # rosbag reads equal stamps connection by connection.
    expected = sorted(in_order, key=lambda message: (message[1], message[0]))
    headers = [header for _, _, header in connections]
    assert [(each.t_ns, each.data, each.header) for each in exported] == [
        (t_ns, wire, headers[turn]) for turn, t_ns, wire in expected
    ], path
    # rosbag does not sort a bag whose times run backwards over several chunks.
    assert sorted(exported, key=repr) == sorted(read, key=repr), path


@pytest.mark.suite("all", "a search over random bags")
@pytest.mark.search
@pytest.mark.parametrize("form", sparing(FORMAT_NAMES, FEW_FORMATS, "campaign"))
def test_a_random_bag_comes_back_as_it_was(fresh, tmp_path, form, record_property):
    bags, count = examples(4), 0
    # Each format has bags of its own; their number is the seed.
    for seed in range(list(FORMAT_NAMES).index(form), len(FORMAT_NAMES) * bags, len(FORMAT_NAMES)):
        path, back = tmp_path / f"{seed}.bag", tmp_path / f"{seed}_back.bag"
        messages = BagMaker(seed).write(path)
        with fresh() as rosCas:
            report = import_bag(rosCas, path, format=form)
            assert (report.messages, report.lost) == (len(messages), {}), seed
            verified = verify_bag(rosCas, path)
            assert verified.equal and verified.equal_messages == len(messages), (seed, verified)
            rows = [(row.t, row.wire) for row in rosCas.readMessages()]
            in_order = sorted(messages, key=lambda message: message[1])
            assert rows == [(t_ns, wire) for _, t_ns, wire in in_order], seed
            export_bag(rosCas, back)
        compare(path, back, in_order)
        count += len(messages)
    record_property("told", f"{bags} random bags, {count} messages, came back from format {form}")
