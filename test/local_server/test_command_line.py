# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""local_cassandra as it is typed: texts, exit status, signals."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from suites import sparing

from cassandra_ros.cli import local_cassandra
from cassandra_ros.local_server import LocalCluster, free_port, processes
from cassandra_ros.local_server.cql import answers_cql
from cassandra_ros.local_server.jars import jars_directory

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def env(tmp_path):
    return {
        **os.environ,
        "ROS_HOME": str(tmp_path),
        "CASSANDRA_ROS_JARS": str(jars_directory()),
        "PYTHONPATH": str(ROOT / "src"),
    }


@pytest.fixture
def type_in(env):
    def run(*arguments, timeout=400):
        return subprocess.run(
            [sys.executable, str(ROOT / "scripts/local_cassandra"), *arguments],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            env=env,
            timeout=timeout,
        )

    return run


@pytest.mark.parametrize("verb", local_cassandra.VERBS)
def test_every_verb_explains_itself(verb, capsys):
    with pytest.raises(SystemExit) as ended:
        local_cassandra.main([verb, "--help"])
    assert ended.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    assert local_cassandra.VERBS[verb].__doc__.strip().splitlines()[0] in text


def test_what_roslaunch_adds_is_left_alone():
    options = local_cassandra.make_parser().parse_args(["start", "--port", "9999"])
    assert options.port == 9999
    with pytest.raises(SystemExit):
        local_cassandra.make_parser().parse_args(["start", "__name:=x"])


def test_no_verb_is_an_error(type_in):
    done = type_in()
    assert done.returncode == 2
    assert "VERB" in done.stderr


def test_status_where_nothing_ever_ran(type_in, tmp_path):
    done = type_in("status", "__name:=cassandra", "__log:=/dev/null")
    assert done.returncode == 3
    assert str(tmp_path / "cassandra_ros") in done.stdout
    assert not (tmp_path / "cassandra_ros").exists()


def test_stop_and_clear_where_nothing_ever_ran(type_in):
    assert type_in("stop").returncode == 0
    assert type_in("clear").returncode == 0


def test_the_environment_names_the_directory(type_in, env, tmp_path):
    env["CASSANDRA_ROS_DIR"] = str(tmp_path / "named")
    for verb, status in (("status", 3), ("stop", 0), ("clear", 0)):
        done = type_in(verb)
        assert (done.returncode, str(tmp_path / "named") in done.stdout) == (status, True)
    assert str(tmp_path / "other") in type_in("stop", "--dir", str(tmp_path / "other")).stdout


def test_errors_are_one_line_on_stderr_and_status_1(type_in):
    done = type_in("start", "--host", "10.0.0.1")
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.startswith("local_cassandra: ")
    assert "loopback" in done.stderr


@pytest.mark.suite("all", "it starts a Cassandra")
def test_a_start_that_is_refused_leaves_no_directory(type_in, env, tmp_path):
    folder = tmp_path / "made/for/nothing"
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = type_in("start", "--dir", str(folder), "--port", str(port))
    assert (done.returncode, f"port {port} " in done.stderr) == (1, True), done.stderr
    # No Java, or else, where PyPI's is installed, no place for the jars.
    env.update(JAVA_HOME="", PATH=str(tmp_path), CASSANDRA_ROS_JARS="/proc/jars")
    done = type_in("start", "--dir", str(folder), "--port", str(free_port()))
    assert done.returncode == 1, done.stdout
    assert not (tmp_path / "made").exists()


def test_a_python_without_the_driver_is_told_what_to_do(env, tmp_path):
    """The plain system Python has no database driver."""
    program = "from cassandra_ros.cli.script import run_script; run_script('needs_the_driver')"
    (tmp_path / "needs_the_driver.py").write_text("import cassandra.cluster")
    done = subprocess.run(
        ["/usr/bin/python3", "-c", program],
        capture_output=True,
        text=True,
        env={**env, "PYTHONPATH": f"{ROOT / 'src'}:{tmp_path}"},
    )
    assert done.returncode == 1
    assert "make setup" in done.stderr
    assert f"pip install -r {ROOT / 'requirements/runtime.txt'}" in done.stderr
    assert "catkin_make -DPYTHON_EXECUTABLE=" in done.stderr


def answered(env, answer):
    """Type clear on a terminal, and an answer; return the exit status."""
    ours, theirs = os.openpty()
    try:
        child = subprocess.Popen(
            [sys.executable, str(ROOT / "scripts/local_cassandra"), "clear"],
            stdin=theirs,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=env,
        )
        os.write(ours, answer.encode())  # the terminal keeps it until it is read
        asked = child.communicate(timeout=300)[1]
        assert "Delete all data in" in asked and "[y/N]" in asked
        return child.returncode
    finally:
        os.close(ours)
        os.close(theirs)


@pytest.mark.suite("all", "it starts a Cassandra")
def test_start_status_stop_clear(type_in, env, tmp_path):
    try:
        done = type_in("start", "--port", str(free_port()), "--heap", "256M")
        assert done.returncode == 0, done.stderr
        assert "answers at 127.0.0.1:" in done.stdout
        assert "\r" not in done.stdout + done.stderr  # no progress line without a terminal
        assert "runs already" in type_in("start").stdout
        done = type_in("status", "--wait", "60")
        assert done.returncode == 0
        assert "heap 256M" in done.stdout
        assert type_in("clear", "--yes").returncode == 1
    finally:
        done = type_in("stop")
    assert "stopped after" in done.stdout and str(tmp_path / "cassandra_ros") in done.stdout
    done = type_in("clear")
    assert done.returncode == 1
    assert "--yes" in done.stderr and str(tmp_path / "cassandra_ros") in done.stderr
    assert answered(env, "n\n") == 1
    assert (tmp_path / "cassandra_ros" / "node1").exists()
    assert answered(env, "y\n") == 0
    assert not (tmp_path / "cassandra_ros" / "node1").exists()


@pytest.mark.suite("all", "it starts a Cassandra")
def test_run_lets_clients_go_before_it_stops(env, tmp_path):
    port = free_port()
    process = subprocess.Popen(
        [sys.executable, str(ROOT / "scripts/local_cassandra"), "run", "--port", str(port)],
        stdout=subprocess.PIPE,
        text=True,
        env=env,
    )
    try:
        assert "answers at" in process.stdout.readline()
        with socket.create_connection(("127.0.0.1", port)):
            process.send_signal(signal.SIGINT)
            begun = time.monotonic()
            time.sleep(1.5)
            # On a machine so busy that the answer comes too late, it has waited as long as it may.
            answers = answers_cql("127.0.0.1", port, timeout_sec=60)
            assert answers or time.monotonic() - begun > local_cassandra.CLIENTS_SEC
        assert process.wait(300) == 0
        assert not answers_cql("127.0.0.1", port)
    finally:
        process.kill()
        process.stdout.close()
        LocalCluster(tmp_path / "cassandra_ros").stop()


@pytest.mark.suite("all", "it starts a Cassandra")
@pytest.mark.parametrize(
    "number", sparing([signal.SIGINT, signal.SIGTERM, signal.SIGKILL], kept=[signal.SIGKILL])
)
def test_run_in_the_foreground_takes_the_server_along(env, tmp_path, number):
    process = subprocess.Popen(
        [
            sys.executable,
            str(ROOT / "scripts/local_cassandra"),
            *("run", "--port", str(free_port()), "__name:=cassandra"),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=env,
    )
    cluster_folder = tmp_path / "cassandra_ros"
    try:
        lines = iter(process.stdout.readline, "")
        assert any("answers at" in line for line in lines)  # warnings may come before it
        cluster = LocalCluster(cluster_folder)
        [status] = cluster.status()
        assert answers_cql("127.0.0.1", cluster.settings.port, timeout_sec=60)
        process.send_signal(number)
        assert process.wait(300) == (0 if number != signal.SIGKILL else -signal.SIGKILL)
        deadline = time.monotonic() + 300
        while processes.command_line(status.pid) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not processes.command_line(status.pid)
        assert "Cassandra shutdown complete" in status.node.log.read_text()
    finally:
        process.kill()
        process.stdout.close()
        LocalCluster(cluster_folder).stop()
