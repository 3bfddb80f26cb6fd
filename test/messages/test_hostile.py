# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A definition is text from outside: it runs nothing, writes nothing, and fails in one way."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from messages.random_wire import SEPARATOR

from cassandra_ros.errors import DefinitionError
from cassandra_ros.messages.classes import deserialize, message_class, serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.definition import definition_of, parse_definition, render_spec
from cassandra_ros.messages.formats.table import FALLBACK_FORMAT
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.topics.message_writer import usable_definition

EVIL = "open('ran','w')"


@pytest.fixture(autouse=True)
def nothing_is_written(tmp_path, monkeypatch):
    """Fail a test after which a file lies in the folder, in the temporary one, or in /tmp/foo."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    foo = Path("/tmp/foo")  # where genpy leaves what it could not import
    before = foo.stat().st_mtime_ns if foo.exists() else None
    yield
    assert list(tmp_path.iterdir()) == []
    assert (foo.stat().st_mtime_ns if foo.exists() else None) == before


def full(root, **others):
    return SEPARATOR.join(
        [root, *(f"MSG: {name.replace('__', '/')}\n{text}" for name, text in others.items())]
    )


HOSTILE = {
    "constant name": f"int8 _md5sum;{EVIL};B=1",
    "constant name of a string": f"string x;{EVIL};B=1",
    "constant name with a line end": f"int8 A\r{EVIL}\r=1",
    "integer": f"int8 A={EVIL}",
    "integer by underscore": "int8 A=1_0",
    "integer out of range": "uint8 A=256",
    "negative unsigned": "uint64 A=-1",
    "unicode digits": "int8 A=٣",
    "huge integer": "int64 A=" + "9" * 5000,
    "float": f"float64 A={EVIL}",
    "bool": f"bool A=[{EVIL}]",
    "constant of a time": "time A=1",
    "constant of a message": "std_msgs/String A=1",
    "constant of an array": "int8[] A=1",
    "field name": f"int8 x;{EVIL}",
    "field name with a quote": "int8 x','y",
    "field name that begins with an underscore": "int8 _md5sum",
    "field name of other letters": "int8 größe",
    "field type": f"int8;{EVIL} x",
    "field type with two slashes": "a/b/c x",
    "field type with dots": "os.path/x y",
    "two dimensions": "int8[3][4] x",
    "negative length": "int8[-1] x",
    "length that is a name": "int8[n] x",
    "length without an end": "int8[3 x",
    "only a type": "int8",
    "three words": "int8 x y",
    "the same field twice": "int8 x\nint8 x",
    "field and constant": "int8 x\nint8 x=1",
    "NUL": "int8 x\0",
    "a type inside itself": "pkg/Type x",
    "an array of itself": "Type[] x",
    "unknown type": "pkg/Unknown x",
    "fixed array over 2**26 bytes": "float64[8388609] x",
    "fixed array of ten digits": "uint8[9999999999] x",
    "fixed array of eleven digits": "uint8[99999999999] x",
    "many fixed arrays": "\n".join(f"uint8[33554432] x{i}" for i in range(3)),
    "no name after a separator": "int8 x" + SEPARATOR + "int8 y",
    "separator at the end": "int8 x" + SEPARATOR,
    "hostile name after a separator": "int8 x" + SEPARATOR + f"MSG: pkg/T({EVIL})\nint8 y",
    "a type twice": full("pkg/A x", pkg__A="int8 y") + SEPARATOR + "MSG: pkg/A\nint8 z",
    "a cycle": full("pkg/A x", pkg__A="pkg/B x", pkg__B="pkg/A x"),
    "nested arrays": full("A[8193] x", pkg__A="B[8193] x", pkg__B="int8 x"),
    "arrays of nothing": full("A[2097152] x", pkg__A="B[2097152] x", pkg__B=""),
    "2**64 fields": full("L0 a", **{f"pkg__L{i}": f"L{i + 1} a\nL{i + 1} b" for i in range(63)})
    + SEPARATOR
    + "MSG: pkg/L63\nint8 x",
    "deeper than 64": full("L0 a", **{f"pkg__L{i}": f"L{i + 1} a" for i in range(64)})
    + SEPARATOR
    + "MSG: pkg/L64\nint8 x",
    "257 types": full(
        "\n".join(f"L{i} x{i}" for i in range(257)), **{f"pkg__L{i}": "" for i in range(257)}
    ),
    "too long": "# " + "x" * (1 << 20),
}


@pytest.mark.parametrize("text", HOSTILE.values(), ids=list(HOSTILE))
def test_hostile_text_is_a_definition_error(text):
    with pytest.raises(DefinitionError) as caught:
        parse_definition("pkg/Type", text)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("name", ["", "Type", "a/b/c", f"pkg/T;{EVIL}", "pkg/T\n", "1/T", None, 5])
def test_hostile_type_is_a_definition_error(name):
    with pytest.raises(DefinitionError):
        parse_definition(name, "int8 x")


@pytest.mark.parametrize("text", [None, b"int8 x", 5])
def test_what_is_no_text_is_a_definition_error(text):
    with pytest.raises(DefinitionError):
        parse_definition("pkg/Type", text)


GENPY_FAILS = {
    "method as a field": "int8 serialize",
    "method as another field": "int8 x\nint8 deserialize_numpy",
    "two fields that genpy calls alike": "int8 from\nint8 from_",
    "loops in loops": full("A0[] x", **{f"pkg__A{i}": f"A{i + 1}[] x" for i in range(24)})
    + SEPARATOR
    + "MSG: pkg/A24\nstring s",
    "types that genpy calls alike": full("a__b/c x\na/b__c y")
    + SEPARATOR
    + "MSG: a__b/c\nint8 x"
    + SEPARATOR
    + "MSG: a/b__c\nint16 y",
}


@pytest.mark.parametrize("text", GENPY_FAILS.values(), ids=list(GENPY_FAILS))
def test_where_genpy_fails_there_is_one_kind_of_error(text):
    definition = parse_definition("pkg/Type", text)
    with pytest.raises(DefinitionError, match="genpy cannot"):
        message_class(definition)


@pytest.mark.parametrize("kind", [MemoryError, RecursionError, SyntaxError, KeyError, OSError])
def test_every_failure_of_genpy_is_a_definition_error(kind, monkeypatch):
    def fail(*args):
        raise kind("made for this test")

    monkeypatch.setattr("genpy.generator.msg_generator", fail)
    definition = parse_definition("pkg/Fails", f"int8 {kind.__name__}")
    with pytest.raises(DefinitionError, match=kind.__name__):
        message_class(definition)


HARMLESS = {
    "quotes in a comment": f'# """ + {EVIL} + """\nint8 x',
    "backslash and quotes in a comment": f'# \\""" + {EVIL} + """\nint8 x # \\',
    "string constant": f"string A='+{EVIL}+'\nint8 x",
    "string constant that ends in a backslash": "string A=\\\nint8 x",
    "string constant with both quotes": f'string A="\'\\"+{EVIL}+"\'\nint8 x',
    "no UTF-8": "string A=\udce9\nint8 x # \udcff",
    "constant called as a method": "int8 serialize=1\nint8 mro=2\nint8 x",
    "constant called as a keyword": "int8 class=1\nint8 x",
    "fields called as what genpy uses": "int8 str\nint8 end\nint8 self\nint8 genpy\nstring struct",
    "types called as builtins": full(
        "a/int32 x\na/Header[] y\na/time z", a__int32="int8 x", a__Header="int8 x", a__time="int8 x"
    ),
    "types called as keywords": full("import/class x\nNone/str[] y")
    + SEPARATOR
    + "MSG: import/class\nint8 x"
    + SEPARATOR
    + "MSG: None/str\nstring Message",
    "packages called as modules": full("genpy/Message x\nos/path y\nsys/Time z")
    + SEPARATOR
    + "MSG: genpy/Message\nint8 x"
    + SEPARATOR
    + "MSG: os/path\nint8 x"
    + SEPARATOR
    + "MSG: sys/Time\ntime x",
    "64 deep": full("L0 a", **{f"pkg__L{i}": f"L{i + 1} a" for i in range(63)})
    + SEPARATOR
    + "MSG: pkg/L63\nint8 x",
}


@pytest.mark.parametrize("text", HARMLESS.values(), ids=list(HARMLESS))
def test_text_that_only_looks_hostile_gives_a_class_that_works(text):
    definition = parse_definition("pkg/Type", text)
    generated = message_class(definition)
    assert generated._type == "pkg/Type"
    assert generated._md5sum == definition.md5sum
    assert definition_of(generated) == definition
    wire = serialize(generated())
    assert serialize(deserialize(generated, wire)) == wire


def test_constants_are_set_on_the_class_and_never_generated():
    text = f"string A=';{EVIL}#\nint8 class=3\nint8 x\nint8 serialize=4"
    definition = parse_definition("pkg/Type", text)
    assert "open" not in render_spec(definition.root)
    generated = message_class(definition)
    assert f"';{EVIL}#" == generated.A
    assert generated.class_ == 3
    assert callable(generated.serialize)


def test_hostile_definition_in_a_live_header():
    header = {"type": "pkg/Type", "md5sum": "x", "message_definition": HOSTILE["constant name"]}
    connection = live_connection("/x", header)
    with pytest.raises(DefinitionError):
        parse_definition(connection.type, connection.definition_text, connection.md5sum)


def hostileConnections():
    """A connection for each definition that is refused, here or by genpy."""
    for number, text in enumerate([*HOSTILE.values(), *GENPY_FAILS.values()]):
        md5sum = "0" * 32
        if number >= len(HOSTILE):
            md5sum = parse_definition("pkg/Type", text).md5sum
        header = {"type": "pkg/Type", "md5sum": md5sum, "message_definition": text}
        yield live_connection(f"/hostile{number}", header)


OTHER_FORMATS = [name for name in FORMAT_NAMES if name != FALLBACK_FORMAT]


@pytest.mark.parametrize("name", OTHER_FORMATS)
def test_no_format_uses_a_hostile_definition(name):
    for connection in hostileConnections():
        definition, warning = usable_definition(connection, name)
        assert definition is None
        assert f"topic {connection.topic} is kept as binary" in warning


@pytest.mark.suite("test", "promise 3")
def test_topics_with_hostile_definitions_are_kept_as_binary(rosCas, caplog):
    wires = [b"", b"\0\xff" * 3, b"x" * 5000]
    connections = list(hostileConnections())
    with rosCas.messageWriter() as writer:
        for number, connection in enumerate(connections):
            name = OTHER_FORMATS[number % len(OTHER_FORMATS)]
            handle = writer.connect(connection, format=name)
            writer.connect(connection, format=name)  # as another message does
            assert handle.format == FALLBACK_FORMAT
            for i, wire in enumerate(wires):
                writer.write(handle, i, i, wire)
    # What a writer of another test still says is not looked at.
    said = [r for r in caplog.records if r.name == "cassandra_ros.topics.message_writer"]
    warnings = [r.getMessage() for r in said if r.levelname == "WARNING"]
    warnings = [text for text in warnings if "trying again" not in text]
    assert len(warnings) == len(connections)
    for connection, warning in zip(connections, warnings):
        assert f"topic {connection.topic} is kept as binary" in warning
        rows = list(rosCas.getTopic(connection.topic).rows())
        assert [row.wire for row in rows] == wires
        assert rows[0].connection == connection


SCRAPS = ["int8", "x", "=", "#", "[", "]", "3", "/", "pkg", "MSG:", "\n", " ", "=" * 80, "string"]


@settings(deadline=None)
@given(st.lists(st.sampled_from(SCRAPS) | st.text(max_size=5), max_size=30).map("".join))
def test_any_text_is_a_definition_or_a_definition_error(text):
    try:
        definition = parse_definition("pkg/Type", text)
    except DefinitionError:
        return
    try:
        message_class(definition)
    except DefinitionError:
        pass
