# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements in processes of their own answer as in this one, and cost an answer at most."""

from __future__ import annotations

import collections
import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import ROOT
from nodes.children import await_true
from std_msgs.msg import Float64

from cassandra_ros.client.sql.duck_database import DuckDatabase, SpillFolder
from cassandra_ros.client.sql.statement_process import has_files
from cassandra_ros.client.sql.statement_processes import Statement, StatementProcesses
from cassandra_ros.errors import (
    AnswerTooLarge,
    CassandraRosError,
    InvalidExpression,
    InvalidQuery,
    StoreUnavailable,
)
from cassandra_ros.read import EVERYBODY, Whose

ENDLESS = "WITH RECURSIVE r AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM r) SELECT max(n) FROM r"
CRASH = "SELECT json_contains(repeat('[', 1000000) || repeat(']', 1000000), '1')"
"""DuckDB parses JSON by recursion: it overflows its stack."""
COUNT = 20


@pytest.fixture(scope="module")
def store(fresh):
    with fresh() as store:
        for node in ("husky", "jackal"):
            topic = store.addTopic("/volt", nodeID=node)
            for n in range(COUNT):
                topic.addData(Float64(n / 4), key=10**18 + n)
        yield store


@pytest.fixture(scope="module")
def shared(store):
    with contextlib.closing(StatementProcesses(store.cassandra)) as processes:
        yield processes


@pytest.fixture
def own(store):
    with contextlib.closing(StatementProcesses(store.cassandra)) as processes:
        yield processes


def run(processes, store, text, *params, whose=EVERYBODY, seconds=60.0, watch=lambda: None):
    """Return columns, rows and hints of a statement."""
    statement = Statement(store.keyspace, text, whose, params)
    with processes.answer(statement, watch, seconds) as answer:
        rows = list(answer)
        return answer.columns, rows, answer.hints


@pytest.fixture
def pids(shared):
    """Return the processes for statements that the test has started and that run."""
    earlier = children()
    return lambda: children() - earlier


def children():
    found = set()
    for path in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(OSError):  # a thread that has ended meanwhile
            found.update(filter(is_for_statements, path.read_text(encoding="ascii").split()))
    return set(map(int, found))


def is_for_statements(pid):
    with contextlib.suppress(OSError):  # it has ended meanwhile
        return b"statement_process" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


@pytest.mark.suite("test", "the first statement starts the process")
@pytest.mark.parametrize(
    "text",
    [
        "SELECT * FROM volt ORDER BY ALL",
        "SELECT KEY, data FROM volt WHERE data > 3 AND NODE = 'husky' ORDER BY KEY",
        "SELECT * FROM volt WHERE NODE = 'huskey'",
        "SELECT 1 WHERE false",
        "SELECT 1 AS a, 2 AS a",
        "SELECT 'x'::ENUM('x', 'y'), uuid '00000000-0000-0000-0000-000000000001', 2::HUGEINT ** 2",
        "SELECT INTERVAL 1 SECOND, DATE '2020-01-01', TIMESTAMP_NS '2020-01-01 00:00:00.000000001'",
        "SELECT {'a': [1, NULL], 'b': MAP {'k': 'v'}}, 1.25::DECIMAL(9, 2), 'nan'::FLOAT, NULL",
        "SELECT unnest(range(10000)) AS n, repeat('x', 1000) AS text",
        pytest.param(
            "SELECT i, CASE WHEN i = 7 THEN repeat('y', 30000000) END AS large FROM range(9) t(i)",
            marks=pytest.mark.suite("all", "a large value"),
        ),
    ],
)
def test_the_answer_is_that_of_this_process(shared, store, text):
    result = store.sql(text)
    rows = result.fetchall()
    assert repr(run(shared, store, text)) == repr((result.columns, rows, result.hints))  # NaN


def test_parameters_robots_and_explanations(shared, store):
    text = "SELECT count(*) FROM volt WHERE data >= ? AND NODE <> $2".replace("$2", "?")
    assert run(shared, store, text, "2.5", '"jackal"')[1] == [(10,)]
    narrow = Whose(("husky",), None)
    assert run(shared, store, "SELECT count(*) FROM volt", whose=narrow)[1] == [(COUNT,)]
    nobody = Whose(None, frozenset({1}))
    assert run(shared, store, "SELECT count(*) FROM volt", whose=nobody)[1] == [(0,)]
    plan = Statement(store.keyspace, "SELECT max(data) FROM volt", EVERYBODY, plan=True)
    with shared.answer(plan, lambda: None) as answer:
        assert f"messages: {2 * COUNT} read" in answer.explanation()


@pytest.mark.parametrize("text", ["SELECT nix FROM volt", "SELECT", "SELECT '", "DROP TABLE volt"])
def test_an_error_is_that_of_this_process(shared, store, text):
    errors = []
    for ask in (store.sql, lambda text: run(shared, store, text)):
        with pytest.raises(InvalidQuery) as caught:
            ask(text)
        errors.append((str(caught.value), caught.value.position, caught.value.statement))
    assert errors[0] == errors[1]


@pytest.mark.suite("all", "it starts a process for each error")
def test_other_errors_keep_their_class(shared, store):
    with pytest.raises(InvalidExpression, match=r"params\[0\] is not JSON"):
        run(shared, store, "SELECT ?", "x")
    with pytest.raises(AnswerTooLarge, match="a row of the answer has"):
        run(shared, store, "SELECT repeat('x', 70000000)")
    with pytest.raises(AnswerTooLarge, match="needs more memory"):
        run(shared, store, "SELECT repeat('x', 1500000000)")
    assert run(shared, store, "SELECT 1")[1] == [(1,)]


NARROW = """
import os, resource, sys
from cassandra_ros import RosCassandra
from cassandra_ros.client.sql.sql_result import SqlResult

deep = "SELECT json_valid(repeat('[', 1000000) || repeat(']', 1000000))"
with RosCassandra(sys.argv[1], int(sys.argv[2]), keyspace=sys.argv[3]) as store:
    store.sql("SELECT 1").fetchall()
    used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    for mib in [*range(0, 64, 3), *range(64, 300, 16)]:
        if not os.fork():
            resource.setrlimit(resource.RLIMIT_AS, [used + (mib << 20)] * 2)
            try:
                SqlResult(store.catalog, deep).fetchall()
            except BaseException as exc:
                os.write(1, f"{type(exc).__name__}\\n".encode())
            os._exit(0)
        _, status = os.wait()
        ended = os.WEXITSTATUS(status) if os.WIFEXITED(status) else -os.WTERMSIG(status)
        os.write(1, f"exit {ended}\\n".encode() if ended else b"")
"""
"""Runs a statement with ever more memory, and prints what ended it each time."""


@pytest.mark.suite("all", "it starts many programs")
def test_memory_that_lacks_anywhere_is_told_as_that(store, cassandra):
    """DuckDB misses it, a thread that it starts, or the loader for what each thread has."""
    command = [sys.executable, "-c", NARROW, cassandra.host, str(cassandra.port), store.keyspace]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, timeout=300)
    ends = collections.Counter(done.stdout.splitlines())
    # MemoryError is told as that by the process, 127 by the program that asked.
    assert set(ends) <= {"AnswerTooLarge", "MemoryError", "exit 127"}, ends
    assert ends["AnswerTooLarge"] > 5, ends


def test_a_process_that_the_loader_ends_for_lack_of_memory_is_told_as_that(
    store, tmp_path, monkeypatch
):
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\nexit 127\n", encoding="ascii")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    with contextlib.closing(StatementProcesses(store.cassandra)) as processes:
        with pytest.raises(AnswerTooLarge, match="needs more memory"):
            run(processes, store, "SELECT 1")


@pytest.mark.suite("all", "it kills a program")
def test_a_statement_that_ends_duckdb_ends_nothing_else(pids, own, store):
    assert run(own, store, "SELECT 1")[1] == [(1,)]
    first = pids()
    with pytest.raises(InvalidQuery, match="this statement ended DuckDB .SIGSEGV."):
        run(own, store, CRASH)
    await_true(pids)  # a process has its name a moment after its start
    second = pids()
    assert not first & second
    assert run(own, store, "SELECT 2")[1] == [(2,)]
    assert pids() == second


@pytest.mark.suite("all", "it stops statements, and waits")
def test_what_is_not_waited_for_ends_and_its_process_goes_on(pids, own, store):
    class Gone(CassandraRosError):
        pass

    def leave():
        raise Gone

    run(own, store, "SELECT 1")
    before = pids()
    with pytest.raises(Gone):
        run(own, store, ENDLESS, watch=leave)
    with pytest.raises(AnswerTooLarge, match=r"stopped after 0.5 s, of at most 60 s"):
        run(own, store, ENDLESS, seconds=0.5)
    many = Statement(store.keyspace, "SELECT * FROM range(1000000000)", EVERYBODY)
    with own.answer(many, lambda: None) as answer:
        assert next(iter(answer)) == (0,)
    assert run(own, store, "SELECT 2")[1] == [(2,)]
    assert len(pids() & before) in (0, 1)  # a busy machine may not stop it in time


@pytest.mark.suite("all", "a process of its own, whose threads are looked at")
def test_each_thread_of_its_process_has_a_low_priority(pids, own, store):
    run(own, store, "SELECT count(*) FROM volt")
    (pid,) = pids()
    threads = [int(thread) for thread in os.listdir(f"/proc/{pid}/task")]
    assert len(threads) > 2  # that of the statement, of what is read, of the driver
    assert {os.getpriority(os.PRIO_PROCESS, thread) for thread in threads} == {10}
    group = Path(f"/proc/{pid}/autogroup")
    text = group.read_text("ascii") if group.exists() else ""
    if text:  # the kernel weighs sessions: that of the process has the same, too
        assert text.endswith(" nice 10\n")


@pytest.mark.suite("all", "a call of DuckDB that cannot be interrupted")
def test_what_cannot_be_interrupted_is_killed(pids, own, store):
    run(own, store, "SELECT 1")
    before = pids()
    slow = "SELECT jaro_winkler_similarity(repeat('ab', 1500000), repeat('ba', 1500000))"
    with pytest.raises(AnswerTooLarge, match="stopped after 1 s"):
        run(own, store, slow, seconds=1)
    assert not pids() & before
    assert run(own, store, "SELECT 2")[1] == [(2,)]


def test_a_closed_one_answers_no_more(pids, store):
    processes = StatementProcesses(store.cassandra)
    run(processes, store, "SELECT 1")
    processes.close()
    assert not pids()
    with pytest.raises(StoreUnavailable, match="ends"):
        run(processes, store, "SELECT 1")


PROGRAM = """
import sys
from cassandra_ros import RosCassandra
from cassandra_ros.read import EVERYBODY
from cassandra_ros.client.sql.statement_processes import Statement, StatementProcesses
with RosCassandra(sys.argv[1], int(sys.argv[2]), keyspace=sys.argv[3]) as store:
    processes = StatementProcesses(store.cassandra)
    with processes.answer(Statement(store.keyspace, sys.argv[4], EVERYBODY), lambda: None) as got:
        print("begun", flush=True)
        list(got)
"""


@pytest.mark.suite("all", "it kills a program")
def test_what_a_killed_program_leaves_goes(store, cassandra, tmp_path):
    env = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "TMPDIR": str(tmp_path)}
    words = [cassandra.host, str(cassandra.port), store.keyspace, ENDLESS]
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *words], env=env, stdout=subprocess.PIPE
    ) as program:
        assert program.stdout.readline() == b"begun\n"
        children = Path(f"/proc/{program.pid}/task/{program.pid}/children").read_text("ascii")
        program.send_signal(signal.SIGKILL)
    (pid,) = children.split()
    await_true(lambda: has_ended(pid))
    (left,) = tmp_path.glob("cassandra_ros_sql_*")
    os.utime(left, (time.time() - 3600,) * 2)
    used = tmp_path / "cassandra_ros_sql_used"
    used.mkdir()
    env["LOCKED"] = str(used)
    check = (
        "import fcntl, os, subprocess, sys, time\n"
        "used = os.open(os.environ['LOCKED'], os.O_RDONLY)\n"
        "fcntl.flock(used, fcntl.LOCK_EX)\n"
        "os.utime(used, (time.time() - 3600,) * 2)\n"
        "subprocess.run([sys.executable, '-c', sys.argv[1]], check=True)\n"
    )
    clean = (
        "from cassandra_ros.client.sql.duck_database import SpillFolder\nSpillFolder().close()\n"
    )
    subprocess.run([sys.executable, "-c", check, clean], env=env, check=True)
    assert list(tmp_path.glob("cassandra_ros_sql_*")) == [used]


def has_ended(pid):
    with contextlib.suppress(FileNotFoundError):
        return Path(f"/proc/{pid}/stat").read_text("ascii").rpartition(")")[2].split()[0] == "Z"
    return True


def test_a_full_disk_stops_only_what_uses_it(tmp_path):
    database = DuckDatabase(folder=str(tmp_path))
    assert list(tmp_path.iterdir()) and not has_files(str(tmp_path))
    (Path(next(tmp_path.iterdir())) / "duckdb_temp_storage").touch()
    assert has_files(str(tmp_path))
    database.close()


def test_a_process_that_cannot_start_is_not_the_fault_of_the_statement(own, store, monkeypatch):
    monkeypatch.setattr(sys, "path", [])
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(StoreUnavailable, match="exit status 1"):
        run(own, store, "SELECT 1")


def test_a_folder_is_private_and_goes(tmp_path):
    folder = SpillFolder(str(tmp_path))
    assert Path(folder.path).stat().st_mode & 0o777 == 0o700
    folder.close()
    folder.close()
    assert not list(tmp_path.iterdir())
