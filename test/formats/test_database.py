# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Random messages of all types, in every format, through the real database: equal bytes."""

from __future__ import annotations

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from messages.random_wire import DefinitionMaker, WireMaker, fuzzed, installedTypes
from suites import FEW_FORMATS, SUITE, examples, sparing

from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.metadata import FORMAT_NAMES

SEEDS = st.integers(0, 2**32)

TABLES = 50
"""How many topics one keyspace gets: each table costs the server memory until it is dropped."""
STRETCH_NS = 1000


def checkStored(rosCas, name, definitions, number):
    """Write random messages of all definitions, a topic for each; read back what was written."""
    with rosCas.messageWriter(format=name, linger_sec=0.01) as writer:
        topics = {f"/topic{number}": found for number, found in enumerate(definitions)}
        handles = [writer.connect(api_connection(t, d, "/test")) for t, d in topics.items()]
        assert {handle.format for handle in handles} <= {name, "binary"}
        begins = iter(range(0, 10**9, STRETCH_NS))

        # A seed says enough: shrinking would send all messages again, for minutes.
        @settings(max_examples=number, deadline=None, phases=[Phase.generate])
        @given(seed=SEEDS)
        def check(seed):
            begin = next(begins)
            wires = {}
            for handle, definition in zip(handles, definitions):
                makers = [WireMaker(definition, seed + i, odd=bool(i % 2)) for i in range(4)]
                made = [maker.make() for maker in makers]
                wires[handle.topic] = [*made, fuzzed(made[-1], seed)]
                for i, wire in enumerate(wires[handle.topic]):
                    writer.write(handle, begin + i // 2, begin + i, wire)  # pairs of equal stamps
            writer.flush()
            for topic, expected in wires.items():
                rows = rosCas.getTopic(topic).rows(begin, begin + STRETCH_NS - 1)
                assert [row.wire for row in rows] == expected, topics[topic].type

        check()


@pytest.mark.parametrize("name", sparing(FORMAT_NAMES, kept=FEW_FORMATS))
@pytest.mark.search
def test_every_installed_type_comes_back_equal(fresh, name, record_property):
    types = installedTypes()
    assert len(types) >= 200
    # A table takes longer to make than its messages: a 24th of the types in each of two formats, or
    # each in two of all formats; all in all formats only where there is time.
    step = {"test": 4 * len(FORMAT_NAMES), "all": len(FORMAT_NAMES) // 2, "campaign": 1}[SUITE]
    types = types[list(FORMAT_NAMES).index(name) % step :: step]
    record_property("told", f"{len(types)} message types came back equal in format {name}")
    for first in range(0, len(types), TABLES):
        with fresh() as rosCas:
            batch = [installed_definition(t) for t in types[first : first + TABLES]]
            checkStored(rosCas, name, batch, examples(3, least=3))


@pytest.mark.suite("all", "a search over random types")
@pytest.mark.parametrize("name", sparing(FORMAT_NAMES, kept=FEW_FORMATS))
@pytest.mark.search
def test_random_types_come_back_equal(fresh, name):
    number = {"test": 5, "all": 20, "campaign": 40}[SUITE]
    makers = [DefinitionMaker(seed, depth=seed % 5) for seed in range(number)]
    definitions = [parse_definition(*maker.make()) for maker in makers]
    with fresh() as rosCas:
        checkStored(rosCas, name, definitions, examples(4, least=4))
