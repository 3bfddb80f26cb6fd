# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A stored topic stays in its format for all writers that do not request another one."""

from __future__ import annotations

import pytest
from bag.truth import STRING_MD5, string_connection, string_wire
from std_msgs.msg import String

from cassandra_ros.cli import cassandra_bag
from cassandra_ros.cli import recorder as recorder_cli
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.recording.recording import Recording
from cassandra_ros.recording.topic_settings import RecordingSettings, TopicSettings

HEADER = {"type": "std_msgs/String", "md5sum": STRING_MD5, "message_definition": "string data\n"}
BROKEN = {**HEADER, "message_definition": "string data\nno_type\n"}


def record(rosCas, folder, format):
    recorder = Recording(rosCas.catalog, settings=RecordingSettings(TopicSettings(format)))
    recorder.received("/scan", HEADER, string_wire("recorded"))
    (report,) = recorder.close()
    assert report.stored == 1


def bring_in(rosCas, folder, format):
    path = folder / "scan.bag"
    with BagWriter(path) as bag:
        number = bag.connection(string_connection("/scan"))
        bag.write(number, 10**18, string_wire("imported"))
    report = import_bag(rosCas, path, format=format)
    assert report.topics["/scan"].messages == 1


def write(rosCas, folder, format):
    with rosCas.messageWriter(format=format) as writer:
        handle = writer.connect(api_connection("/scan", definition_of(String), "/x"))
        writer.write(handle, 10**18, 0, serialize(String("written")))


def add(rosCas, folder, format):
    rosCas.addTopic("/scan", format, msg_type="std_msgs/String").addData(String("added"))


def add_to_found(rosCas, folder, format):
    rosCas.addTopic("/scan", format).addData(String("added"))


WRITERS = [record, bring_in, write, add, add_to_found]


@pytest.mark.parametrize("asked, told", [(3600, False), (60, True), (0, True)])
def test_another_lifetime_than_the_stored_one_is_told(rosCas, asked, told):
    rosCas.addTopic("/scan", "binary", msg_type="std_msgs/String", ttl=3600)
    with rosCas.messageWriter(ttl=asked) as writer:
        handle = writer.connect(api_connection("/scan", definition_of(String), "/x"))
        assert handle.table.metadata.ttl == 3600
    text = f"made with a ttl of 3600 s, and that holds for what is stored now, not {asked} s"
    assert (text in (handle.warning or "")) == told


def formats(rosCas):
    return sorted(table.metadata.format for table in rosCas.getTopic("/scan").tables)


def said(caplog):
    """What was said of the topic; of a store that is busy more may be."""
    texts = [record.getMessage() for record in caplog.records]
    return [text for text in texts if "/scan" in text]


@pytest.mark.parametrize("another", WRITERS)
def test_unasked_a_topic_stays_in_its_format(rosCas, tmp_path, caplog, another):
    rosCas.addTopic("/scan", "json").addData(String("first"), key=1)
    another(rosCas, tmp_path, None)
    assert formats(rosCas) == ["json"]
    assert len(list(rosCas.getTopic("/scan").items())) == 2
    assert not said(caplog)


@pytest.mark.parametrize("another", WRITERS)
def test_a_format_that_is_named_is_taken_and_said(rosCas, tmp_path, caplog, another):
    rosCas.addTopic("/scan", "json").addData(String("first"), key=1)
    another(rosCas, tmp_path, "yaml")
    assert formats(rosCas) == ["json", "yaml"]
    assert len(list(rosCas.getTopic("/scan").items())) == 2
    (warning,) = said(caplog)
    assert "/scan is stored in format json and goes on in format yaml" in warning


@pytest.mark.parametrize("another", WRITERS)
def test_a_new_topic_is_kept_as_ros(rosCas, tmp_path, another):
    another(rosCas, tmp_path, None)
    assert formats(rosCas) == ["ros"]


@pytest.mark.parametrize("newest", ["json", "yaml"])
def test_of_several_formats_the_newest_is_kept(rosCas, tmp_path, newest):
    for name in ("json", "yaml"):
        rosCas.addTopic("/scan", name).addData(String("first"), key=1)

    def date(metadata):
        return metadata.with_(date=f"20{30 if metadata.format == newest else 29}-01-01T00:00:00")

    rosCas.catalog.keyspace.schema.change_topic("/scan", date)
    for another in (record, write, add, add_to_found):
        another(rosCas, tmp_path, None)
    rosCas.getTopic("/scan").addData(String("added"))
    counts = {info.format: info.count for info in rosCas.info()}
    assert counts == {"json": 1, "yaml": 1, newest: 6}


def test_one_publisher_without_a_definition_does_not_decide_for_all(rosCas, tmp_path):
    rosCas.addTopic("/scan", "json").addData(String("first"), key=1)
    recorder = Recording(rosCas.catalog)
    recorder.received("/scan", BROKEN, string_wire("broken"))
    assert recorder.close()[0].stored == 1
    assert formats(rosCas) == ["binary", "json"]
    for another in WRITERS:
        another(rosCas, tmp_path, None)
    assert {info.format: info.count for info in rosCas.info()} == {"binary": 1, "json": 6}


def test_what_goes_on_after_it_was_removed_keeps_its_format(rosCas):
    with rosCas.messageWriter(format=None) as writer:
        rosCas.addTopic("/scan", "json").addData(String("first"), key=1)
        handle = writer.connect(api_connection("/scan", definition_of(String), "/x"))
        rosCas.removeTopic("/scan")
        writer.write(handle, 10**18, 0, serialize(String("second")))
    assert formats(rosCas) == ["json"]


def test_on_the_command_line_nobody_names_a_format_unasked():
    for words in (["/scan"], ["/scan", "--format", ""]):
        assert recorder_cli.make_parser().parse_args(words).format is None
    assert recorder_cli.make_parser().parse_args(["/scan", "--format", "yaml"]).format == "yaml"
    assert cassandra_bag.make_parser().parse_args(["import", "a.bag"]).format is None


def test_a_repeated_import_goes_where_its_rows_lie(rosCas, tmp_path):
    bring_in(rosCas, tmp_path, "json")
    record(rosCas, tmp_path, "binary")  # from now on the topic goes on in this one
    bring_in(rosCas, tmp_path, None)
    assert formats(rosCas) == ["binary", "json"]
    assert rosCas.getTopic("/scan").countTopicData() == 2
