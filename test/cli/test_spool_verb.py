# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag spool: what recorders have left is listed, stored, exported, deleted."""

from __future__ import annotations

import json
import os
import shutil

import pytest
from nodes.raw_publisher import header_of, message
from std_msgs.msg import String

from cassandra_ros.files.bag.mcap_reader import McapReader
from cassandra_ros.files.spool.segment_writer import SegmentWriter
from cassandra_ros.files.spool.spool_folder import SpoolFolder
from cassandra_ros.files.spool.spool_label import RunEnd, SpoolLabel
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.recording.topic_settings import RecordingSettings, settings_as_json

T0 = 1_400_000_000 * 10**9


def text(n):
    return message(String(str(n)))


@pytest.fixture
def leave(cassandra, keyspace, tmp_path):
    """Leave a run of ten messages in a spool."""

    def write(writer, keyspace=keyspace):
        folder = SpoolFolder(tmp_path / "spool").begin(writer)
        address = f"{cassandra.host}:{cassandra.port}"
        settings = settings_as_json(RecordingSettings())
        label = SpoolLabel(
            writer, writer, keyspace, address, T0, name=f"run{writer}", settings=settings
        )
        segment = SegmentWriter(folder.new_file(), label)
        connection = live_connection("/text", header_of(String))
        segment.append([(connection, T0 + n, n, text(n)) for n in range(10)])
        segment.finish(RunEnd(T0 + 10**9, {"/text": 10}, {}))
        segment.close()
        folder.release()

    return write


@pytest.fixture
def spool(call, tmp_path):
    return lambda *words: call("spool", *words, "--spool-dir", tmp_path / "spool")


def test_list_and_drain(leave, spool, rosCas):
    assert spool("list")[:2] == (0, "the spool is empty\n")
    leave(7)
    leave(8, keyspace="elsewhere")
    status, out, _ = spool("list")
    assert status == 0
    assert [line.split()[0] for line in out.splitlines()] == ["id", "7", "8"]
    listed = json.loads(spool("list", "--json")[1])
    assert [(each["run"], each["messages"], each["state"]) for each in listed] == [
        ("run7", 10, "left"),
        ("run8", 10, "left"),
    ]
    status, out, err = spool("drain")
    assert (status, out) == (0, "run run7: 10 messages of the spool are stored\n")
    assert "run run8 (8) stays: it belongs to elsewhere at " in err
    assert [row.wire for row in rosCas.getTopic("/text").rows()] == [text(n) for n in range(10)]
    assert spool("drain", "8")[0] == 0
    assert {run.name for run in rosCas.runs()} == {"run7", "run8"}
    assert rosCas.getTopic("/text").countTopicData() == 20
    status, _, err = spool("drain", "9")
    assert status == 1
    assert "has no run 9" in err


def test_export_and_drop(leave, spool, tmp_path):
    leave(7)
    target = tmp_path / "rest.mcap"
    assert spool("export", "7", target)[:2] == (0, f"10 messages written to {target}\n")
    with McapReader(target) as reader:
        assert [each.data for each in reader.messages()] == [text(n) for n in range(10)]
    assert spool("export", "7")[0] == 2
    written = target.read_bytes()
    status, _, err = spool("export", "7", target)
    assert status == 1
    assert f"{target} exists; choose another name" in err
    assert target.read_bytes() == written
    leave(8)
    status, _, err = spool("export", "7", "8")
    assert status == 2
    assert "FILE is missing: 8 is a run" in err
    assert spool("drop", "8", "--yes")[0] == 0
    status, _, err = spool("drop", "7")  # not confirmed
    assert status == 1
    assert "--yes" in err
    assert spool("drop", "7", "--yes")[:2] == (0, "run run7 is deleted from the spool\n")
    assert spool("list")[1] == "the spool is empty\n"


def test_a_run_whose_label_is_damaged_can_be_exported(leave, spool, tmp_path):
    leave(7)
    (path,) = (tmp_path / "spool" / "7").glob("*.mcap")
    content = bytearray(path.read_bytes())
    content[content.index(b'"run7"') + 1] ^= 1
    path.write_bytes(content)
    status, _, err = spool("drain")
    assert status == 1
    assert "cassandra_bag spool export 7 rest.mcap, and import it" in err
    assert spool("export", "7", tmp_path / "rest.mcap")[0] == 0


@pytest.mark.parametrize("how", ["missing", "cut"])
def test_an_export_tells_what_is_missing(cassandra, keyspace, spool, tmp_path, how):
    folder = SpoolFolder(tmp_path / "spool").begin(7)
    label = SpoolLabel(7, 7, keyspace, f"{cassandra.host}:{cassandra.port}", T0)
    connection = live_connection("/text", header_of(String))
    totals = {}
    paths = [folder.new_file() for _ in range(2)]
    for number, path in enumerate(paths):
        segment = SegmentWriter(path, label, totals)
        numbers = range(number * 10, number * 10 + 10)
        segment.append([(connection, T0 + n, n, text(n)) for n in numbers])
        segment.close()
    folder.release()
    paths[0].unlink() if how == "missing" else os.truncate(paths[0], 100)
    status, _, err = spool("export", "7", tmp_path / "rest.mcap")
    assert status == 1
    assert f"{paths[0]} is {how}" in err
    assert "messages are missing, 10 of topic /text" in err


def test_a_run_that_is_recorded_is_left_alone(leave, spool, tmp_path):
    leave(7)
    (held,) = SpoolFolder(tmp_path / "spool").left()
    assert "recording" in spool("list")[1]
    status, _, err = spool("drop", "7", "--yes")
    assert status == 1
    assert "run 7 is being recorded" in err
    leave(8)
    assert spool("drop", "--yes")[:2] == (0, "run run8 is deleted from the spool\n")
    assert spool("drop", "--yes")[:2] == (0, "nothing of the spool is deleted\n")
    held.release()
    assert [each["id"] for each in json.loads(spool("list", "--json")[1])] == ["7"]


def test_a_drop_checks_before_it_asks(leave, spool, tmp_path):
    assert spool("drop") == (0, "nothing of the spool is deleted\n", "")
    leave(7)
    leave(8)
    status, _, err = spool("drop", "7", "9")
    assert status == 1
    assert "has no run 9; it has 7, 8" in err
    assert "Delete" not in err
    other, running = sorted(SpoolFolder(tmp_path / "spool").left(), key=lambda f: f.path.name)
    other.release()
    status, _, err = spool("drop", "7", "8", "--yes")
    assert status == 1
    assert "run 8 is being recorded" in err
    assert "Delete" not in spool("drop", "8")[2]
    assert [each["id"] for each in json.loads(spool("list", "--json")[1])] == ["7", "8"]
    assert "Delete 10 messages of the spool?" in spool("drop")[2]
    running.release()
    assert "Delete 20 messages of the spool?" in spool("drop")[2]
    assert len(list(SpoolFolder(tmp_path / "spool").left())) == 2  # no lock was left behind


def test_a_run_that_cannot_be_deleted_is_told(leave, spool, monkeypatch, tmp_path):
    leave(7)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "rmtree", lambda path, ignore_errors: None)
        status, out, err = spool("drop", "--yes")
        assert (status, out) == (1, "")
        assert f"run run7 stays in the spool: {tmp_path / 'spool' / '7'} cannot be deleted" in err
        assert json.loads(spool("drain", "--json")[1])[0]["complete"] is False
    assert spool("drop", "--yes")[:2] == (0, "run run7 is deleted from the spool\n")


def test_a_drain_that_leaves_something_is_no_success(leave, spool, rosCas, cql):
    leave(7)
    comment = '{"cassandra_ros": {"version": 99}}'
    table = f"{rosCas.keyspace}.newer"
    cql.execute(f"CREATE TABLE {table} (a int PRIMARY KEY) WITH comment = '{comment}'")
    status, out, _ = spool("drain")
    assert status == 1
    assert "run run7: messages of topic /text stay in the spool: " in out
    (told,) = json.loads(spool("drain", "--json")[1])
    assert (told["messages"], told["complete"]) == (0, False)
    cql.execute(f"DROP TABLE {table}")
    assert spool("drain")[:2] == (0, "run run7: 10 messages of the spool are stored\n")
