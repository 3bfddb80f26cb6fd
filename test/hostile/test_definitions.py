# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Changed message definitions, connection headers and table comments."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hostile.mutate import changed_bytes, changed_json, changed_text
from messages.random_wire import DefinitionMaker, installedTypes

from cassandra_ros.errors import CassandraRosError
from cassandra_ros.messages.classes import deserialize, installed_definition, message_class
from cassandra_ros.messages.connection_header import (
    Connection,
    cut_definition,
    join_definition,
    live_connection,
)
from cassandra_ros.messages.definition import parse_definition
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.metadata import FORMAT_NAMES, MetaView, TopicMetadata, from_comment
from cassandra_ros.recording.topic_settings import read_settings
from cassandra_ros.store.tables.schema import TableListing
from cassandra_ros.topics.message_writer import usable_definition
from cassandra_ros.topics.topic_table import definition_in

ROOT = Path(__file__).resolve().parents[2]
WORDS = (
    "int8 uint8 int16 uint64 float32 float64 string bool time duration byte char Header x y_1 _x "
    "std_msgs/Header pkg/T T [] [3] [0] [67108864] [-1] [x] [3][4] = # MSG: 1 -1 1e5 nan true 'a' "
    "serialize deserialize from class self None __init__ _slot_types open('ran','w')"
).split() + ["=" * 80, "\n" + "=" * 80 + "\nMSG: pkg/T\n", "\n", "\n\n", " ", "int8 A=1\n"]
TYPES = installedTypes()


def texts():
    """Real definitions: of installed types, and random ones."""
    found = [installed_definition(name) for name in TYPES[:: max(1, len(TYPES) // 60)]]
    real = [(each.type, each.text) for each in found]
    return real + [DefinitionMaker(seed).make() for seed in range(20)]


@pytest.mark.suite("all", "a search")
def test_definitions(give):
    real = texts()
    names = list(FORMAT_NAMES)

    def attempt(chance):
        kind, text = chance.choice(real)
        definition = parse_definition(kind, changed_text(chance, text, WORDS))
        encoder = format_class(chance.choice(names))(kind, definition.md5sum, definition)
        wire = chance.getrandbits(8 * 40).to_bytes(40, "little")[: chance.randrange(41)]
        encoded = encoder.encode_wire(wire)
        assert encoder.decode_wire(encoded.columns, encoded.raw) == wire
        if chance.random() < 0.05:  # a class takes genpy ten times as long as all the rest
            deserialize(message_class(definition), wire)

    give("definitions", 2000, attempt)


@pytest.mark.suite("all", "a search over changed inputs")
def test_connection_headers(give):
    real = texts()
    names = ["type", "md5sum", "message_definition", "callerid", "latching", "topic", "", "x=y"]

    def attempt(chance):
        kind, text = chance.choice(real)
        fields = {
            "type": kind,
            "md5sum": chance.choice(("*", "0" * 32, "", "\udcff", "x" * 5000)),
            "message_definition": changed_text(chance, text, WORDS),
            "callerid": chance.choice(("/a", "", "é", "\0")),
            "latching": chance.choice(("0", "1", "2", "")),
        }
        for name in names:
            if chance.random() < 0.1:
                fields[name] = chance.choice(WORDS)
            elif chance.random() < 0.1:
                fields.pop(name, None)
        made = live_connection("/x", fields)
        header = changed_bytes(chance, made.header) if chance.random() < 0.7 else made.header
        rest, place, cut = cut_definition(header)
        assert join_definition(rest, place, cut) == header
        connection = Connection("/x", header)
        definition, warning = usable_definition(connection, chance.choice(list(FORMAT_NAMES)))
        # A definition whose md5 is another than the connection says is read, with a warning.
        assert definition is not None or warning is not None
        assert isinstance(connection.latching, bool)
        connection.latched_from(5)

    give("connection headers", 2000, attempt)


@pytest.mark.suite("all", "a search over changed inputs")
def test_table_comments(give):
    real = []
    for kind, text in texts():
        md5sum = parse_definition(kind, text).md5sum
        made = TopicMetadata(
            topic="/x", msg_type=kind, md5sum=md5sum, definition=text, format="ros", bucket_ns=10**9
        )
        more = made.with_(
            indexes={"x": "_ix0"}, index_names={"x": "a"}, replaces=("t_1",), user={"site": "lab"}
        )
        real += [json.loads(made.to_comment()), json.loads(more.to_comment())]
    words = [*WORDS, "packed", "ros", "topic", "msg_part", "_ix0", "_ix99999999999", "t_1", "key"]

    def attempt(chance):
        comment = json.dumps(changed_json(chance, chance.choice(real), words))
        if chance.random() < 0.3:
            comment = changed_text(chance, comment, [*WORDS, "{", "}", "[", '"', "NaN", "Infinity"])
        metadata = from_comment(comment, "t_1")
        if metadata is None:
            return
        listing = TableListing({"t_1": metadata})
        assert isinstance(listing.visible, dict)
        text = metadata.to_comment()  # NaN in it is not equal to itself
        assert from_comment(text, "t_1").to_comment() == text
        assert set(MetaView(metadata, ["a"]))
        definition = definition_in(metadata)
        try:
            encoder = format_class(metadata.format)(metadata.msg_type, metadata.md5sum, definition)
            encoder.encode_wire(b"x")
        except CassandraRosError as exc:
            assert str(exc)

    give("table comments", 4000, attempt)


@pytest.mark.suite("all", "a search over changed inputs")
def test_recorder_settings(give):
    text = (ROOT / "config/recorder.yaml").read_text(encoding="utf-8")
    text = "".join(re.findall(r"(?m)^[^#\n]+(?=#|\n)|\n", text))  # most of it is comments
    assert read_settings(text, "x.yaml")
    words = [*WORDS, "&a", "*a", "!!python/object:os.system", "<<", "- ", ": ", "? ", "{", "]", "|"]

    def attempt(chance):
        read_settings(changed_text(chance, text, words), "x.yaml")

    give("recorder settings", 1500, attempt)
