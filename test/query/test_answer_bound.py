# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""No statement makes a program take much memory: one row may name a long field a thousand times.

The programs are real ones, and what they took is what the kernel noted of their processes.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import urlencode

import pytest
from conftest import ROOT
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from nodes.children import Child, start_client, start_node
from std_msgs.msg import String, UInt8MultiArray

from cassandra_ros.errors import AnswerTooLarge
from cassandra_ros.query.tree.json_values import MAX_ANSWER_BYTES, AnswerBound, least_bytes

MB = 2**20
T0 = 1_500_000_000 * 10**9
ELEMENTS = 60_000
TOO_WIDE = f"select {','.join(['data'] * 1000)} from text where KEY >= {T0 + 1}"
"""Each row has 1000 MB as text, of a message of 1 MB."""
WIDE = TOO_WIDE.replace("data," * 960, "")
"""A row takes 40 MB, and two take more than an answer may have."""
DEEP = f"select {','.join(['values.key'] * 1000)} from deep limit 5"
"""All elements of the message together would be 60 million values."""
BESIDE_MB = 4 * MAX_ANSWER_BYTES // MB
"""What an answer may make a program take: its rows, its text, its bytes, and what sends them."""

COMMAND_MB = 150
"""What a command may take that writes rows of 100 MB."""


def peak_mb(status):
    return int(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) / 1024


def peak_of(child):
    return peak_mb(Path(f"/proc/{child.process.pid}/status").read_text())


@pytest.fixture(scope="module")
def store(fresh):
    with fresh() as made:
        made.addTopic("/text").addData(String("short"), key=T0)
        for n in range(1, 4):
            made.getTopic("/text").addData(String("x" * MB), key=T0 + n)
        values = [KeyValue()] * ELEMENTS
        made.addTopic("/deep").addData(DiagnosticStatus(values=values), key=T0)
        large = UInt8MultiArray(data=bytes(MAX_ANSWER_BYTES))
        made.addTopic("/large", format="binary").addData(large, key=T0)
        yield made


@pytest.fixture(scope="module")
def env(ros_env, cassandra):
    where = {"HOST": cassandra.host, "PORT": str(cassandra.port), "CQLSHRC": os.devnull}
    found = {f"CASSANDRA_ROS_{name}": text for name, text in where.items()}
    return {**ros_env, **found, "PYTHONPATH": f"{ROOT / 'src'}:{ros_env.get('PYTHONPATH', '')}"}


class Asked:
    """A program that answers statements."""

    def __init__(self, child, ask):
        self.child, self.ask = child, ask


@pytest.fixture(scope="module")
def viewer(env, store):
    words = ["--port", "0", "--keyspace", store.keyspace, "--token="]
    with Child([sys.executable, ROOT / "scripts/viewer", *words], env) as child:
        url = re.search(r"http://127\.0\.0\.1:[0-9]+", child.await_line("http://"))[0]

        def ask(path, **parameters):
            try:
                with urllib.request.urlopen(f"{url}{path}?{urlencode(parameters)}") as answer:  # noqa: S310 -- our own
                    return answer.status, json.load(answer)
            except urllib.error.HTTPError as exc:
                return exc.code, json.load(exc)

        yield Asked(child, ask)


@pytest.fixture(scope="module")
def server(roscore, cassandra, store):
    where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", store.keyspace)
    with start_node(roscore, "query_server", *where) as child:
        child.await_line("serving keyspace")
        with start_client(roscore) as client:
            yield Asked(
                child, lambda name, **request: client.call(f"/cassandra_ros/{name}", **request)
            )


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_row_that_is_too_large_is_refused_by_the_viewer(viewer):
    status, _ = viewer.ask("/api/query", q="select data from text")
    assert status == 200
    before = peak_of(viewer.child)
    status, answer = viewer.ask("/api/query", q=TOO_WIDE)
    assert (status, answer["error"]) == (400, "AnswerTooLarge")
    assert "more than 64 MiB; select fewer columns" in answer["text"]
    assert peak_of(viewer.child) - before < 60  # it is refused before it is made
    # What is shortened fits, and so do few of many elements.
    assert viewer.ask("/api/query", q=TOO_WIDE, cut=5)[0] == 200
    status, answer = viewer.ask("/api/query", q=DEEP)
    assert status == 200 and len(answer["rows"]) == 5
    assert peak_of(viewer.child) - before < 200


def test_a_page_of_the_viewer_ends_before_the_row_that_makes_it_too_large(viewer):
    wide = WIDE.replace(f" where KEY >= {T0 + 1}", "")
    before, after, sizes = peak_of(viewer.child), "", []
    for _ in range(4):
        status, page = viewer.ask("/api/query", q=wide, after=after)
        assert status == 200
        sizes.append([len(row[0]) for row in page["rows"]])
        after = page["after"]
    assert sum(sizes, []) == [5, MB, MB, MB]
    assert peak_of(viewer.child) - before < BESIDE_MB
    too_wide = TOO_WIDE.replace(f" where KEY >= {T0 + 1}", "")
    status, page = viewer.ask("/api/query", q=too_wide)
    assert status == 200 and [len(row[0]) for row in page["rows"]] == [5]
    status, page = viewer.ask("/api/query", q=too_wide, after=page["after"])
    assert (status, page["error"]) == (400, "AnswerTooLarge")


def test_a_message_that_is_too_large_is_refused_by_the_viewer(viewer):
    status, answer = viewer.ask("/api/message", topic="/large", key=T0)
    assert (status, answer["error"]) == (400, "AnswerTooLarge")
    assert "give elements and characters" in answer["text"]
    status, answer = viewer.ask("/api/message", topic="/large", key=T0, elements=9)
    assert status == 200 and answer["size"] > MAX_ANSWER_BYTES


@pytest.mark.suite("all", "large messages, to see how much memory they take")
def test_answers_of_the_query_server_are_bounded(server):
    rows = server.ask("executeCQL", statement="select data from text")["rows"]
    assert [len(row["values"][0]) for row in rows] == [7, MB + 2, MB + 2, MB + 2]
    before = peak_of(server.child)
    answer = server.ask("executeCQL", statement=TOO_WIDE)
    assert not answer["success"] and not answer["rows"]
    assert "more than 64 MiB; select fewer columns" in answer["message"]
    # The text of a row is made until it is too large.
    assert peak_of(server.child) - before < 2 * MAX_ANSWER_BYTES // MB
    wide = {"statement": WIDE.replace(f" where KEY >= {T0 + 1}", "")}
    first = server.ask("executeCQL", **wide)
    assert first["success"] and [len(row["values"]) for row in first["rows"]] == [40, 40]
    second = server.ask("executeCQL", cursor=first["next_cursor"], **wide)
    assert [len(row["values"]) for row in second["rows"]] == [40]
    rows = server.ask("executeCQL", statement=DEEP)["rows"]
    assert [len(row["values"]) for row in rows] == [1000] * 5
    assert peak_of(server.child) - before < BESIDE_MB


def test_messages_of_the_query_server_are_bounded(server):
    one = {"topic": "/large", "key": T0}
    answer = server.ask("getData", **one)
    assert not answer["success"] and "set omit_data" in answer["message"]
    assert server.ask("getData", omit_data=True, **one)["success"]
    answer = server.ask("range", topic="/large")
    assert not answer["success"] and "set omit_data" in answer["message"]
    assert server.ask("range", topic="/large", cursor=answer["next_cursor"])["success"]


RUN_AND_TELL = """
import pathlib, sys
from cassandra_ros.cli.cassandra_bag import main
status = main(sys.argv[1:])
print(pathlib.Path("/proc/self/status").read_text(), file=sys.stderr)
sys.exit(status)
"""


@pytest.mark.suite("all", "large messages, to see how much memory they take")
@pytest.mark.parametrize("form", ["table", "csv", "ndjson", "json"])
def test_rows_are_written_value_by_value(env, store, tmp_path, form):
    columns = ", ".join(f"data as c{n}" for n in range(100))
    words = ["query", f"select {columns} from text", "--output", form, "-O", tmp_path / "out"]
    ran = subprocess.run(
        [sys.executable, "-c", RUN_AND_TELL, *map(str, words), "--keyspace", store.keyspace],
        env=env,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ran.returncode == 0, ran.stderr
    assert (tmp_path / "out").stat().st_size > (300 * MB if form != "table" else 0)
    assert peak_mb(ran.stderr) < COMMAND_MB


def test_what_is_counted():
    values = ["é" * 3, b"\0" * 5, [1.5] * 7, [["a"], ["bc"]], None, 2**70]
    assert list(map(least_bytes, values)) == [3, 5, 14, 3, 2, 2]
    bound = AnswerBound("it", "ask for less")
    bound.count_part(MAX_ANSWER_BYTES)
    for size in (1, MAX_ANSWER_BYTES):
        with pytest.raises(AnswerTooLarge, match="it would take more than 64 MiB; ask for less"):
            bound.count_part(size)
    bound.count_part(0)
    assert bound.bytes == MAX_ANSWER_BYTES
