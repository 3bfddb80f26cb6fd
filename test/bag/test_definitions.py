# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Definitions that change, have two names, or are not installed: through recorder and importer."""

from __future__ import annotations

import logging
import struct

import pytest
import rosbag
from bag.truth import read_with_rosbag, string_connection, string_wire
from std_msgs.msg import Int32, String
from tf2_msgs.msg import TFMessage

from cassandra_ros.errors import TypeMismatch
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.files.bag.stored_bag import Bag
from cassandra_ros.messages.classes import message_class, serialize, to_yaml
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.definition import attribute_name, parse_definition
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.playing.play_selection import PlaySelection
from cassandra_ros.playing.play_stream import PlayStream
from cassandra_ros.playing.played_store import PlayedKeyspace
from cassandra_ros.recording.recording import Recording
from cassandra_ros.recording.topic_settings import RecordingSettings, TopicSettings

T0 = 1_500_000_000 * 10**9
every_format = pytest.mark.parametrize("form", FORMAT_NAMES)
two_formats = pytest.mark.parametrize("form", ["binary", "ros"])

OLD_STRING = "string data\nint8 level\n"
THING = "int32 number\nstring[] names\nlost_msgs/Part[] parts\n" + "=" * 80
THING += "\nMSG: lost_msgs/Part\ntime stamp\nfloat32 value\n"
THING_WIRE = b"\1\0\0\0\2\0\0\0hi" + b"\1\0\0\0" + bytes(8) + b"\0\0\x80?"


def header(type_, definition):
    return {
        "type": type_,
        "md5sum": parse_definition(type_, definition).md5sum,
        "message_definition": definition,
        "callerid": "/x",
    }


STRING, INT32 = (header(cls._type, cls._full_text) for cls in (String, Int32))
OLD = header("std_msgs/String", OLD_STRING)


def write_bag(path, messages):
    """Write (header, wire) as messages of topic /t, one a nanosecond; one connection a header."""
    with BagWriter(path) as writer:
        numbers = {}
        for n, (fields, wire) in enumerate(messages):
            key = tuple(sorted(fields.items()))
            if key not in numbers:
                numbers[key] = writer.connection(string_connection("/t", **fields))
            writer.write(numbers[key], T0 + n, wire)
    return path


def warnings(caplog):
    """What we said: the driver, too, may warn, and we do where the server lets us wait."""
    said = [record for record in caplog.records if record.name.startswith("cassandra_ros")]
    return [r.getMessage() for r in said if "trying again" not in r.getMessage()]


def by_import(rosCas, tmp_path, messages, form):
    import_bag(rosCas, write_bag(tmp_path / f"{len(messages)}.bag", messages), format=form)


def by_writer(rosCas, tmp_path, messages, form):
    with rosCas.messageWriter(format=form) as writer:
        for n, (fields, wire) in enumerate(messages):
            writer.write(writer.connect(live_connection("/t", fields)), T0 + n, n, wire)


def by_recorder(rosCas, tmp_path, messages, form):
    times = iter(range(T0, T0 + len(messages)))
    settings = RecordingSettings(TopicSettings(form))
    recorder = Recording(rosCas.catalog, settings=settings, clock=lambda: next(times))
    for fields, wire in messages:
        recorder.received("/t", fields, wire)
    assert sum(report.lost for report in recorder.close()) == 0


@pytest.mark.parametrize(
    ("put", "form"), [(by_import, "ros"), (by_writer, "binary"), (by_recorder, "ros")]
)
def test_a_second_definition_lies_beside_the_first(rosCas, tmp_path, caplog, form, put):
    caplog.set_level(logging.WARNING, "cassandra_ros")
    first = [(STRING, string_wire(f"text {n}")) for n in range(4)]
    put(rosCas, tmp_path, first, form)
    assert warnings(caplog) == []
    both = [part for n in range(5) for part in (first[n % 4], (INT32, serialize(Int32(n))))]
    put(rosCas, tmp_path, both, form)
    (warning,) = warnings(caplog)
    for word in ("/t", "std_msgs/String", String._md5sum, "std_msgs/Int32", Int32._md5sum):
        assert word in warning
    caplog.clear()
    put(rosCas, tmp_path, both, form)
    assert warnings(caplog) == []

    topic = rosCas.getTopic("/t")
    assert len(topic.tables) == 2
    rows = list(topic.rows())
    assert [row.t for row in rows] == sorted(row.t for row in rows)
    for row in rows:
        assert type(row.message()) is (Int32 if row.md5sum == Int32._md5sum else String)
    assert {(i.type, i.md5sum) for i in rosCas.info()} == {
        ("std_msgs/String", String._md5sum),
        ("std_msgs/Int32", Int32._md5sum),
    }
    assert sum(info.count for info in rosCas.info()) == len(rows)
    with pytest.raises(TypeMismatch, match="nothing was stored"):
        topic.addData(TFMessage())
    assert topic.countTopicData() == len(rows)


POINT = "\n" + "=" * 80 + "\nMSG: way_msgs/Point\nfloat64 x\n"
SINGLE, MANY = (header("way_msgs/Way", f"Point{b} p\nint32 n{POINT}") for b in ("", "[]"))


def way(n):
    """Return a message of SINGLE or of MANY, by turns, whose numbers are n and n / 2."""
    one = struct.pack("<d", n / 2)
    wire = one if n % 2 else struct.pack("<I", 2) + 2 * one
    return (SINGLE if n % 2 else MANY), wire + struct.pack("<i", n)


def check_ways(rosCas):
    topic = rosCas.getTopic("/t")
    assert len(topic.tables) == 2
    found = [(m.n, m.p.x if m.n % 2 else [p.x for p in m.p]) for _, m in topic.items()]
    assert found == [(n, n / 2 if n % 2 else [n / 2] * 2) for n in range(6)]
    assert [m.n for _, m in topic.items(where="n >= 3")] == [3, 4, 5]
    assert rosCas.executeCQL("select n from /t where p.x = 1.5") == [(3,)]
    assert sum(info.count for info in rosCas.info(["/t"])) == 6


@pytest.mark.parametrize(
    ("put", "form"),
    [(by_import, "ros"), (by_import, "packed"), (by_writer, "json"), (by_recorder, "packed")],
)
def test_two_definitions_with_one_md5_get_two_tables(rosCas, tmp_path, caplog, form, put):
    """The md5 of ROS leaves out the brackets of an array of messages."""
    assert SINGLE["md5sum"] == MANY["md5sum"]
    messages = [way(n) for n in range(6)]
    put(rosCas, tmp_path, messages, form)
    (warning,) = warnings(caplog)
    assert "p[]" in warning and "single messages" in warning
    check_ways(rosCas)
    if put is by_import:
        path = tmp_path / "6.bag"
        import_bag(rosCas, path)
        check_ways(rosCas)
        assert verify_bag(rosCas, path).equal
        export_bag(rosCas, tmp_path / "out.bag")
        assert read_with_rosbag(tmp_path / "out.bag") == read_with_rosbag(path)


@pytest.mark.suite("all", "a conversion waits until nobody writes")
def test_two_definitions_with_one_md5_keep_two_tables_in_another_format(rosCas, tmp_path):
    by_import(rosCas, tmp_path, [way(n) for n in range(6)], "packed")
    rosCas.convertTopic("/t", "yaml")
    check_ways(rosCas)


def test_a_message_of_another_definition_with_the_same_md5_is_refused(rosCas):
    single, many = (
        message_class(parse_definition("way_msgs/Way", fields["message_definition"]))
        for fields in (SINGLE, MANY)
    )
    topic = rosCas.addTopic("/t")
    topic.addData(single(n=1))
    with pytest.raises(TypeMismatch, match=r"p\[\].*another topic"):
        topic.addData(many(n=2))
    assert [message.n for _, message in topic.items()] == [1]


@pytest.mark.parametrize("added", [True, False])
def test_without_a_usable_definition_the_md5_tells_the_type(rosCas, tmp_path, caplog, added):
    """A publisher with a broken definition does not shut others of its type out."""
    sound = header("tf2_msgs/TFMessage", TFMessage._full_text)
    broken = {**sound, "message_definition": "this is not a definition"}
    by_writer(rosCas, tmp_path, [(broken, serialize(TFMessage()))], "binary")
    caplog.set_level(logging.WARNING, "cassandra_ros")
    topic = rosCas.addTopic("/t", msg_type=TFMessage._type) if added else rosCas.getTopic("/t")
    topic.addData(TFMessage())
    warning = warnings(caplog)[-1]
    assert "without a usable definition" in warning
    assert "single messages" not in warning
    assert topic.countTopicData() == len(list(topic.rows())) == 2
    with pytest.raises(TypeMismatch, match=r"without a usable definition|std_msgs/String"):
        topic.addData(String("x"))


def test_messages_of_another_definition_with_the_same_md5_are_not_played_together(rosCas, tmp_path):
    by_writer(rosCas, tmp_path, [way(n) for n in range(6)], "binary")
    stream = PlayStream(PlayedKeyspace(rosCas.catalog), PlaySelection())
    first, second = stream.channels()
    assert (first.definition, second.definition) == (
        MANY["message_definition"],
        SINGLE["message_definition"],
    )
    assert first.kind != second.kind


def test_a_third_definition_is_one_warning_too(rosCas, tmp_path, caplog):
    caplog.set_level(logging.WARNING, "cassandra_ros")
    messages = [(STRING, string_wire("a")), (INT32, bytes(4)), (OLD, string_wire("b") + b"\7")]
    by_writer(rosCas, tmp_path, messages[:2], "ros")
    caplog.clear()
    by_writer(rosCas, tmp_path, messages, "ros")
    (warning,) = warnings(caplog)
    assert OLD["md5sum"] in warning


@two_formats
def test_two_names_of_a_definition_share_a_table(rosCas, tmp_path, form):
    names = [header(name, TFMessage._full_text) for name in ("tf/tfMessage", "tf2_msgs/TFMessage")]
    wire = serialize(TFMessage())
    path = write_bag(tmp_path / "a.bag", [(names[n % 2], wire) for n in range(6)])
    import_bag(rosCas, path, format=form)
    topic = rosCas.getTopic("/t")
    assert len(topic.tables) == 1
    assert [row.type for row in topic.rows()] == ["tf/tfMessage", "tf2_msgs/TFMessage"] * 3
    assert [m._type for _, m in topic.items()] == ["tf/tfMessage", "tf2_msgs/TFMessage"] * 3
    export_bag(rosCas, tmp_path / "out.bag")
    assert read_with_rosbag(tmp_path / "out.bag") == read_with_rosbag(path)


@every_format
def test_a_type_that_is_not_installed_is_one_like_any(rosCas, tmp_path, form):
    fields = header("lost_msgs/Thing", THING)
    messages = [(fields, n.to_bytes(4, "little") + THING_WIRE) for n in range(5)]
    path = write_bag(tmp_path / "a.bag", messages)
    import_bag(rosCas, path, format=form)
    topic = rosCas.getTopic("/t")
    found = [message for _, message in topic.items()]
    assert [(m._type, m.number, m.names, m.parts[0].value) for m in found] == [
        ("lost_msgs/Thing", n, ["hi"], 1.0) for n in range(5)
    ]
    assert {"number: 3", "names:", "    value: 1.0"} <= {
        line.rstrip() for line in to_yaml(found[3]).splitlines()
    }
    assert rosCas.executeCQL("select number, parts.value from /t where number > 2") == [
        (3, 1.0),
        (4, 1.0),
    ]
    # Its objects can be stored again.
    key = topic.addData(found[2], key=T0 + 10)
    assert topic.getData(key) == found[2]
    topic.removeData(key)
    export_bag(rosCas, tmp_path / "out.bag")
    assert read_with_rosbag(tmp_path / "out.bag") == read_with_rosbag(path)


@two_formats
def test_an_installed_name_with_another_definition_is_read_by_the_stored_one(
    rosCas, tmp_path, form
):
    messages = [(OLD, string_wire("old") + b"\5"), (STRING, string_wire("new"))]
    path = write_bag(tmp_path / "a.bag", messages)
    import_bag(rosCas, path, format=form)
    old, new = (message for _, message in rosCas.getTopic("/t").items())
    assert type(new) is String
    assert type(old) is not String
    assert (old._type, old._md5sum, old.data, old.level) == (*list(OLD.values())[:2], "old", 5)
    assert rosCas.executeCQL("select level from /t where level = 5") == [(5,)]
    export_bag(rosCas, tmp_path / "out.bag")
    assert read_with_rosbag(tmp_path / "out.bag") == read_with_rosbag(path)


def told_by_rosbag(path):
    with rosbag.Bag(str(path)) as bag:
        return [(topic, str(message), t.to_nsec()) for topic, message, t in bag]


def check_read(rosCas, path):
    """Check that the messages are as rosbag reads them, and that an export gives the same bag."""
    with Bag(str(path), rosCas=rosCas) as bag:
        assert [(topic, str(m), t.to_nsec()) for topic, m, t in bag] == told_by_rosbag(path)
        raw = [message[:3] for _, message, _ in bag.read_messages(raw=True)]
    with rosbag.Bag(str(path)) as bag:
        assert raw == [message[:3] for _, message, _ in bag.read_messages(raw=True)]
    assert verify_bag(rosCas, path).equal
    export_bag(rosCas, path.parent / "out.bag")
    assert read_with_rosbag(path.parent / "out.bag") == read_with_rosbag(path)


PART = "=" * 80 + "\nMSG: lost_msgs/Part\ntime stamp\nfloat32 value\n"


@two_formats
def test_a_type_defined_twice_is_read(rosCas, tmp_path, caplog, form):
    """Some converters append the text of a type each time that the type is used."""
    caplog.set_level(logging.WARNING, "cassandra_ros")
    fields = {**header("lost_msgs/Thing", THING), "message_definition": THING + "\n" + PART}
    path = write_bag(tmp_path / "a.bag", [(fields, bytes(4) + THING_WIRE)] * 3)
    assert import_bag(rosCas, path, format=form).topics["/t"].format == form
    assert warnings(caplog) == []
    check_read(rosCas, path)
    assert rosCas.executeCQL("select parts.value from /t") == [(1.0,)] * 3


@two_formats
@pytest.mark.parametrize("stated", ["0" * 32, "*", Int32._md5sum])
def test_a_definition_is_read_where_the_md5sum_is_of_another(
    rosCas, tmp_path, caplog, form, stated
):
    """As by rosbag, with one warning however many publishers there are."""
    caplog.set_level(logging.WARNING, "cassandra_ros")
    wrong = [{**STRING, "md5sum": stated, "callerid": name} for name in ("/x", "/y")]
    messages = [(wrong[n % 2], string_wire(f"text {n}")) for n in range(5)]
    messages.append((STRING, string_wire("of a sound connection")))
    path = write_bag(tmp_path / "a.bag", messages)
    report = import_bag(rosCas, path, format=form)
    assert (report.topics["/t"].format, report.messages, report.lost) == (form, 6, {})
    (warning,) = report.warnings
    assert warnings(caplog) == [warning]
    for word in ("/t", "std_msgs/String", repr(stated), String._md5sum):
        assert word in warning
    topic = rosCas.getTopic("/t")
    assert len(topic.tables) == 1
    assert [type(message) for _, message in topic.items()] == [String] * 6
    assert rosCas.executeCQL("select data from /t where data = 'text 3'") == [("text 3",)]
    check_read(rosCas, path)
    assert import_bag(rosCas, path).messages == 6
    assert topic.countTopicData() == 6
    topic.addData(String("by hand"))


@two_formats
def test_keywords_number_signs_and_line_ends_of_windows_do_not_matter(rosCas, tmp_path, form):
    text = "# of a driver\r\nstring SIGN=# is not a comment\r\nint32 class # its class\r\n"
    text += 'float64 from\r\nstring[] lambda  # "#"\r\n'
    wire = struct.pack("<idI", 7, 1.5, 1) + string_wire("#")
    path = write_bag(tmp_path / "a.bag", [(header("odd_msgs/Odd", text), wire)])
    assert import_bag(rosCas, path, format=form).topics["/t"].format == form
    message = rosCas.getTopic("/t").getData(T0)
    assert message.SIGN == "# is not a comment"
    names = map(attribute_name, ("class", "from", "lambda"))
    assert [getattr(message, name) for name in names] == [7, 1.5, ["#"]]
    assert rosCas.executeCQL('select class, "from", lambda from /t') == [(7, 1.5, ["#"])]
    check_read(rosCas, path)


def test_two_definitions_under_one_md5sum_are_two_tables(rosCas, tmp_path):
    """rosbag reads both by the first; by their own texts both fit."""
    wrong = [{**each, "md5sum": "0" * 32} for each in (STRING, INT32)]
    path = write_bag(tmp_path / "a.bag", [(wrong[0], string_wire("a")), (wrong[1], bytes(4))])
    import_bag(rosCas, path, format="ros")
    topic = rosCas.getTopic("/t")
    assert {type(message) for _, message in topic.items()} == {String, Int32}
    assert len(topic.tables) == 2
    assert verify_bag(rosCas, path).equal


def test_a_recorded_topic_is_read_where_the_md5sum_is_of_another(rosCas, tmp_path, caplog):
    caplog.set_level(logging.WARNING, "cassandra_ros")
    fields = {**INT32, "md5sum": "0" * 32}
    by_recorder(rosCas, tmp_path, [(fields, serialize(Int32(n))) for n in range(3)], "ros")
    assert [message.data for _, message in rosCas.getTopic("/t").items()] == [0, 1, 2]
    assert len(warnings(caplog)) == 1
