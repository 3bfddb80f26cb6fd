# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag import of many bags, of damaged ones, and of chosen topics; export to -o."""

from __future__ import annotations

import errno
import json
import os
import shutil
from random import Random

import pytest
from bag.truth import read_with_rosbag, string_connection, string_wire
from keyspaces import new_name

from cassandra_ros import Cassandra
from cassandra_ros.errors import BagError, BagUnindexed
from cassandra_ros.files.bag import message_file
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.local_server import disk
from cassandra_ros.local_server.cluster_settings import (
    change_settings,
    new_settings,
    save_settings,
)


def make_bag(path, topics=("/a", "/b"), count=10, compression="none"):
    with BagWriter(path, compression) as writer:
        numbers = [writer.connection(string_connection(name)) for name in topics]
        for n in range(count):
            t_ns = 10**18 + n * 10**6
            writer.write(numbers[n % len(topics)], t_ns, string_wire(f"{path.name} {n} " * 50))
    return path


def cut(path, name, size):
    target = path.with_name(name)
    target.write_bytes(path.read_bytes()[:size])
    return target


def test_many_bags_with_a_bad_one_among_them(call, tmp_path):
    good, more = make_bag(tmp_path / "1.bag"), make_bag(tmp_path / "4.bag", ("/c",))
    bad = cut(good, "2.bag", good.stat().st_size - 100)
    missing = tmp_path / "3.bag"
    status, out, err = call("import", good, bad, missing, more)
    assert status == 1
    lines = err.splitlines()
    assert len(lines) == 2
    assert all(line.startswith("cassandra_bag: ") for line in lines)
    assert f"{bad} is cut short" in lines[0]
    assert "with --salvage (salvage=True) what it holds is read" in lines[0]
    assert "No such file" in lines[1]
    table = [line.split() for line in out.splitlines()[-5:]]
    assert table == [
        ["file", "messages", "lost", "state"],
        [str(good), "10", "0", "stored"],
        [str(bad), "-", "-", "failed"],
        [str(missing), "-", "-", "failed"],
        [str(more), "10", "0", "stored"],
    ]
    status, out, _ = call("import", bad, more, "--json")
    failed, stored = json.loads(out)["files"]
    assert (status, failed["state"], stored["state"]) == (1, "failed", "stored")
    assert "cut short" in failed["error"]
    assert stored["error"] is None
    assert (stored["messages"], stored["topics"]["/c"]["messages"]) == (10, 10)
    assert call("import", good, more, "-q") == (0, "", "")
    # What is wrong with the command is wrong with every bag: it is said once.
    status, out, err = call("import", good, more, "--format", "xml")
    assert (status, err.count("\n")) == (1, 1)
    assert [line.split()[-1] for line in out.splitlines()[-2:]] == ["failed", "tried"]


def test_salvage_of_a_bag_that_is_cut_short(call, tmp_path):
    whole = make_bag(tmp_path / "whole.bag", count=40)
    bad = cut(whole, "bad.bag", whole.stat().st_size // 2)
    assert call("import", bad)[0] == 1
    status, out, err = call("import", bad, "--salvage")
    assert (status, err.count("\n")) == (1, 1)  # something is lost
    assert f"cassandra_bag: {bad} is cut short or damaged in the chunk" in err
    with BagReader(bad, salvage=True) as reader:
        count, lost = reader.message_count, reader.salvaged.lost_bytes
    assert 10 < count < 30
    told = f"{count} messages up to there are read, at most {lost} bytes after them are lost"
    assert told in err
    assert f"{count} messages of 2 topics are in keyspace" in out
    # Again it ends in the same messages.
    status, out, _ = call("import", bad, "--salvage", "--json")
    (found,) = json.loads(out)["files"]
    assert (found["state"], found["messages"], found["lost_bytes"]) == ("incomplete", count, lost)
    assert len(found["warnings"]) == 1
    target = tmp_path / "out.bag"
    assert call("export", target, "-q")[0] == 0
    expected = read_with_rosbag(whole)[1][:count]
    assert read_with_rosbag(target)[1] == expected
    assert call("verify", bad, "--salvage")[0] == 0
    assert call("verify", bad)[0] == 1


def test_salvage_of_a_bag_that_was_never_closed(call, tmp_path):
    """The file of a recorder that was killed: written by rosbag, not closed."""
    import rosbag
    from std_msgs.msg import String

    path, left = tmp_path / "a.bag", tmp_path / "a.bag.active"
    with rosbag.Bag(str(path), "w", chunk_threshold=2000) as bag:
        for n in range(50):
            bag.write("/a", String(f"{n}" * 50), genpy_time(n))
        bag.flush()
        shutil.copyfile(path, left)  # its header names no index, the last chunk is open
    expected = read_with_rosbag(path)[1]
    with pytest.raises(BagUnindexed, match="with --salvage"):
        BagReader(left)
    status, out, err = call("import", left, "--salvage")
    assert (status, err.count("\n")) == (0, 1)
    assert "no message that the file holds is lost" in err
    assert "50 messages of 1 topic are" in out
    assert [m[1:] for m in read_with_rosbag(path)[1]] == [m[1:] for m in expected]
    target = tmp_path / "out.bag"
    assert call("export", "-o", target)[0] == 0
    assert read_with_rosbag(target)[1] == expected


def genpy_time(n):
    import genpy

    return genpy.Time(1000 + n)


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
def test_a_cut_anywhere_gives_what_stands_before_it(tmp_path, compression):
    path, random = tmp_path / "whole.bag", Random(1)
    with BagWriter(path, compression, chunk_bytes=4000) as writer:
        number = writer.connection(string_connection("/a"))
        for n in range(60):
            writer.write(number, n, string_wire(f"{n} {random.getrandbits(1600):x}"))
    data = path.read_bytes()
    with BagReader(path) as reader:
        expected = list(reader.messages())
        first = reader.chunk_info(0).position
    with BagReader(path, salvage=True) as reader:
        assert list(reader.messages()) == expected
        assert not reader.salvaged.why
    bad, before, steps = tmp_path / "bad.bag", 0, set()
    for size in range(first + 500, len(data), 487):
        bad.write_bytes(data[:size])
        try:
            with BagReader(bad, salvage=True) as reader:
                found = list(reader.messages())
                assert len(found) == reader.message_count
                assert reader.salvaged.why
        except BagError as exc:
            assert "no message that can be salvaged" in str(exc)
            found = []
        assert found == expected[: len(found)]
        assert len(found) >= before
        before = len(found)
        steps.add(before)
    assert before == 60
    # Messages before the cut in a chunk that is not compressed are imported, too.
    assert len(steps) > (40 if compression == "none" else 5)
    # Not only a cut: what is overwritten in the middle ends it, too.
    middle = len(data) // 2
    bad.write_bytes(data[:middle] + b"\xff" * 600 + data[middle + 600 :])
    with BagReader(bad, salvage=True) as reader:
        found = list(reader.messages())
        assert reader.salvaged.lost_bytes >= 600
    assert 0 < len(found) < 60


def test_chosen_topics_in_and_out(call, tmp_path):
    path = make_bag(tmp_path / "a.bag", ("/cam/left", "/cam/right", "/tf"), 30)
    assert call("import", path, "-e", "/cam/.*", "-q") == (0, "", "")
    assert json.loads(call("list", "--json")[1])[-1]["topic"] == "/cam/right"
    assert call("verify", path, "-e", "/cam/(left|right)")[0] == 0
    status, out, _ = call("verify", path, "--json")
    found = json.loads(out)
    assert (status, found["equal"], found["differences"], found["equal_messages"]) == (
        (1, False, 10, 20)
    )
    assert call("import", path, "-q") == (0, "", "")
    target = tmp_path / "out.bag"
    # A file name after --topics is taken for a topic; -o may stand anywhere.
    status, _, err = call("export", "--topics", "/tf", target)
    assert status == 2
    assert "--topics takes all words after it" in err
    status, out, err = call("export", "--topics", "/tf", "-e", "/.*/left", "-o", target, "--json")
    assert (status, err) == (0, "")
    assert json.loads(out)["messages"] == {"/tf": 10, "/cam/left": 10}
    assert {m.topic for m in read_with_rosbag(target)[1]} == {"/tf", "/cam/left"}
    assert call("export", target, "-o", target)[0] == 2
    assert call("export")[0] == 2


def test_large_chunks_need_an_option(call, tmp_path, monkeypatch):
    """What is too large is refused, and the error names the option of import and verify."""
    path = make_bag(tmp_path / "a.bag", compression="bz2")
    monkeypatch.setattr(message_file, "MAX_CHUNK_BYTES", 1000)
    for verb in ("import", "verify"):
        status, _, err = call(verb, path)
        assert (status, err.count("\n")) == (1, 1)
        assert f"{path}: chunk 1 of 1 states " in err
        assert "--allow-large-chunks" in err
        status, out, _ = call(verb, path, "--allow-large-chunks")
        assert status == 0
    assert f"equal: {path}" in out
    assert call("verify", path, "--content", "--allow-large-chunks")[0] == 0
    assert call("verify", path, "--content")[0] == 1


def test_all_bags_of_a_folder(call, tmp_path):
    folder, inner = tmp_path / "drive", tmp_path / "drive" / "inner"
    inner.mkdir(parents=True)
    make_bag(folder / "b.bag", ("/b",), count=1)
    make_bag(folder / "A.BAG", ("/a",), count=1)
    make_bag(inner / "c.bag", ("/c",))
    (folder / "notes.txt").write_text("none of these")
    shutil.copyfile(inner / "c.bag", folder / "d.bag.active")
    status, out, err = call("import", folder)
    assert (status, err) == (0, "")
    assert [line.split()[0] for line in out.splitlines()[-2:]] == [
        str(folder / "A.BAG"),
        str(folder / "b.bag"),
    ]
    assert f"{folder / 'b.bag'}: 1 message of 1 topic is in keyspace" in out
    assert "no robot was named" in out
    assert "no robot was named" not in call("import", folder, "--node-id", "husky")[1]
    assert "/c" not in call("list")[1]
    found = json.loads(call("import", folder, "-r", "--salvage", "--json")[1])
    files = [str(folder / name) for name in ("A.BAG", "b.bag", "d.bag.active", "inner/c.bag")]
    assert [each["path"] for each in found["files"]] == files
    assert "/c" in call("list")[1]


def test_a_folder_without_bags_says_so(call, tmp_path):
    (tmp_path / "inner").mkdir()
    make_bag(tmp_path / "inner" / "c.bag")
    status, out, err = call("import", tmp_path)
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert f"folder {tmp_path} holds no bag or MCAP file (.bag, .mcap); --recursive looks" in err
    status, _, err = call("import", tmp_path / "inner", tmp_path, "--recursive", "-q")
    assert (status, err) == (0, "")


def test_a_keyspace_of_another_program_is_told(call, cassandra, tmp_path):
    make_bag(tmp_path / "a.bag")
    name = new_name()
    with Cassandra(cassandra.host, cassandra.port) as cas:
        cas.execute(
            f"CREATE KEYSPACE {name} WITH replication = "
            "{'class': 'SimpleStrategy', 'replication_factor': 1}",
            what="making a keyspace",
        )
        try:
            assert "another program" not in call("list", keyspace=name)[1]
            cas.execute(f"CREATE TABLE {name}.carts (id int PRIMARY KEY)", what="making a table")
            status, out, _ = call("list", keyspace=name)
            text = f"keyspace {name} is of another program: its tables are carts"
            assert (status, out) == (0, f"keyspace {name} holds no such topic; {text}\n")
            status, _, err = call("import", tmp_path / "a.bag", keyspace=name)
            assert (status, err) == (
                0,
                f"cassandra_bag: {text}; the topics are stored beside them\n",
            )
            # From now on it is ours, too.
            assert call("import", tmp_path / "a.bag", keyspace=name)[2] == ""
            assert "another program" not in call("list", "nothing", keyspace=name)[1]
        finally:
            cas.execute(f"DROP KEYSPACE {name}", what="dropping a keyspace")


def test_what_cannot_be_listed_does_not_stop_the_others(call, tmp_path, monkeypatch):
    good, empty, shut = (tmp_path / name for name in ("good", "empty", "good/shut"))
    for folder in (good, empty, shut):
        folder.mkdir()
    make_bag(good / "a.bag")
    scandir = os.scandir

    def refusing(path):
        if os.fspath(path) == str(shut):
            raise PermissionError(errno.EACCES, "Permission denied", str(shut))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refusing)
    status, out, err = call("import", empty, good, "--recursive")
    assert status == 1
    assert f"folder {empty} holds no bag or MCAP file" in err
    assert f"folder {shut} cannot be read: Permission denied" in err
    table = [line.split() for line in out.splitlines()[-3:]]
    assert table == [
        [str(empty), "-", "-", "failed"],
        [str(shut), "-", "-", "failed"],
        [str(good / "a.bag"), "10", "0", "stored"],
    ]


def test_an_import_of_a_part_keeps_the_counts_of_the_rest(call, rosCas, tmp_path):
    path = make_bag(tmp_path / "x.bag", ("/a", "/b", "/x\0y"), count=30)
    assert call("import", path)[0] == 1  # a topic whose name cannot be stored
    (whole,) = rosCas.runs()
    assert (whole.stored, whole.lost) == ({"/a": 10, "/b": 10}, {"/x\0y": 10})
    assert call("import", path, "--topics", "/a")[0] == 0
    (again,) = rosCas.runs()
    assert (again.stored, again.lost) == (whole.stored, whole.lost)


def test_a_keyspace_is_made_when_all_nodes_of_a_local_cluster_answer(
    call, cassandra, tmp_path, monkeypatch
):
    """Else it would keep one copy of each message for ever."""
    monkeypatch.setenv("CASSANDRA_ROS_DIR", str(tmp_path / "server"))
    (tmp_path / "server").mkdir()
    monkeypatch.setattr(disk, "find_server", lambda config, pid_file: os.getpid())
    three = change_settings(new_settings(), nodes=3, host=cassandra.host, port=cassandra.port)
    save_settings(tmp_path / "server", three)
    make_bag(tmp_path / "a.bag")
    name = new_name()
    status, _, err = call("import", tmp_path / "a.bag", keyspace=name)
    assert status == 1
    assert f"of the 3 nodes of the local Cassandra 1 can be seen, so keyspace {name}, whi" in err
    assert call("import", tmp_path / "a.bag")[0] == 0  # in a keyspace that exists
