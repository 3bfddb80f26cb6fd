# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Outputs that take nothing: full disks, pipes without a reader, terminals that know only ASCII."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys

import pytest
from cli.conftest import ROOT
from mapping.room import T0, Drive
from nodes.raw_publisher import header_of, message
from sensor_msgs.msg import Image
from std_msgs.msg import Float64, String
from suites import sparing

from cassandra_ros.cli import cassandra_bag
from cassandra_ros.cli.script import run_script
from cassandra_ros.client.sql.lake import LOCK
from cassandra_ros.errors import BagError
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.spool.segment_writer import SegmentWriter
from cassandra_ros.files.spool.spool_folder import SpoolFolder
from cassandra_ros.files.spool.spool_label import RunEnd, SpoolLabel
from cassandra_ros.messages.connection_header import api_connection, live_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.recording.topic_settings import RecordingSettings, settings_as_json
from cassandra_ros.store.tables.context_blob import NodeGraph, RunContext

SEC = 10**9
ODD = "/é"
MOST_BYTES = 100
"""Maximum size of a file where a disk is full."""
ASCII = {
    "LC_ALL": "C",
    "PYTHONIOENCODING": "ascii",
    "PYTHONUTF8": "0",
    "PYTHONCOERCECLOCALE": "0",
}
SCRIPTS = sorted(path.name for path in (ROOT / "scripts").iterdir())

VERBS = {
    "list": [],
    "info": [],
    "info --all": [],
    "runs": [],
    "runs --params": ["{run}"],
    "import": ["{bag}"],
    "export": ["{new}.bag", "--topics", "/n"],
    "export --parquet": ["{new}", "--topics", "/n"],
    "verify": ["{bag}"],
    "check": [ODD],
    "query": ["select * from n"],
    "sql": ["select * from topics"],
    "plot": ["select data from n", "-o", "{new}.png"],
    "thumbs": ["/image", "-o", "{new}.png"],
    "cat": [ODD],
    "index": ["--list"],
    "convert": ["/n", "--format", "binary"],
    "copy": ["/n", "--to", "{copies}"],
    "copy --status": [],
    "spool": ["list", "--spool-dir", "{spool}"],
    "map": ["/scan", "--resolution", "0.5", "--limit", "4", "-o", "{new}.png"],
    "rename": ["/second", "/renamed"],
    "meta": [ODD],
    "event": ["list"],
    "delete": ["/n", "--yes", "--end", str(T0 // SEC + 5)],
    "delete --messages": ["/second", "--yes"],
    "retention": ["-e", ODD, "--max-age", "1d", "--dry-run"],
    "size": ["--topics", ODD, "--rates", f"{ODD}:5"],
    "roles": [],
    "--completion": ["bash"],
}
"""Verb, with an option that makes it do another thing -> arguments with which it prints something,
if it prints at all."""
SILENT = {"plot"}
"""Verbs that print nothing if they succeed."""
NEGATIVE = {"copy --status"}
"""Verbs whose exit status is 1, for it is not so what they ask: nothing was copied."""
FILES = {
    "bag": ["export", "{new}.bag", "--topics", "/n"],
    "mcap": ["export", "{new}.mcap", "--topics", "/n"],
    "parquet": ["export", "{new}", "--parquet", "--topics", "/n"],
    "query csv": ["query", "select * from n", "-O", "{new}.csv"],
    "query json": ["query", "select * from n", "-O", "{new}.json"],
    "query parquet": ["query", "select * from n", "-O", "{new}.parquet"],
    "sql csv": ["sql", "select * from n", "-O", "{new}.csv"],
    "sql parquet": ["sql", "select * from n", "-O", "{new}.parquet"],
    "plot png": ["plot", "select data from n", "-o", "{new}.png"],
    "plot svg": ["plot", "select data from n", "-o", "{new}.svg"],
    "plot pdf": ["plot", "select data from n", "-o", "{new}.pdf"],
    "thumbs": ["thumbs", "/image", "-o", "{new}.png"],
    "map png": ["map", "/scan", "--resolution", "0.5", "--limit", "4", "-o", "{new}.png"],
    "map pgm": ["map", "/scan", "--resolution", "0.5", "--limit", "4", "-o", "{new}.pgm"],
    "spool": ["spool", "export", "7", "{new}.bag", "--spool-dir", "{spool}"],
}
"""Arguments with which a verb writes a file of more than MOST_BYTES."""


@pytest.fixture
def typed(env, rosCas, cassandra, tmp_path):
    """Store some of everything; return a function that runs a program with its streams."""
    bag, spool, new = tmp_path / "a.bag", tmp_path / "spool", tmp_path / "new"
    new.mkdir()
    with BagWriter(bag) as writer:
        number = writer.connection(api_connection(ODD, definition_of(String), ""))
        for n in range(5):
            writer.write(number, T0 + n * SEC, message(String("ü")))
        for name in ("/n", "/second"):
            number = writer.connection(api_connection(name, definition_of(Float64), ""))
            for n in range(50):
                writer.write(number, T0 + n * SEC, message(Float64(n)))
    words = ["--host", cassandra.host, "--port", str(cassandra.port)]
    words += ["--keyspace", rosCas.keyspace]
    assert cassandra_bag.main(["import", "-q", str(bag), *words]) == 0
    (run,) = rosCas.runs()
    context = RunContext({"robot": "é"}, NodeGraph({}, {}, {}, {}))
    rosCas.catalog.keyspace.registry.put_context(run.writer, run.node, context)
    Drive().store(rosCas, ("/odom", "/scan"))
    grey = Image(height=40, width=40, encoding="mono8", step=40, data=os.urandom(1600))
    rosCas.addTopic("/image").addData(grey, key=T0)
    rosCas.addEvent("bümp", 9.5)
    leave_in_spool(spool, cassandra, rosCas.keyspace)
    places = {
        "bag": bag,
        "run": run.name,
        "new": new / "out",
        "spool": spool,
        "copies": f"{cassandra.host}:{cassandra.port}/{rosCas.keyspace}_home",
    }

    def run_program(words, stdout, program="cassandra_bag", stderr=subprocess.PIPE, **options):
        done = subprocess.run(
            [sys.executable, str(ROOT / "scripts" / program)]
            + [word.format(**places) for word in words],
            stdin=subprocess.DEVNULL,
            stdout=stdout,
            stderr=stderr,
            timeout=300,
            **{"env": env, **options},
        )
        err = (done.stderr or b"").decode("utf-8", "backslashreplace")
        assert "Traceback" not in err, err
        assert "Exception ignored" not in err, err
        return done, err

    yield run_program
    rosCas.cassandra.execute(f'DROP KEYSPACE IF EXISTS "{rosCas.keyspace}_home"')


def leave_in_spool(folder, cassandra, keyspace):
    """Leave the run 7 in a spool."""
    run = SpoolFolder(folder).begin(7)
    address = f"{cassandra.host}:{cassandra.port}"
    settings = settings_as_json(RecordingSettings())
    label = SpoolLabel(7, 7, keyspace, address, T0, name="left", settings=settings)
    segment = SegmentWriter(run.new_file(), label)
    connection = live_connection("/spooled", header_of(String))
    segment.append([(connection, T0 + n, n, message(String(str(n)))) for n in range(3)])
    segment.finish(RunEnd(T0 + SEC, {"/spooled": 3}, {}))
    segment.close()
    run.release()


def test_each_verb_is_in_the_table():
    verbs = {name.split()[0] for name in VERBS} - {"--completion"}
    assert verbs == set(cassandra_bag.make_parser().verbs)


def assert_one_line(err, program="cassandra_bag"):
    """Assert that the errors are one line of a program that says what to do."""
    (line,) = err.splitlines()
    assert line.startswith(f"{program}: "), line
    assert "cannot be written: " in line, line
    assert "write elsewhere" in line, line


@pytest.mark.parametrize("verb", sparing(list(VERBS), kept=["query"]))
def test_a_full_disk_at_the_output(typed, verb):
    with open("/dev/full", "wb") as full:
        done, err = typed([*verb.split(), *VERBS[verb]], full)
    if verb in SILENT:
        assert (done.returncode, err) == (0, "")
    else:
        assert done.returncode == 1, err
        assert_one_line(err.splitlines()[-1])


@pytest.mark.parametrize("verb", sparing(list(VERBS), kept=["info"]))
def test_a_reader_that_has_ended(typed, verb):
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "wb") as pipe:
        done, err = typed([*verb.split(), *VERBS[verb]], pipe)
    assert done.returncode == (0 if verb in SILENT else 141), err


@pytest.mark.parametrize("verb", sparing(list(VERBS), kept=["list"]))
def test_a_terminal_that_knows_only_ascii(typed, env, verb):
    # Python reads the command line as UTF-8 all the same, where it is needed.
    changed = {**ASCII, "PYTHONUTF8": str(int(ODD in VERBS[verb]))}
    done, err = typed([*verb.split(), *VERBS[verb]], subprocess.PIPE, env={**env, **changed})
    assert done.returncode == int(verb in NEGATIVE), (err, done.stdout)
    if verb in ("list", "info"):
        assert rb"/\xe9" in done.stdout


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_name_that_the_command_line_cannot_hold(typed, env):
    done, err = typed(["info", ODD], subprocess.PIPE, env={**env, **ASCII})
    assert (done.returncode, len(err.splitlines())) == (1, 1), err


@pytest.mark.suite("all", "make test asks others of its kind")
def test_json_is_json_on_a_terminal_that_knows_only_ascii(typed, env):
    done, _ = typed(["list", "--json"], subprocess.PIPE, env={**env, **ASCII})
    assert ODD in done.stdout.decode("utf-8")


NO_SPACE = {"disk": errno.ENOSPC, "quota": errno.EDQUOT, "size of a file": errno.EFBIG}
BAD_DISK = {"failing": errno.EIO, "read-only": errno.EROFS}


@pytest.mark.parametrize(
    "number", [*NO_SPACE.values(), *BAD_DISK.values()], ids=[*NO_SPACE, *BAD_DISK]
)
def test_where_space_would_help_the_error_says_so(monkeypatch, capsys, tmp_path, number):
    full = number in NO_SPACE.values()

    def fail(*_):
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(cassandra_bag, "main", fail)
        with pytest.raises(SystemExit) as ended:
            run_script("cassandra_ros.cli.cassandra_bag")
    assert ended.value.code == 1
    err = capsys.readouterr().err
    assert_one_line(err)
    assert ("free some space there" in err) is full
    with monkeypatch.context() as patch, pytest.raises(BagError) as caught:
        patch.setattr(os, "fsync", fail)
        BagWriter(tmp_path / "a.bag").close()
    assert ("free some space there" in str(caught.value)) is full
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", sparing(list(FILES), kept=["query csv"]))
def test_a_full_disk_at_a_file(typed, kind, tmp_path):
    def fill():
        resource.setrlimit(resource.RLIMIT_FSIZE, (MOST_BYTES, MOST_BYTES))

    done, err = typed(FILES[kind], subprocess.PIPE, preexec_fn=fill)
    assert done.returncode == 1, (err, done.stdout)
    assert_one_line(err)
    written = [path.name for path in (tmp_path / "new").rglob("*") if path.is_file()]
    assert [name for name in written if name != LOCK] == []


@pytest.mark.suite("all", "make test asks others of its kind")
def test_errors_that_cannot_be_printed(typed):
    with open("/dev/full", "wb") as full:
        assert typed(["info", "/nope"], full, stderr=full)[0].returncode == 1
        assert typed(["list"], full, stderr=full)[0].returncode == 1


@pytest.mark.suite("all", "it starts many programs")
@pytest.mark.parametrize("program", SCRIPTS)
def test_help_on_a_full_disk(typed, program):
    with open("/dev/full", "wb") as full:
        done, err = typed(["--help"], full, program)
    assert done.returncode == 1
    assert_one_line(err, program)


@pytest.mark.suite("all", "it starts a viewer")
def test_other_programs_on_a_full_disk(typed, tmp_path):
    with open("/dev/full", "wb") as full:
        for program, words in {
            "viewer": ["--port", "0"],
            "local_cassandra": ["status", "--dir", str(tmp_path / "none")],
        }.items():
            done, err = typed(words, full, program)
            assert done.returncode == 1, err
            assert_one_line(err.splitlines()[-1], program)
