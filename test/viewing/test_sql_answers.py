# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements in SQL over HTTP, as the page Ask sends them."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path
from urllib.parse import urlencode

import pytest
from geometry_msgs.msg import Twist, Vector3
from std_msgs.msg import Float64
from viewers import running_viewer

from cassandra_ros.client.sql.statement_processes import STATEMENTS_AT_ONCE, SqlAnswer

SEC = 10**9
T0 = 1_500_000_000 * SEC
ENDLESS = "WITH RECURSIVE r AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM r) SELECT max(n) FROM r"


@pytest.fixture(scope="module")
def viewer(fresh):
    with fresh() as store:
        for node in ("one", "two"):
            drive = store.addTopic("/base/cmd", "packed", nodeID=node)
            for n in range(25):
                drive.addData(Twist(linear=Vector3(x=n / 4, y=-n)), key=T0 + n * SEC)
            store.catalog.adder.close()
        store.addTopic("/volt").addData(Float64(12.5), key=T0 + SEC // 2)
        with running_viewer(store) as running:
            running.store = store
            yield running


def ask(viewer, path, q, **asked):
    return viewer.get(path, q=q, language="sql", **asked)


JOIN = 'SELECT c.KEY, c.linear.x, v.data FROM "/base/cmd" c ASOF JOIN volt v ON c.KEY >= v.KEY'


def test_a_join_gives_rows_with_their_times(viewer):
    page = ask(viewer, "/api/query", f"{JOIN} WHERE c.NODE = 'one' ORDER BY c.KEY")
    assert page["columns"] == ["KEY", "x", "data"]
    assert page["kinds"] == ["time", "float64", "float64"]
    assert page["rows"] == [[str(T0 + n * SEC), n / 4, 12.5] for n in range(1, 25)]
    assert page["times"] == [row[0] for row in page["rows"]]
    assert (page["more"], page["after"]) == (False, "")
    first = ask(viewer, "/api/query", f"{JOIN} ORDER BY c.KEY", limit=3)
    assert len(first["rows"]) == 3 and first["more"]
    none = ask(viewer, "/api/query", f"{JOIN} WHERE c.NODE = 'oen'")
    assert none["rows"] == [] and "did you mean one" in none["hints"][0]


def test_robots_and_a_time_range_choose_rows(viewer):
    count = 'SELECT NODE, count(*) AS n FROM "/base/cmd" GROUP BY NODE ORDER BY NODE'
    assert ask(viewer, "/api/query", count)["rows"] == [["one", 25], ["two", 25]]
    assert ask(viewer, "/api/query", count, nodes="two,three")["rows"] == [["two", 25]]
    ends = {"start": str(T0 + 3 * SEC), "end": str(T0 + 4 * SEC)}
    page = ask(viewer, "/api/query", f"{JOIN} WHERE c.NODE = 'one'", **ends)
    assert page["times"] == [str(T0 + 3 * SEC), str(T0 + 4 * SEC)]


def test_messages_arrays_and_odd_values_are_shown(viewer):
    page = ask(
        viewer,
        "/api/query",
        "SELECT linear, [1, 2], sum(1)::HUGEINT, 'nan'::DOUBLE, INTERVAL 2 SECOND, "
        "TIMESTAMP_NS '1960-01-01 00:00:00', NULL FROM \"/base/cmd\" WHERE KEY = "
        f"make_timestamp_ns({T0}) AND NODE = 'one' GROUP BY ALL",
    )
    assert page["kinds"][:5] == ["struct", "int32[]", "int", "float64", "duration"]
    (row,) = page["rows"]
    assert row[:5] == ['{"x": 0.0, "y": 0.0, "z": 0.0}', [1, 2], 1, "nan", str(2 * SEC)]
    assert row[5:] == [str(-315619200 * SEC), None]
    assert page["times"] == [None]


def test_a_plot_has_the_numbers_of_all_rows(viewer):
    plot = ask(viewer, "/api/plot", 'SELECT KEY, linear, NODE FROM "/base/cmd"')
    assert [line["name"] for line in plot["columns"]] == ["linear.x", "linear.y", "linear.z"]
    assert plot["times"] == [str(T0 + n * SEC) for n in range(25)]
    assert plot["rows"] == [2] * 25 and plot["complete"]
    assert plot["columns"][0]["low"] == [n / 4 for n in range(25)]
    assert plot["left_out"] == [{"name": "NODE", "reason": "no number"}]
    few = ask(viewer, "/api/plot", 'SELECT KEY, linear.y FROM "/base/cmd"', pixels=5)
    assert len(few["times"]) <= 5 and sum(few["rows"]) == 50
    (line,) = few["columns"]
    assert (max(line["high"]), min(line["low"])) == (0.0, -24.0)
    part = ask(
        viewer, "/api/plot", 'SELECT KEY, linear.x FROM "/base/cmd"', start=str(T0 + 20 * SEC)
    )
    assert len(part["times"]) == 5
    without = ask(viewer, "/api/plot", "SELECT 1 AS one")
    assert without["columns"] == [] and "without a time" in without["left_out"][0]["reason"]


def test_what_is_wrong_says_where(viewer):
    status, problem = viewer.fail("/api/query", q="SELECT altitud FROM volt", language="sql")
    assert (status, problem["error"], problem["position"]) == (400, "InvalidQuery", 7)
    for text in ("DROP TABLE volt", "SELECT * FROM read_csv('/etc/passwd')", "SELECT 1; SELECT 2"):
        assert viewer.fail("/api/query", q=text, language="sql")[0] == 400
    assert viewer.fail("/api/query", q="SELECT 1", language="basic")[0] == 400
    assert viewer.fail("/api/query", q="SELECT 1", language="sql", after="x")[0] == 400


def test_the_plan_says_what_was_read(viewer):
    text = ask(viewer, "/api/explain", "SELECT max(data) FROM volt")["text"]
    assert "columns:  KEY, data" in text and "messages: 1 read" in text


def test_a_missing_duckdb_is_told(viewer, monkeypatch, tmp_path):
    (tmp_path / "duckdb.py").write_text("raise ImportError('not here')", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    with running_viewer(viewer.store) as other:
        status, problem = other.fail("/api/query", q="SELECT 1", language="sql")
        assert status >= 400 and "requirements/tables.txt" in problem["text"]
        # Completion needs none of it.
        assert offered(other, "SELECT data FROM vo") == ["volt"]


def offered(viewer, text, at=None):
    given = {} if at is None else {"at": at}
    return [offer["text"] for offer in ask(viewer, "/api/complete", text, **given)["offers"]]


def test_tables_and_columns_are_completed(viewer):
    assert offered(viewer, "SELECT * FROM cm") == ['"/base/cmd"']
    assert offered(viewer, 'SELECT * FROM "/ba') == ['"/base/cmd"']
    assert "runs" in offered(viewer, "select 1 from volt join ru")
    assert offered(viewer, "SELECT dat FROM volt", at=10) == ["data"]
    assert "EVENT" in offered(viewer, "SELECT ev FROM volt", at=9)
    text = 'SELECT c.lin FROM volt v JOIN "/base/cmd" AS c ON true'
    assert offered(viewer, text, at=12)[:2] == ["c.linear", "c.linear.x"]
    assert offered(viewer, "SELECT data FROM volt WHE")[0] == "WHERE"
    assert offered(viewer, "SELECT 'lin") == []


@pytest.fixture
def begun(monkeypatch):
    """Set when a statement begins."""
    begins, batches = threading.Event(), SqlAnswer.batches

    def noted(answer):
        begins.set()
        yield from batches(answer)

    monkeypatch.setattr(SqlAnswer, "batches", noted)
    return begins


@contextlib.contextmanager
def asking_without_end(viewer, begun):
    """Ask a statement that never ends, over a connection that is closed at the end."""
    begun.clear()
    with contextlib.closing(viewer.connect()) as connection:
        asked = urlencode({"q": ENDLESS, "language": "sql"})
        connection.request("GET", f"/api/query?{asked}")
        assert begun.wait(180)
        yield


@pytest.mark.suite("all", "it starts statements without an end")
def test_the_viewer_ends_while_statements_run(viewer, begun):
    # Before the test whose clients leave: the processes of their statements are replaced later.
    before = sql_processes()
    with contextlib.ExitStack() as clients:
        with running_viewer(viewer.store) as other:
            for _ in range(STATEMENTS_AT_ONCE):
                clients.enter_context(asking_without_end(other, begun))
            assert len(sql_processes() - before) == STATEMENTS_AT_ONCE
    assert sql_processes() <= before


def sql_processes():
    """Return the processes for statements that this one has started and that run."""
    running = set()
    for children in Path("/proc/self/task").glob("*/children"):
        for pid in children.read_text(encoding="ascii").split():
            with contextlib.suppress(OSError):
                if b"statement_process" in Path(f"/proc/{pid}/cmdline").read_bytes():
                    running.add(int(pid))
    return running


def test_a_client_that_leaves_ends_its_statement(viewer, begun):
    """Otherwise as many endless statements as may run at the same time would block all others."""
    for _ in range(STATEMENTS_AT_ONCE):
        with asking_without_end(viewer, begun):
            pass
    assert ask(viewer, "/api/query", "SELECT 1 AS one")["rows"] == [[1]]
