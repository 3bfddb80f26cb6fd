# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements in SQL of strangers: viewer and query server go on, whatever DuckDB does."""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import signal
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import urlencode

import pytest
from conftest import ROOT
from hostile.bad_statements import BAD_STATEMENTS, ENDLESS
from nodes.children import Child, await_true, start_client, start_node
from std_msgs.msg import Float64
from suites import CAMPAIGN

from cassandra_ros.client.sql.statement_processes import (
    STATEMENTS_AT_ONCE,
    Statement,
    StatementProcesses,
)
from cassandra_ros.read import EVERYBODY
from cassandra_ros.viewing.viewer_settings import DEFAULT_THREADS

pytestmark = [pytest.mark.suite("all", "statements that take seconds"), pytest.mark.search]

MOST_KB = 500_000
PATIENCE_SEC = 90.0 if CAMPAIGN else 2.0
"""Time after which a client leaves, s: the campaign waits until each statement is stopped."""


@pytest.fixture(scope="module")
def store(fresh):
    with fresh() as store:
        topic = store.addTopic("/volt")
        for n in range(50):
            topic.addData(Float64(n), key=10**18 + n)
        yield store


class Viewer:
    """The program viewer, as a person starts it."""

    def __init__(self, child, port):
        self.child = child
        self.port = port

    def send(self, path, timeout_sec=180.0, **parameters):
        """Return a connection on which a request was sent."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=timeout_sec)
        text = urlencode(parameters, errors="surrogatepass")
        connection.request("GET", f"{path}?{text}")
        return connection

    def get(self, path, **parameters):
        """Return status and JSON of an answer."""
        with contextlib.closing(self.send(path, **parameters)) as connection:
            answer = connection.getresponse()
            return answer.status, json.load(answer)


@pytest.fixture
def viewer(store, ros_env, cassandra):
    env = dict(ros_env, PYTHONPATH=f"{ROOT / 'src'}:{ros_env.get('PYTHONPATH', '')}")
    where = ["--store-host", cassandra.host, "--store-port", str(cassandra.port)]
    words = ["--port", "0", "--keyspace", store.keyspace, *where]
    with Child([sys.executable, ROOT / "scripts" / "viewer", *words], env) as child:
        url = re.search(r"http://127\.0\.0\.1:([0-9]+)/", child.await_line("http://"))
        yield Viewer(child, int(url[1]))


def peak_kb(child):
    status = Path(f"/proc/{child.process.pid}/status").read_text("ascii")
    return int(re.search(r"VmHWM:\s*(\d+) kB", status)[1])


def test_a_page_of_bad_statements_leaves_the_viewer(viewer):
    """Clients ask two at once, and leave after a while."""

    def ask(text):
        sql = {"q": text, "language": "sql"}
        connection = viewer.send("/api/query", PATIENCE_SEC, **sql)
        with contextlib.closing(connection), contextlib.suppress(TimeoutError):
            answer = connection.getresponse()
            assert answer.status in (200, 400), (text[:100], answer.status, answer.read())
            answer.read()
        assert viewer.get("/api/keyspace")[0] == 200

    with ThreadPoolExecutor(2) as clients:
        for _ in clients.map(ask, BAD_STATEMENTS):
            pass
    status, page = viewer.get("/api/query", q="SELECT count(*) FROM volt", language="sql")
    assert (status, page.get("rows")) == (200, [[50]]), page
    assert peak_kb(viewer.child) < MOST_KB
    assert viewer.child.end(signal.SIGINT) == 0, viewer.child.output


def test_statements_that_wait_hold_no_other_request_and_no_end(viewer):
    """More than there are threads ask what never ends; all of them would wait for a minute."""
    with contextlib.ExitStack() as clients:
        asking = [
            clients.enter_context(
                contextlib.closing(viewer.send("/api/query", q=ENDLESS, language="sql"))
            )
            for _ in range(DEFAULT_THREADS + 4)
        ]
        await_true(lambda: len(processes_of(viewer.child)) == STATEMENTS_AT_ONCE)
        for path in ("/api/keyspace", "/api/topics", "/api/runs"):
            assert viewer.get(path)[0] == 200
        query = viewer.get("/api/query", q="SELECT data FROM /volt LIMIT 1")
        assert query[1]["rows"] == [[0.0]]
        running = processes_of(viewer.child)
        assert len(running) == STATEMENTS_AT_ONCE  # no statement has ended meanwhile
        assert viewer.child.end(signal.SIGINT) == 0, viewer.child.output
        await_true(lambda: not any(Path(f"/proc/{pid}").exists() for pid in running))
        assert len(asking) > DEFAULT_THREADS


def processes_of(child):
    found = set()
    for children in Path(f"/proc/{child.process.pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):  # a thread that has ended meanwhile
            found.update(children.read_text("ascii").split())
    return found


def test_the_query_server_goes_on(store, roscore, cassandra):
    where = ("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", store.keyspace)
    server = start_node(roscore, "query_server", *where)
    with server, start_client(roscore) as client:
        server.await_line("serving keyspace")

        def ask(text, timeout=1.0 if not CAMPAIGN else 0.0):
            return client.call("/cassandra_ros/sql", statement=text, timeout=timeout)

        # The viewer is asked all of them, above; they are answered by the same processes.
        for text in BAD_STATEMENTS if CAMPAIGN else BAD_STATEMENTS[::4]:
            if "\ud800" not in text and "\0" not in text:  # no text of ROS
                answer = ask(text)
                assert answer["success"] or answer["message"], text[:100]
        answer = ask(ENDLESS)
        assert "was stopped after" in answer["message"] and "of at most 60 s" in answer["message"]
        assert ask("SELECT count(*) FROM volt", 60.0)["rows"] == [{"values": ["50"]}]
        assert peak_kb(server) < MOST_KB
        assert server.end(signal.SIGINT) == 0, server.output


VALUES = (
    "NULL", "0", "-1", "1e308", "'nan'::DOUBLE", "9223372036854775807", "repeat('ab', 100000)",
    "range(1000)", "[]", "[[1], NULL]", "{'a': 1}", "MAP {1: 2}", "''", "'%'", "'(a*)*b'",
    "'x'::BLOB",
    "TIMESTAMP '1970-01-01'", "INTERVAL 1 MONTH", "DATE '9999-12-31'", "true", "'[1, {}]'::JSON",
    "2::HUGEINT ** 100", "repeat('[', 50000)", "1000000000", "(SELECT data FROM volt LIMIT 1)",
)  # fmt: skip
"""Arguments of random calls."""


@pytest.fixture(scope="module")
def functions():
    import duckdb

    found = duckdb.sql(
        "SELECT DISTINCT function_name FROM duckdb_functions() ORDER BY 1"
    ).fetchall()
    return [name for (name,) in found if re.fullmatch("[a-z_0-9]+", name)]


def test_random_calls(give, store, functions):
    """Any function of DuckDB, with any arguments: rows, or one of our errors."""

    @contextlib.contextmanager
    def processes():
        with contextlib.closing(StatementProcesses(store.cassandra)) as opened:
            yield opened

    def call(chance, depth=0):
        if depth == 3 or chance.random() < 0.4:
            return chance.choice(VALUES)
        arguments = [call(chance, depth + 1) for _ in range(chance.choice((0, 1, 1, 2, 2, 3, 4)))]
        return f"{chance.choice(functions)}({', '.join(arguments)})"

    def attempt(processes, chance):
        where = chance.choice(("", " FROM volt", " FROM range(100000)", " FROM volt a, volt b"))
        text = f"SELECT {call(chance)}{where}"
        with processes.answer(Statement(store.keyspace, text, EVERYBODY), _no_watch, 1.0) as answer:
            for _ in answer:
                pass

    give("calls of DuckDB", 1000, attempt, within=processes)
    assert not [each for each in threading.enumerate() if each.name.startswith("sql")]


def _no_watch():
    pass
