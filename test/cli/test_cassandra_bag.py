# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag as it is typed: output, errors, exit status."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from bag.truth import read_with_rosbag, string_connection, string_wire

from cassandra_ros.cli import cassandra_bag
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.store.tables.directory import BucketTotals

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("verb", cassandra_bag.VERBS)
def test_every_verb_explains_itself(verb, capsys):
    with pytest.raises(SystemExit) as ended:
        cassandra_bag.main([verb, "--help"])
    assert ended.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    assert cassandra_bag.VERBS[verb].__doc__.strip().splitlines()[0] in text
    for option in ("--host", "--port", "--keyspace", "CASSANDRA_ROS_HOST"):
        assert option in text


@pytest.mark.suite("all", "it converts several times")
def test_convert(call, tmp_path):
    with BagWriter(tmp_path / "a.bag") as writer:
        numbers = [writer.connection(string_connection(name)) for name in ("/a", "/b")]
        for n in range(10):
            writer.write(numbers[n % 2], n, string_wire(str(n)))
    assert call("import", tmp_path / "a.bag")[0] == 0
    status, text, err = call("convert", "a", "/b", "/a", "--format", "packed")
    assert (status, err) == (0, "")
    lines = text.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("topic /a: 5 messages converted to format packed (")
    assert call("verify", tmp_path / "a.bag")[0] == 0
    again = call("convert", "/b", "--format", "packed")
    assert again == (0, "topic /b: is kept in format packed already\n", "")
    assert call("convert", "/a", "--format", "ros", "-q") == (0, "", "")
    # An import that is repeated goes where the messages are now.
    assert call("import", tmp_path / "a.bag")[0] == 0
    assert call("verify", tmp_path / "a.bag")[0] == 0
    assert "messages:  10 of 2 topics" in call("info")[1]
    status, _, err = call("convert", "/c", "--format", "ros")
    assert (status, err.count("\n")) == (1, 1)
    assert call("convert", "/a", "--format", "xml")[0] == 2
    assert call("convert", "/a")[0] == 2


def test_export_of_what_satisfies_a_condition(call, tmp_path):
    with BagWriter(tmp_path / "a.bag") as writer:
        numbers = [writer.connection(string_connection(name)) for name in ("/a", "/b")]
        for n in range(10):
            writer.write(numbers[n % 2], n, string_wire(f"{n} 'x:=y'"))
    assert call("import", tmp_path / "a.bag")[0] == 0
    out = tmp_path / "out.bag"
    condition = "/a: data LIKE '4 %' OR data = '6 ''x:=y'''"
    status, text, err = call("export", out, "--where", condition, "--where", "b:data > '5'")
    assert (status, err) == (0, "")
    assert ["/a", "2"] in [line.split() for line in text.splitlines()]
    expected = [m for m in read_with_rosbag(tmp_path / "a.bag")[1] if m.t_ns in (4, 5, 6, 7, 9)]
    assert read_with_rosbag(out)[1] == expected
    status, _, err = call("export", out, "-f", "--where", "/a: data < 'x' AND 7")
    assert status == 1
    # Behind the 7: it may begin a comparison.
    assert err.splitlines()[1:] == ["  data < 'x' AND 7", "                  ^"]
    status, _, err = call("export", out, "-f", "--topics", "/b", "--where", "/a: data = ''")
    assert (status, err.count("\n")) == (1, 1)
    assert "topic /a, which is not among those that are read: /b" in err
    for wrong in (["data > 'x'"], ["/a: "], ["/a: data = ''", "--where", "/a: data = 'x'"]):
        assert call("export", out, "-f", "--where", *wrong)[0] == 2
    assert read_with_rosbag(out)[1] == expected


@pytest.mark.suite("test", "promise 1, by the verbs of a person")
def test_the_main_job(type_in, keyspace, bags, tmp_path):
    path = bags / "turtlesim_tf.bag"
    status, out, err = type_in("import", path, "--format", "ros", "__name:=x", "__log:=/tmp/y")
    assert (status, err) == (0, "")
    assert out.splitlines()[0].split() == ["topic", "messages", "size", "format"]
    assert ["/tf", "2688", "241.5", "KB", "ros"] in [line.split() for line in out.splitlines()]
    assert f"{path}: 8647 messages of 9 topics are in keyspace {keyspace}" in out

    status, out, err = type_in("list")
    assert (status, err) == (0, "")
    assert ["/tf_static", "tf2_msgs/TFMessage", "ros"] in [s.split() for s in out.splitlines()]
    assert type_in("list", ".*turtle1.*")[1].count("\n") == 4

    status, out, err = type_in("info")
    assert (status, err) == (0, "")
    assert "messages:  8647 of 9 topics" in out
    line = next(line for line in out.splitlines() if line.startswith("/turtle1/pose"))
    assert line.split()[1:5] == ["turtlesim/Pose", "ros", "-", "1344"]
    assert "2014-03-31T19:24:48." in line
    assert "turtlesim_tf.bag" in out

    out = tmp_path / "out.bag"
    status, text, err = type_in("export", out)
    assert (status, err) == (0, "")
    assert "8647 messages of 9 topics" in text
    assert read_with_rosbag(out) == read_with_rosbag(path)

    for bag in (path, out):
        status, text, err = type_in("verify", bag)
        assert (status, err) == (0, "")
        assert text.startswith(f"equal: {bag} and keyspace {keyspace}, 8647 messages")


def table_of_topics(text):
    """The words of the lines about topics, from the header on, that info prints."""
    lines = [line.split() for line in text.splitlines()]
    first = next(n for n, words in enumerate(lines) if words[:1] == ["topic"])
    return list(itertools.takewhile(bool, lines[first:]))


def test_info_of_other_keys(call, rosCas):
    from std_msgs.msg import Int64

    rosCas.addTopic("/time").addData(Int64(), key=5)
    assert "key" not in table_of_topics(call("info")[1])[0]
    rosCas.addTopic("/maps", key_format="manual").addData(Int64(), key="kitchen")
    rosCas.addTopic("/ids", key_format="msg_part", key_part="data").addData(Int64())
    lines = table_of_topics(call("info")[1])
    assert lines[0][-2:] == ["bucket", "key"]
    found = [(line[0], line[-1]) for line in lines[1:]]
    assert found == [("/ids", "data"), ("/maps", "manual"), ("/time", "time")]


def test_info_as_yaml(call, bags):
    call("import", bags / "primitive_arrays.bag", "--node-id", "r1")
    status, out, _ = call("info", "/array_test", "--yaml")
    found = yaml.safe_load(out)
    assert status == 0
    assert len(found["topics"]) == 1
    topic = found["topics"][0]
    assert (topic["topic"], topic["node"], topic["messages"]) == ("/array_test", "r1", 20)
    assert (topic["first_ns"], topic["last_ns"]) == (0, 19 * 10**9)
    assert found["runs"][0]["stored"] == {"/array_test": 20}


@pytest.mark.suite("test", "a real bag, beside rosbag")
def test_info_says_what_rosbag_info_says(call, ros_env, bags):
    path = bags / "husky_gps_data.bag"
    assert call("import", path, "-q")[0] == 0
    rosbag = ["rosbag", "info", "--yaml", "--freq", str(path)]
    done = subprocess.run(rosbag, env=ros_env, capture_output=True, text=True, check=True)
    theirs = yaml.safe_load(done.stdout)
    status, out, err = call("info", "-y", "--freq")
    ours = yaml.safe_load(out)
    assert (status, err) == (0, "")
    for key in ("duration", "start", "end"):
        assert ours[key] == pytest.approx(theirs[key], abs=1e-6)
    assert (ours["messages"], ours["types"]) == (theirs["messages"], theirs["types"])
    assert [t["topic"] for t in ours["topics"]] == [t["topic"] for t in theirs["topics"]]
    for mine, wanted in zip(ours["topics"], theirs["topics"]):
        assert (mine["type"], mine["messages"]) == (wanted["type"], wanted["messages"])
        assert mine["connections"] == wanted.get("connections", 1)
        assert mine["frequency"] == pytest.approx(wanted.get("frequency"), rel=1e-4)
    fix = next(t for t in ours["topics"] if t["topic"] == "/fix")
    span = (fix["last_ns"] - fix["first_ns"]) / 1e9
    assert fix["rate_hz"] == pytest.approx(94 / span)
    assert yaml.safe_load(call("info", "-y", "-k", "topics")[1]) == ours["topics"]
    same = json.loads(call("info", "--json", "--freq")[1])
    assert same["topics"] == ours["topics"]
    assert json.loads(call("info", "--json")[1]) == same

    assert call("info", "-y", "-k", "duration")[1] == f"{ours['duration']}\n"
    assert call("info", "--json", "--key", "messages")[1] == "12303\n"
    assert call("info", "-k", "messages")[0] == 2
    status, _, err = call("info", "-y", "-k", "colour")
    assert (status, err.count("\n")) == (1, 1)
    assert "there is no key 'colour'; there are keyspace, duration" in err

    text = call("info", "--freq")[1]
    assert "duration:  38.0s" in text
    assert "start:     2013-05-08T14:06:20.007202774Z (1368021980.007202774)" in text
    assert "clearpath_base/DifferentialOutput  [8f3" not in text
    told = "clearpath_base/DifferentialOutput  [8f32685125452f5bdf68130369af5296]"
    assert told in call("info", "-v")[1]
    header, *rows = table_of_topics(text)
    row = dict(zip(header, next(words for words in rows if words[0] == "/fix")))
    assert (row["messages"], row["rate"]) == ("95", f"{94 / span:.1f}")
    assert call("info")[1] == text


def test_info_of_a_hundred_million_messages_reads_none_of_them(call, rosCas):
    """The numbers come from the directory: here it lists messages that were never stored."""
    with rosCas.messageWriter() as writer:
        handle = writer.connect(string_connection("/many"))
        writer.write(handle, 0, 0, string_wire("x"))
        handle = writer.connect(string_connection("/twice"))
        for n, seconds in enumerate((0, 1, 2, 10**9, 10**9 + 0.5, 10**9 + 1)):
            writer.write(handle, int(seconds * 10**9), n, string_wire("x"))
    (table,) = rosCas.getTopic("/many").tables
    totals = BucketTotals()
    totals.add(1_000_000, 10**9, 1000, (5 * 10**9, 10**18), False)
    for writer_id in range(100, 200):
        rosCas.catalog.keyspace.directory.mark(
            (table.name, "", 0, writer_id), 0, (), totals, closed=True
        )
    status, out, _ = call("info", "/twice", "--json", "--freq")
    # Four periods in three seconds; the pause before the second run does not count.
    assert json.loads(out)["topics"][0]["rate_hz"] == pytest.approx(4 / 3)
    status, out, _ = call("info", "/many")
    assert status == 0
    assert "messages:  100000001 of 1 topic\n" in out
    assert "duration:  31.7 years (1000000000s)" in out


def test_verify_prints_the_first_differences(call, rosCas, bags):
    path = bags / "primitive_arrays.bag"
    call("import", path)
    rosCas.getTopic("/array_test").removeData(3 * 10**9, 5 * 10**9)
    status, out, _ = call("verify", path)
    assert status == 1
    assert "3 messages differ from the store, 17 are equal" in out
    assert "/array_test at 1970-01-01T00:00:03.000000000Z: message 3 of the bag is not" in out
    assert call("verify", path, "--quiet")[0] == 1


def test_verify_content_with_mapped_topics(call, rosCas, tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        number = writer.connection(string_connection("/rosout"))
        for i in range(5):
            writer.write(number, i, string_wire(f"text {i}"))
    with rosCas.messageWriter() as writer:
        handle = writer.connect(string_connection("/husky/rosout", callerid="/play"))
        for i in range(5):
            writer.write(handle, 10**18 + i, i, string_wire(f"text {i}"))
    mapped = ("--map", "/rosout:=/husky/rosout")
    status, out, err = call("verify", "--content", path, *mapped, "__name:=x")
    assert (status, err) == (0, "")
    assert "5 messages (type, md5sum, bytes, order in each topic)" in out
    assert call("verify", "--content", path)[0] == 1
    assert call("verify", path)[0] == 1
    status, _, err = call("verify", path, *mapped)
    assert status == 2
    assert "--map goes with --content" in err
    assert call("verify", "--content", path, "--map", "nothing")[0] == 2


@pytest.mark.suite("test", "the options of import that choose")
def test_parts_of_a_bag(call, bags, tmp_path):
    path = bags / "husky_gps_data.bag"
    status, out, _ = call("import", path, "--topics", "/fix", "gps", "--node-id", "husky")
    assert status == 0
    assert "190 messages of 2 topics" in out
    assert call("verify", path, "--topics", "/fix", "/gps")[0] == 0
    assert call("verify", path)[0] == 1
    target = tmp_path / "out.bag"
    assert (
        call("export", target, "--topics", "fix", "--start", "2013-05-08T14:06:30Z", "-j")[0] == 0
    )
    expected = [
        m for m in read_with_rosbag(path)[1] if m.topic == "/fix" and m.t_ns >= 1368021990 * 10**9
    ]
    assert read_with_rosbag(target)[1] == expected
    assert call("export", target)[0] == 1
    assert call("export", target, "--force", "--quiet", "--node-id", "husky")[:2] == (0, "")
    assert len(read_with_rosbag(target)[1]) == 190


@pytest.mark.suite("test", "each way to write a time")
def test_times_as_rosbag_users_write_them(call, bags, tmp_path):
    path, out = bags / "husky_gps_data.bag", tmp_path / "out.bag"
    assert call("import", path, "--topics", "/fix")[0] == 0
    messages = [m for m in read_with_rosbag(path)[1] if m.topic == "/fix"]
    first = 1368021990
    expected = [m for m in messages if first * 10**9 <= m.t_ns <= (first + 5) * 10**9]
    assert 0 < len(expected) < len(messages)
    for start in (first, f"{first}.0", first * 10**9, "2013-05-08T14:06:30", " 1368021990"):
        for end in (first + 5, (first + 5) * 10**9, "2013-05-08T16:06:35+02:00"):
            assert call("export", out, "-f", "-q", "--start", start, "--end", end) == (0, "", "")
            assert read_with_rosbag(out)[1] == expected


def test_an_empty_export_is_an_error_and_leaves_the_old_bag(call, bags, tmp_path):
    path, out = bags / "primitive_arrays.bag", tmp_path / "out.bag"
    call("import", path, "--node-id", "r1")
    out.write_bytes(b"precious")
    cases = [
        (("--start", "1368021980"), "reach from 1970-01-01T00:00:00.000000000Z to 1970-01-01"),
        (("--end", "5", "--start", "5.000000001"), "--start 5.000000001 is after --end 5"),
        (("--node-id", "r2"), "none is of node 'r2', but of 'r1'"),
        (("--start", "4294967296"), "--start '4294967296' is not a time of ROS: write seconds"),
        (("--end", "99999999999999999999"), "nanoseconds, which are taken for such from 13 digits"),
        (("--end", ""), "--end '' is not a time"),
    ]
    for words, text in cases:
        status, _, err = call("export", out, "-f", *words)
        lines = err.splitlines()
        # A warning names the robot that is nearest, or says how far away the time is.
        warned = words[-1] in ("r2", "1368021980")
        assert (status, len(lines)) == (1, 2 if warned else 1), (words, err)
        assert text in lines[-1]
        assert out.read_bytes() == b"precious"
        assert [p.name for p in tmp_path.iterdir()] == ["out.bag"]
    status, _, err = call("verify", path, "--content", "--start", "6", "--end", "5")
    assert (status, err) == (1, "cassandra_bag: --start 6 is after --end 5\n")
    assert call("verify", path, "--content", "--start", "0", "--end", "19")[0] == 0
    assert call("verify", path, "--content", "--start", "0", "--end", "18.999")[0] == 1


def test_errors_are_one_line_and_status_1(call, bags, tmp_path):
    cases = [
        (("import", bags / "truncated_header_only.bag"), "rosbag reindex"),
        (("import", tmp_path / "missing.bag"), "No such file"),
        (("import", bags / "primitive_arrays.bag", "--format", "xml"), "no format 'xml'"),
        (("import", bags / "primitive_arrays.bag", "--topics", "/x"), "no topic /x in"),
        (("export", tmp_path / "out.bag", "--topics", "/nothing"), "/nothing"),
        (("export", tmp_path / "out.bag", "--start", "yesterday"), "yesterday"),
        (("info", "/nothing"), "/nothing"),
        (("list", "["), "not a regular expression"),
    ]
    for arguments, text in cases:
        status, _, err = call(*arguments)
        assert status == 1, (arguments, err)
        assert err.startswith("cassandra_bag: "), err
        assert err.count("\n") == 1, err
        assert text in err
        assert not (tmp_path / "out.bag").exists()


@pytest.mark.suite("all", "make test asks others of its kind")
def test_reading_makes_no_keyspace(type_in, cql, new_keyspace, tmp_path):
    for arguments in (("list",), ("info",), ("export", tmp_path / "out.bag")):
        status, _, err = type_in(*arguments, CASSANDRA_ROS_KEYSPACE=new_keyspace)
        assert status == 1
        assert f"there is no keyspace '{new_keyspace}'" in err
    rows = cql.execute("SELECT keyspace_name FROM system_schema.keyspaces")
    assert new_keyspace not in {row[0] for row in rows}


@pytest.mark.suite("all", "make test asks others of its kind")
def test_reading_makes_no_table(call, cql, bags, new_keyspace, tmp_path):
    cql.execute(
        f"CREATE KEYSPACE {new_keyspace} WITH replication = "
        "{'class': 'SimpleStrategy', 'replication_factor': 1}"
    )
    bag = bags / "primitive_arrays.bag"
    for words in (
        ("list",),
        ("info",),
        ("query", "SELECT * FROM /a"),
        ("export", tmp_path / "out.bag"),
        ("verify", bag),
        ("index", "--list"),
        ("import", tmp_path / "missing.bag"),
    ):
        call(*words, keyspace=new_keyspace)
        rows = cql.execute(
            "SELECT table_name FROM system_schema.tables WHERE keyspace_name = %s", (new_keyspace,)
        )
        assert not rows.all(), words
    assert call("import", bag, keyspace=new_keyspace)[0] == 0
    assert call("verify", bag, keyspace=new_keyspace)[0] == 0


def test_no_server(type_in, bags):
    from cassandra_ros.local_server import free_port

    port = str(free_port())
    status, _, err = type_in("import", bags / "primitive_arrays.bag", CASSANDRA_ROS_PORT=port)
    assert status == 1
    assert f"127.0.0.1 port {port}" in err
    assert "local_cassandra start" in err


def test_wrong_usage_is_status_2(type_in, tmp_path):
    for arguments in ((), ("fly",), ("import",), ("import", "a.bag", "--port", "many")):
        status, _, err = type_in(*arguments)
        assert status == 2
        assert "usage: cassandra_bag" in err
    assert type_in("list", CASSANDRA_ROS_PORT="many")[0] == 2
    assert type_in("export", tmp_path / "a.bag", "-j", "--lz4")[0] == 2


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_reader_that_leaves_is_no_error(env, call, bags):
    call("import", bags / "primitive_arrays.bag")
    done = subprocess.run(
        ["bash", "-c", f"{sys.executable} {ROOT}/scripts/cassandra_bag list | true"],
        env=env,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert "Traceback" not in done.stderr


def test_warnings_of_the_import_are_shown_once(type_in, bags):
    status, out, err = type_in("import", bags / "empty_message_definition.bag", "--format", "ros")
    assert status == 0
    assert err.count("cassandra_bag: topic /led_array_status is kept as binary") == 1
    assert err.count("\n") == 1
    assert out.splitlines()[1].split() == ["/led_array_status", "14", "0", "B", "binary"]


def test_a_topic_that_cannot_be_stored_is_counted_beside_the_others(call, rosCas, tmp_path):
    path, bad = tmp_path / "a.bag", "/b\0ad"
    with BagWriter(path) as writer:
        for topic, count in (("/good", 5), (bad, 3), ("/fine", 2)):
            number = writer.connection(string_connection(topic))
            for i in range(count):
                writer.write(number, i, string_wire(f"{topic} {i}"))
    for _ in range(2):
        status, out, err = call("import", path, path)
        assert status == 1
        assert out.count("7 messages of 2 topics are in") == 2
        lines = err.splitlines()
        assert len(lines) == 2
        assert lines[0].startswith(f"cassandra_bag: {path}: 3 messages are not stored: ")
        assert repr(bad) in lines[0]
        assert "import a copy of the bag in which their topic has another name" in lines[0]
        assert [row.topic for row in rosCas.readMessages()].count("/good") == 5
    assert [dict(run.lost) for run in rosCas.runs()] == [{bad: 3}]
    status, out, _ = call("verify", path)
    assert status == 1
    assert "/b\\x00ad is not stored: its 3 messages are missing" in out
    good = ("--topics", "/good", "/fine")
    assert call("import", path, *good)[::2] == (0, "")
    assert call("verify", path, *good)[0] == 0


def test_names_with_odd_characters_are_printed_safely(call, tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        number = writer.connection(string_connection("/e\x1b[31m\nvil ünï"))
        writer.write(number, 1, string_wire("x"))
    status, out, _ = call("import", path)
    assert status == 0
    assert "/e\\x1b[31m\\nvil ünï" in out
    assert "\x1b" not in call("list")[1] + call("info")[1]
    assert call("verify", path)[0] == 0
