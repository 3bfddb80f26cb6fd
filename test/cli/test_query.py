# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag query and index as they are typed; what they write is read back by others."""

from __future__ import annotations

import base64
import csv
import io
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow
import pyarrow.parquet
import pytest
from geometry_msgs.msg import Twist, Vector3
from std_msgs.msg import Duration, Float32, Int64, String, Time, UInt8MultiArray, UInt64

from cassandra_ros.messages.classes import message_class
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.messages.definition import parse_definition

ROOT = Path(__file__).resolve().parents[2]
T = 1_400_000_000_123_456_789
TEXTS = ["", "plain", 'it\'s "quoted", yes', "two\r\nlines", " spaces ", "Zoë ☃ 𝄞", "-", "\x1b[31m"]


@pytest.fixture
def texts(rosCas):
    topic = rosCas.addTopic("/texts")
    for n, text in enumerate(TEXTS):
        topic.addData(String(text), key=T + n)
    return topic


@pytest.fixture
def numbers(rosCas):
    topic = rosCas.addTopic("/numbers")
    for n, value in enumerate([0.5, math.nan, math.inf, -math.inf, -0.0]):
        topic.addData(Float32(value), key=T + n)
    return topic


def plain(value):
    """A value of executeCQL as csv and json have it."""
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, list):
        return [plain(element) for element in value]
    return value.to_nsec() if hasattr(value, "to_nsec") else value


def test_a_table_is_for_people(call, rosCas, numbers):
    topic = rosCas.addTopic("/mixed")
    topic.addData(Twist(linear=Vector3(x=0.25)), key=T)
    topic.addData(Twist(linear=Vector3(x=-12.5)), key=T + 10**9)
    statement = "SELECT KEY, linear.x AS x, NODE FROM /mixed"
    assert call("query", statement)[:2] == (
        0,
        "KEY                                 x  NODE\n"
        "2014-05-13T16:53:20.123456789Z   0.25\n"
        "2014-05-13T16:53:21.123456789Z  -12.5\n",
    )
    assert call("query", "SELECT data FROM /numbers")[1].split() == [
        *("data", "0.5", "nan", "inf", "-inf", "-0.0"),
    ]
    rosCas.addTopic("/d").addData(Duration(Duration().data.from_sec(-1.5)), key=T)
    assert call("query", "SELECT data FROM /d")[1].splitlines()[1] == "-1.500000000 s"


def test_a_table_is_safe_for_a_terminal_and_cuts(call, rosCas, texts):
    texts.addData(String("x" * 5000), key=T + 100)
    status, out, _ = call("query", "select data from /texts")
    assert status == 0
    assert "\x1b" not in out
    assert "two\\r\\nlines" in out
    assert max(map(len, out.splitlines())) == 120
    assert len(out.splitlines()) == len(TEXTS) + 2
    rosCas.addTopic("/bytes").addData(UInt8MultiArray(data=bytes(3000)), key=T)
    assert "<3000 bytes>" in call("query", "select data from /bytes")[1]


def test_a_table_of_nothing_is_its_header(call, texts):
    assert call("query", "select KEY, data from texts where data = 'z'")[:2] == (0, "KEY  data\n")


def test_a_long_table_keeps_its_first_widths(call, rosCas):
    topic = rosCas.addTopic("/long")
    for n in range(250):
        topic.addData(Int64(n if n < 249 else 10**12), key=n)
    lines = call("query", "select data, NODE from long")[1].splitlines()
    assert lines[:2] == ["data  NODE", "   0"]
    assert lines[249:] == [" 248", "1000000000000"]


STATEMENTS = [
    "SELECT * FROM /tf",
    "SELECT KEY, transforms.child_frame_id, transforms.transform.rotation.w FROM /tf",
    "SELECT KEY, data FROM /texts",
    "SELECT data FROM /texts",
    "SELECT * FROM /odd",
    "SELECT data[5], data, layout.dim FROM /odd",
    "SELECT count(*), min(KEY), max(transforms.transform.rotation.w) FROM /tf",
    f"SELECT KEY FROM /tf WHERE KEY < {10**18}",
]


@pytest.fixture
def stored(call, rosCas, texts, numbers, bags):
    call("import", bags / "turtlesim_tf.bag", "--topics", "/tf", "--format", "ros", "-q")
    odd = rosCas.addTopic("/odd", format="ros")
    for n in range(3):
        odd.addData(UInt8MultiArray(data=bytes(range(n * 4))), key=T + n)
    return rosCas


@pytest.mark.suite("test", "each output of each kind of statement")
def test_every_output_is_what_executecql_returns(call, stored, tmp_path):
    for number, statement in enumerate(STATEMENTS):
        rows = stored.executeCQL(statement)
        assert_csv(call("query", statement, "--output", "csv"), rows)
        assert_json(call("query", statement, "--output", "json"), rows, json.loads)
        lines = call("query", statement, "--output", "ndjson")
        assert_json(lines, rows, lambda out: [json.loads(line) for line in out.splitlines()])
        assert_parquet(parquet(call, tmp_path / f"{number}.parquet", statement), rows)


def assert_csv(done, rows):
    status, out, err = done
    assert (status, err) == (0, "")
    found = list(csv.reader(io.StringIO(out, newline=""), strict=True))
    assert tuple(found[0]) == rows.columns
    assert len(found) == len(rows) + 1
    for line, row in zip(found[1:], rows):
        assert line == [as_csv(value) for value in row]
    assert out.count("\r\n") >= len(rows) + 1


def assert_json(done, rows, read):
    status, out, err = done
    assert (status, err) == (0, "")
    assert read(out) == [dict(zip(rows.columns, map(plain, row))) for row in rows]


def assert_parquet(table, rows):
    assert tuple(table.column_names) == rows.columns
    found = list(zip(*(column_of(table, n) for n in range(table.num_columns))))
    assert found == [tuple(map(exact, row)) for row in rows]


def as_csv(value):
    value = plain(value)
    if value is None or isinstance(value, str):
        return value or ""
    return repr(value) if isinstance(value, float) else json.dumps(value)


def test_csv_tells_missing_from_empty(call, rosCas, texts):
    out = call("query", "select KEY, data from texts limit 1", "--output", "csv")[1]
    assert out == f'KEY,data\r\n{T},""\r\n'
    rosCas.addTopic("/none").addData(UInt8MultiArray(), key=T)
    out = call("query", "select KEY, data[0] from none", "--output", "csv")[1]
    assert out == f"KEY,data[0]\r\n{T},\r\n"
    assert call("query", "select data[0] from none", "--output", "csv")[1] == 'data[0]\r\n""\r\n'


def test_json_is_json_that_all_can_read(call, numbers, rosCas):
    def refuse(word):
        raise AssertionError(word)

    out = call("query", "select data from numbers", "--output", "json")[1]
    found = [row["data"] for row in json.loads(out, parse_constant=refuse)]
    assert found == [0.5, None, None, None, 0.0]
    assert math.copysign(1, found[4]) == -1
    rosCas.addTopic("/big").addData(UInt64(2**64 - 1), key=T)
    assert json.loads(call("query", "select data from big", "--output", "ndjson")[1]) == {
        "data": 2**64 - 1
    }


def parquet(call, path, statement, *more):
    status, out, err = call("query", statement, *more, "--output", "parquet", "-O", path)
    assert (status, out, err) == (0, "", "")
    return pyarrow.parquet.read_table(path)


def column_of(table, n):
    column = table.column(n)
    if pyarrow.types.is_timestamp(column.type):
        column = column.cast(pyarrow.int64())
    elif str(column.type) == "list<element: timestamp[ns, tz=UTC]>":
        column = column.cast(pyarrow.list_(pyarrow.int64()))
    return column.to_pylist()


def exact(value):
    if isinstance(value, list):
        return [exact(element) for element in value]
    return value.to_nsec() if hasattr(value, "to_nsec") else value


def test_parquet_keeps_types(call, rosCas, tmp_path):
    text = (
        "uint64 big\nfloat32 small\nbool yes\ntime at\nduration long\nuint8[] raw\n"
        "float64[2] pair\nstring[] names\nint8 tiny"
    )
    definition = parse_definition("pkg/Kinds", text, None)
    message = message_class(definition)()
    message.big, message.small, message.yes = 2**64 - 1, 0.1, True
    message.at.secs, message.at.nsecs = 2**32 - 1, 999_999_999
    message.long.secs, message.long.nsecs = -2, 1
    message.raw, message.pair, message.names, message.tiny = (
        b"\0\xff",
        [0.1, math.nan],
        ["a", ""],
        -8,
    )
    rosCas.addTopic("/kinds").addData(message, key=T)
    table = parquet(call, tmp_path / "a.parquet", "SELECT * FROM /kinds")
    assert {field.name: str(field.type) for field in table.schema} == {
        "KEY": "timestamp[ns, tz=UTC]",
        "big": "uint64",
        "small": "float",
        "yes": "bool",
        "at": "timestamp[ns, tz=UTC]",
        "long": "duration[ns]",
        "raw": "binary",
        "pair": "list<element: double>",
        "names": "list<element: string>",
        "tiny": "int8",
    }
    frame = table.to_pandas()
    assert frame.KEY[0].value == T
    assert frame["at"][0].value == 4294967295_999999999
    assert frame.long[0].value == -(2 * 10**9) + 1
    assert (frame.big[0], frame.raw[0], frame.tiny[0]) == (2**64 - 1, b"\0\xff", -8)
    assert list(frame.names[0]) == ["a", ""]
    statement = "SELECT count(*) AS n, sum(big), sum(tiny), avg(tiny), min(at) FROM /kinds"
    table = parquet(call, tmp_path / "b.parquet", statement)
    assert [str(t) for t in table.schema.types] == [
        *("int64", "decimal128(38, 0)", "int64", "double", "timestamp[ns, tz=UTC]")
    ]
    assert [int(table[n][0].as_py()) for n in range(4)] == [1, 2**64 - 1, -8, -8]


def test_parquet_of_nothing_and_of_a_late_value(call, rosCas, tmp_path, monkeypatch):
    """Types come from the statement: neither no row nor a first group of nulls changes them."""
    from cassandra_ros.cli import results

    monkeypatch.setattr(results, "GROUP_ROWS", 2)
    topic = rosCas.addTopic("/late")
    for n in range(5):
        topic.addData(UInt8MultiArray(data=bytes([7] * (n // 4))), key=n)
    path = tmp_path / "late.parquet"
    table = parquet(call, path, "select data[0], KEY from late")
    assert table.column(0).to_pylist() == [None] * 4 + [7]
    assert str(table.schema.types[0]) == "uint8"
    assert pyarrow.parquet.ParquetFile(path).num_row_groups == 3
    table = parquet(call, path, "select data[0], KEY from late where KEY > ?", str(T), "--force")
    assert (table.num_rows, str(table.schema.types[0])) == (0, "uint8")


def test_parquet_of_two_definitions(call, rosCas, tmp_path):
    for text, value in (("int64 x", 2**60), ("string x", "word"), ("int64 x\nint8 y", 5)):
        message = message_class(parse_definition("pkg/X", text, None))()
        message.x = value
        with rosCas.messageWriter() as writer:
            wire = io.BytesIO()
            message.serialize(wire)
            header = {"topic": "/x", "type": "pkg/X", "md5sum": message._md5sum}
            header["message_definition"] = text
            handle = writer.connect(live_connection("/x", header))
            writer.write(handle, T + len(text), 0, wire.getvalue())
    table = parquet(call, tmp_path / "x.parquet", "select x, y from x")
    assert table["x"].to_pylist() == [str(2**60), '"word"', "5"]
    assert table["y"].to_pylist() == [None, None, 0]


def test_values_for_markers(call, texts, numbers):
    def keys(*arguments):
        status, out, err = call("query", *arguments, "--output", "csv")
        assert status == 0, err
        return [int(line) - T for line in out.split()[1:]]

    assert keys("select KEY from texts where data = ?", "plain") == [1]
    assert keys("select KEY from texts where data = ?", '"-"') == [6]
    assert keys("select KEY from texts where data in ?", '["plain", "-"]') == [1, 6]
    assert keys("select KEY from numbers where data = ?", "0.5") == [0]
    assert keys("select KEY from numbers where data < ? and data > ?", "1", "-1") == [0, 4]
    assert keys("select KEY from texts where KEY <= ?", "2014-05-13T16:53:20.123456790Z") == [0, 1]
    assert keys("select KEY from texts", "--limit", "2") == [0, 1]
    assert keys("select KEY from texts where data = 'a:=b'") == []


def test_only_of_one_node(call, rosCas):
    topic = rosCas.addTopic("/n")
    for node in ("r1", "r2"):
        topic.addData(Int64(1), nodeID=node)
    assert call("query", "select NODE from n", "--node-id", "r2", "--output", "csv")[1] == (
        "NODE\r\nr2\r\n"
    )


@pytest.mark.parametrize("verb", ["query", "sql"])
def test_the_ending_of_the_file_chooses_the_format(call, texts, tmp_path, verb):
    def written(name, *more):
        path = tmp_path / f"{verb}_{name}"
        assert call(verb, "SELECT data FROM texts", "-O", path, *more) == (0, "", "")
        return path.read_bytes()

    assert written("a.csv").startswith(b"data\r\n")
    assert json.loads(written("a.JSON"))[0]["data"] is not None
    for ending in ("ndjson", "jsonl"):
        assert "data" in json.loads(written(f"a.{ending}").splitlines()[0])
    assert written("a.parquet").startswith(b"PAR1")
    for name in ("a.txt", "a", "csv"):
        assert written(name).startswith(b"data") and b"\r" not in written(name, "-f")[:6]
    # An option says it for any name.
    assert written("b.txt", "--output", "csv").startswith(b"data\r\n")


def test_an_output_file_is_whole_or_not_there(call, texts, tmp_path):
    path = tmp_path / "out.csv"
    arguments = ("query", "select data from texts", "--output", "csv", "-O", path)
    assert call(*arguments)[:2] == (0, "")
    whole = path.read_bytes()
    assert whole.decode() == call(*arguments[:4])[1]
    status, _, err = call(*arguments)
    assert status == 1
    assert "exists" in err and "--force" in err
    assert call(*arguments, "--force")[0] == 0
    assert path.read_bytes() == whole
    status, _, err = call("query", "select KEY, sum(data) from texts", *arguments[2:], "--force")
    assert status == 1
    assert path.read_bytes() == whole
    status, _, err = call("query", "select data from texts", "-O", tmp_path / "no" / "x")
    assert status == 1
    assert "cannot be written: No such file" in err
    assert [found.name for found in tmp_path.iterdir()] == ["out.csv"]


def test_a_failed_answer_leaves_no_file(call, rosCas, tmp_path, monkeypatch):
    from cassandra_ros.cli import results
    from cassandra_ros.errors import StoreUnavailable

    def fail(*arguments):
        arguments[2].write("half")
        raise StoreUnavailable("gone")

    monkeypatch.setattr(results, "write_csv", fail)
    rosCas.addTopic("/a").addData(Int64(1))
    status, _, err = call(
        "query", "select data from a", "--output", "csv", "-O", tmp_path / "out.csv"
    )
    assert (status, err) == (1, "cassandra_bag: gone\n")
    assert not list(tmp_path.iterdir())


def test_errors_show_the_spot_and_are_status_1(call, texts):
    for arguments, text in [
        (("select x from texts",), "has no field x"),
        (("select data from text",), "text"),
        (("select data frm texts",), "frm"),
        (("select data from texts where data = ?",), "parameter"),
        (("delete from texts where KEY > 0",), "--allow-writes"),
    ]:
        status, out, err = call("query", *arguments)
        assert (status, out) == (1, ""), err
        lines = err.splitlines()
        assert lines[0].startswith("cassandra_bag: ")
        if "--allow-writes" not in text:
            assert lines[1] == f"  {arguments[0]}"
            assert lines[2].strip() == "^"
            del lines[1:3]
        assert len(lines) == 1
        assert text in err


def test_wrong_usage_is_status_2(call):
    for arguments in (
        (),
        ("select 1", "--output", "xml"),
        ("select 1", "--limit", "0"),
        ("select 1", "--output", "parquet"),
        ("select 1", "--explain", "-O", "x"),
    ):
        assert call("query", *arguments)[0] == 2
    for arguments in ((), ("/a",), ("--list", "/a", "b"), ("--list", "--remove", "/a")):
        assert call("index", *arguments)[0] == 2


def test_writes_are_asked_for(call, texts):
    statement = f"DELETE FROM /texts WHERE KEY <= {T + 1}"
    assert call("query", statement, "--allow-writes")[:2] == (0, "deleted\n      2\n")
    assert texts.countTopicData() == len(TEXTS) - 2
    assert call("query", "TRUNCATE texts", "--allow-writes")[:2] == (0, "")
    assert texts.countTopicData() == 0


def test_explain(call, texts):
    status, out, err = call("query", "select data from texts where data = ?", "x", "--explain")
    assert (status, err) == (0, "")
    assert "bucket" in out
    assert "plain" not in out


def test_the_help_tells_all(call):
    status, out, _ = call("query", "--help")
    assert status == 0
    for word in ("STATEMENT", "VALUE", "RFC 4180", "base64", "null", "--explain", "--allow-writes"):
        assert word in out


@pytest.mark.suite("all", "it stands for an installation without them")
@pytest.mark.parametrize("package", ["pandas", "pyarrow"])
def test_without_the_optional_packages(env, rosCas, tmp_path, package):
    """Everything else works, and --output parquet says what to install."""
    rosCas.addTopic("/a").addData(Time(), key=T)
    keyspace = env["CASSANDRA_ROS_KEYSPACE"]
    program = f"""
import sys
sys.modules[{package!r}] = None
from cassandra_ros import RosCassandra
from cassandra_ros.cli import cassandra_bag
from cassandra_ros.errors import CassandraRosError
with RosCassandra(sys.argv[1], int(sys.argv[2]), keyspace={keyspace!r}) as store:
    print(store.getTopic("/a").getArrays("KEY")["KEY"][0])
    if {package!r} == "pandas":
        try:
            store.getTopic("/a").toDataFrame()
        except ImportError as exc:
            assert isinstance(exc, CassandraRosError)
            print(exc, file=sys.stderr)
            sys.exit(1)
    query = ["query", "select KEY from /a", "--output"]
    assert cassandra_bag.main([*query, "csv"]) == 0
    sys.exit(cassandra_bag.main([*query, "parquet", "-O", sys.argv[3]]))
"""
    path = tmp_path / "x.parquet"
    host, port = env["CASSANDRA_ROS_HOST"], env["CASSANDRA_ROS_PORT"]
    done = subprocess.run(
        [sys.executable, "-c", program, host, port, str(path)],
        env=env,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 1, done.stderr
    assert str(T) in done.stdout
    assert f"-m pip install -r {ROOT / 'requirements/tables.txt'}" in done.stderr
    assert "not installed" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not path.exists()


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.parametrize("output", ["table", "csv", "json", "ndjson"])
def test_a_reader_that_leaves_is_no_error(env, rosCas, output):
    topic = rosCas.addTopic("/many")
    for n in range(300):
        topic.addData(String("x" * 1000), key=n)
    command = f"query 'select data, data from many' --output {output} | head -c 10"
    done = subprocess.run(
        ["bash", "-c", f"{sys.executable} {ROOT}/scripts/cassandra_bag {command}"],
        env=env,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert len(done.stdout) == 10
    assert done.stderr == ""


@pytest.mark.suite("all", "make test asks others of its kind")
def test_ctrl_c_ends_quietly(env, rosCas, tmp_path):
    topic = rosCas.addTopic("/many")
    for n in range(300):
        topic.addData(String("x" * 1000), key=n)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    words = ["query", "select data, data from many", "--output", "csv", "-O", str(pipe)]
    process = subprocess.Popen(
        [sys.executable, str(ROOT / "scripts/cassandra_bag"), *words],
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # A shell in the background may have had SIGINT ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    with open(pipe) as reader:
        assert reader.read(10)  # in the middle of the answer; no more is read
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=300)
    assert (process.returncode, out, err) == (130, b"", b"")


def test_index(call, rosCas):
    with rosCas.messageWriter(format="ros") as writer:  # a bucket that is open is not taken in
        header = {"topic": "/cmd_vel", "type": Twist._type, "md5sum": Twist._md5sum}
        header["message_definition"] = Twist._full_text
        handle = writer.connect(live_connection("/cmd_vel", header))
        for n in range(10):
            wire = io.BytesIO()
            Twist(linear=Vector3(x=n)).serialize(wire)
            writer.write(handle, T + n, n, wire.getvalue())
    assert call("index", "--list")[:2] == (0, "there is no index\n")
    status, out, err = call("index", "/cmd_vel", "linear.x")
    assert (status, err) == (0, "")
    assert out == "index on linear.x of topic /cmd_vel: 10 stored messages were taken in\n"
    lines = [line.split()[:2] for line in call("index", "--list")[1].splitlines()]
    assert lines == [["topic", "field"], ["/cmd_vel", "linear.x"]]
    assert "linear.x" in call("index", "cmd_vel", "--list")[1]
    assert call("index", "/cmd_vel", "linear.y", "--quiet")[:2] == (0, "")
    assert call("index", "/cmd_vel", "linear.x", "--remove")[1] == (
        "index on linear.x of topic /cmd_vel removed\n"
    )
    lines = [line.split()[:2] for line in call("index", "--list")[1].splitlines()]
    assert lines == [["topic", "field"], ["/cmd_vel", "linear.y"]]
    for arguments in (
        ("/cmd_vel", "linear.w"),
        ("/none", "x"),
        ("/cmd_vel", "linear.x", "--remove"),
    ):
        status, _, err = call("index", *arguments)
        assert (status, err.count("\n")) == (1, 1)
