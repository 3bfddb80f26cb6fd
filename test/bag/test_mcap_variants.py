# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""MCAP files in all variants of MCAP's conformance suite, read as MCAP's own readers read them."""

from __future__ import annotations

import io
from collections import Counter

import pytest
from bag.mcap_variants import CASES, CHANNELS, CHUNK_INDEX, CHUNKS, PADDING, SCHEMAS, make, variants
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Message
from suites import sparing

from cassandra_ros.errors import BagError
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.mcap_reader import McapReader

VARIANTS = {variant.name: variant for variant in variants()}
FEW = [name for n, name in enumerate(sorted(VARIANTS)) if n % 4 == 0]
"""A quarter: in make test."""
TYPED = ("OneMessage", "TenMessages")


def by_the_library(data, reader_class):
    """Return what a reader of the library gives, in its order."""
    reader = reader_class(io.BytesIO(data))
    return [
        (channel.topic, schema.name, schema.data, message.data, message.log_time)
        + (message.publish_time, message.sequence)
        for schema, channel, message in reader.iter_messages()
    ]


def by_us(path, salvage=False):
    """Return the same by our reader."""
    found = []
    with McapReader(path, salvage) as reader:
        for chunk in range(reader.chunk_count):
            sent = reader.chunk_publish_times(chunk)
            for n, message in enumerate(reader.chunk_messages(chunk)):
                connection = reader.connections[message.number]
                delay = 0 if sent is None else int(sent.delays[n])
                sequence = 0 if sent is None else int(sent.sequences[n])
                definition = connection.definition_text.encode()
                found.append(
                    (connection.topic, connection.type, definition, message.data, message.t_ns)
                    + (message.t_ns + delay, sequence)
                )
        assert reader.message_count == len(found)
        assert reader.salvaged.why == ""
    return found


def test_the_rules_give_as_many_as_the_suite_has():
    cases = Counter(variant.case for variant in VARIANTS.values())
    assert cases == {
        "NoData": 6,
        "OneAttachment": 14,
        "OneMessage": 154,
        "OneMetadata": 14,
        "OneSchemalessMessage": 74,
        "TenMessages": 154,
    }
    assert cases.keys() == CASES.keys()


@pytest.mark.search
@pytest.mark.parametrize("name", sparing(sorted(VARIANTS), FEW))
def test_a_variant_is_read_as_by_the_library(tmp_path, name):
    variant, path = VARIANTS[name], tmp_path / "a.mcap"
    data = make(variant)
    path.write_bytes(data)
    if variant.case == "OneSchemalessMessage":
        with pytest.raises(BagError, match="holds no messages of ROS 1: of topic /example "):
            McapReader(path)
        return
    told = by_the_library(data, NonSeekingReader)
    # If a file has an index of chunks, that reader needs schemas and channels in the summary, too.
    if CHUNK_INDEX not in variant.features or {SCHEMAS, CHANNELS} <= variant.features:
        assert sorted(by_the_library(data, SeekingReader)) == sorted(told)
    assert len(told) == sum(isinstance(record, Message) for record in CASES[variant.case])
    for salvage in (False, True):
        found = by_us(path, salvage)
        assert sorted(found) == sorted(told)  # the library sorts by time, we do not
    with McapReader(path) as reader:
        kinds = {"OneAttachment": "attachments", "OneMetadata": "records of metadata"}
        extra = kinds.get(variant.case)
        assert reader.extras == ({extra: 1} if extra else {})


def test_records_inside_of_chunks_may_be_padded(tmp_path):
    """MCAP's reader in Python takes them for damage, the format allows them."""
    padded = [v for v in VARIANTS.values() if v.case in TYPED and {PADDING, CHUNKS} <= v.features]
    path, messages = tmp_path / "a.mcap", []
    for variant in padded:
        path.write_bytes(make(variant))
        messages.append(by_us(path))
        path.write_bytes(make(variant, inside=True))
        assert by_us(path) == messages[-1]
    assert set(map(len, messages)) == {1, 10}


def test_a_padded_file_is_imported(rosCas, tmp_path):
    name = "TenMessages-ch-chx-mx-pad-rch-rsh-st-sum"
    assert PADDING in VARIANTS[name].features
    path = tmp_path / "a.mcap"
    path.write_bytes(make(VARIANTS[name]))
    assert import_bag(rosCas, path).messages == 10
    report = verify_bag(rosCas, path)
    assert (report.equal, report.equal_messages) == (True, 10)
