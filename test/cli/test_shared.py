# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Options and text output that the verbs share; no store needed."""

from __future__ import annotations

import argparse
import signal
import socket
import threading
import time

import pytest
from conftest import ROOT
from suites import sparing

from cassandra_ros.cli import options as store_options
from cassandra_ros.cli import player, query_server, recorder, replicator
from cassandra_ros.cli.options import add_store_options, store_place, strip_remappings
from cassandra_ros.cli.safe_interrupt import SafeInterrupt
from cassandra_ros.cli.terminal_text import (
    MessageBar,
    format_bytes,
    format_length,
    format_table,
    format_time,
    shown,
)
from cassandra_ros.errors import ConnectionFailed, StoreUnavailable
from cassandra_ros.printable import format_duration
from cassandra_ros.store.connection.outage import HURRY_SEC, Outage


@pytest.fixture
def parse(monkeypatch, tmp_path):
    for name in ("HOST", "PORT", "KEYSPACE", "CQLSHRC"):
        monkeypatch.delenv(f"CASSANDRA_ROS_{name}", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))

    def run(*words, **environment):
        for name, value in environment.items():
            monkeypatch.setenv(f"CASSANDRA_ROS_{name}", value)
        parser = argparse.ArgumentParser()
        add_store_options(parser)
        options = parser.parse_args(words)
        return (*store_place(options), options.keyspace)

    return run


def test_defaults_environment_and_options(parse):
    assert parse() == (["127.0.0.1"], 9042, "ros")
    assert parse(HOST="a,b", PORT="1234", KEYSPACE="fleet") == (["a", "b"], 1234, "fleet")
    assert parse("--host", "c", "--port", "5", "--keyspace", "x") == (["c"], 5, "x")
    assert parse(HOST="", PORT="", KEYSPACE="") == (["127.0.0.1"], 9042, "ros")


def test_the_cqlshrc_sets_what_no_option_sets(parse, tmp_path):
    (tmp_path / ".cassandra").mkdir()
    usual, named = tmp_path / ".cassandra" / "cqlshrc", tmp_path / "mine"
    usual.write_text("[connection]\nhostname = d\nport = 6\n")
    named.write_text("[connection]\nhostname = e\n")
    assert parse() == (["d"], 6, "ros")
    assert parse("--host=", "--cqlshrc=", "--credentials=") == (["d"], 6, "ros")
    assert parse("--cqlshrc", str(named)) == (["e"], 9042, "ros")
    assert parse("--port", "7", CQLSHRC=str(named)) == (["e"], 7, "ros")
    assert parse(HOST="f") == (["f"], 9042, "ros")


@pytest.mark.parametrize("port", ["0", "65536", "-1", "x", "", "1.5", "٣"])
def test_invalid_ports(parse, port):
    with pytest.raises(SystemExit):
        parse("--port", port)


@pytest.mark.parametrize("seconds", ["-1", "x", "", "1e3", "inf", "٣"])
def test_invalid_times_to_wait(parse, seconds):
    parse("--wait", "2.5")
    with pytest.raises(SystemExit):
        parse("--wait", seconds)


@pytest.fixture
def refusing_port():
    """A port at which connections are refused; no other test listens there meanwhile."""
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        yield str(held.getsockname()[1])


def test_that_there_is_no_store_yet_is_told_again_and_again(monkeypatch, refusing_port):
    """A recorder waits without limit; with --wait 0 it ends at once."""
    monkeypatch.setattr(store_options, "TELL_SEC", 0.5)
    parser = recorder.make_parser()
    words = ["/a", "--host", "127.0.0.1", "--port", refusing_port]
    told, third = [], threading.Event()

    def tell(text):
        told.append(text)
        if len(told) == 3:
            third.set()

    options = parser.parse_args(words)
    wait = store_options.StoreWait(tell, ", messages wait")
    with store_options.awaited_store(options, wait) as store:
        assert third.wait(180.0)
        assert not store.done()
    with pytest.raises(ConnectionFailed):  # it is not tried any more
        store.result(180.0)
    assert told[0].startswith("no store yet, messages wait: no Cassandra answers at 127.0.0.1")
    assert f"port {refusing_port}" in told[0] and "local_cassandra start" in told[0]
    now = parser.parse_args([*words, "--wait", "0"])
    refused = pytest.raises(ConnectionFailed, match="local_cassandra start")
    with refused, store_options.awaited_store(now, wait):
        pass


def test_what_roslaunch_adds_is_dropped():
    words = ["verify", "a.bag", "__name:=x", "/a:=/b", "_rate:=3", "--map", "/a:=/c", "--x=1:=2"]
    assert strip_remappings(words) == ["verify", "a.bag", "--map", "/a:=/c", "--x=1:=2"]
    words = ["query", "SELECT data FROM /a WHERE data = 'x:=y'", '"x:=y"', "__log:=a b"]
    assert strip_remappings(words) == words[:3]


def test_every_service_is_told_by_its_program():
    programs = (query_server, player, recorder, replicator)
    told = "".join(program.make_parser().format_help() for program in programs)
    names = {f"{program}Status": "status" for program in ("player", "recorder", "replicator")}
    names["recordTopics"] = "start"
    for path in (ROOT / "srv").glob("*.srv"):
        name = path.stem[0].lower() + path.stem[1:]
        assert f"~{names.get(name, name)}" in told, name


def test_table():
    text = format_table(("topic", "n"), [("/a", "1"), ("/long/name", "1000")], right=("n",))
    assert text == "topic          n\n/a             1\n/long/name  1000"


def test_sizes_times_and_lengths():
    assert [format_bytes(n) for n in (0, 1023, 1024, 3_400_000, 5 * 1024**4, 1024**6)] == [
        "0 B", "1023 B", "1.0 KB", "3.2 MB", "5.0 TB", "1048576.0 TB",
    ]  # fmt: skip
    assert format_time(None) == "-"
    assert format_time(1368021980_999999999) == "2013-05-08T14:06:20Z"
    assert format_time(4117995776 * 10**9) == "2100-06-29T23:42:56Z"
    lengths = [format_length(s * 10**9) for s in (1, 10, 60, 600, 3600, 21600, 86400)]
    assert lengths == ["1 s", "10 s", "1 min", "10 min", "1 h", "6 h", "1 d"]
    assert format_length(5) == "5 ns"
    durations = [format_duration(s * 10**8) for s in (0, 379, 599, 980, 72980)]
    assert durations == ["0.0s", "37.9s", "59.9s", "1:38s (98s)", "2hr 1:38s (7298s)"]
    durations = [format_duration(s * 10**9) for s in (359_999, 360_000, 4_117_995_776)]
    assert durations == ["99hr 59:59s (359999s)", "4.2 days (360000s)", "130.5 years (4117995776s)"]


def test_text_from_outside_is_escaped():
    assert shown("/a\x1b[2J\n\udcff ü") == "/a\\x1b[2J\\n\\udcff ü"


def test_no_bar_where_there_is_no_terminal(capsys):
    with MessageBar("working", 100) as bar:
        bar.add(50)
        bar.add(50, 1000)
    assert capsys.readouterr() == ("", "")


def test_a_signal_waits_for_a_safe_moment():
    before = signal.getsignal(signal.SIGINT)
    outage = Outage("here")
    with pytest.raises(KeyboardInterrupt), SafeInterrupt(outage) as stop:
        stop.check()
        signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is before
        stop.check()
    with pytest.raises(SystemExit) as ended, SafeInterrupt(outage):
        signal.raise_signal(signal.SIGTERM)
    assert ended.value.code == 143
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("number", sparing([signal.SIGINT, signal.SIGTERM], kept=[signal.SIGINT]))
def test_a_signal_ends_a_wait_for_a_store_that_is_silent(number):
    """The first one does, wherever the wait is; an error of the store is not told then."""
    before = [signal.getsignal(each) for each in (number, signal.SIGALRM)]
    with pytest.raises((KeyboardInterrupt, SystemExit)), SafeInterrupt(Outage("here")):
        signal.raise_signal(number)
        threading.Event().wait(600)
        raise AssertionError("the wait went on")
    with pytest.raises((KeyboardInterrupt, SystemExit)), SafeInterrupt(Outage("here")):
        signal.raise_signal(number)
        raise StoreUnavailable("it does not answer")
    assert [signal.getsignal(each) for each in (number, signal.SIGALRM)] == before


def test_a_store_that_answers_has_its_time():
    """What is on its way is stored first."""
    outage, answers, last = Outage("here"), 0, time.monotonic()
    with pytest.raises(KeyboardInterrupt), SafeInterrupt(outage):
        signal.raise_signal(signal.SIGINT)
        while answers < 40:
            time.sleep(0.05)
            outage.answered()
            answers, last = answers + 1, time.monotonic()
    # A busy machine may hold up the answers as a silent store does.
    assert answers == 40 or time.monotonic() - last >= HURRY_SEC
