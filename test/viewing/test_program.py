# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""rosrun cassandra_ros viewer, as a person starts and ends it."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request

import pytest
from conftest import ROOT
from nodes.children import Child, await_true

from cassandra_ros.cli.viewer import make_parser, read_settings
from cassandra_ros.errors import InvalidOption
from cassandra_ros.viewing.viewer_server import address
from cassandra_ros.viewing.viewer_settings import ViewerSettings

VIEWER = [sys.executable, ROOT / "scripts" / "viewer"]


@pytest.fixture
def env(ros_env, cassandra, tmp_path):
    """Return the environment of a shell whose temporary folder shows what is left in it."""
    found = dict(ros_env, PYTHONPATH=f"{ROOT / 'src'}:{ros_env.get('PYTHONPATH', '')}")
    found.update(
        CASSANDRA_ROS_HOST=cassandra.host,
        CASSANDRA_ROS_PORT=str(cassandra.port),
        CASSANDRA_ROS_CQLSHRC=os.devnull,
        TMPDIR=str(tmp_path),
    )
    return found


def read(url):
    with urllib.request.urlopen(url, timeout=180) as answer:  # noqa: S310 -- our own
        return answer.read()


@pytest.mark.suite("test", "the program from its start to its end")
def test_it_prints_its_address_answers_and_ends_by_ctrl_c(env, new_keyspace, tmp_path):
    words = ["--port", "0", "--keyspace", new_keyspace, "__name:=viewer", "--token="]
    child = Child([*VIEWER, *words], env)
    url = re.search(r"http://127\.0\.0\.1:[0-9]+/", child.await_line("http://"))[0]
    try:
        assert f"there is no keyspace '{new_keyspace}'" in child.output
        assert new_keyspace.encode() in read(url + "api/keyspace")
        assert b"<html" in read(url)
        port = url.rstrip("/").rpartition(":")[2]
        second = subprocess.run(
            [*VIEWER, "--port", port], env=env, capture_output=True, text=True, timeout=300
        )
        assert second.returncode == 1
        told = second.stderr.splitlines()[-1]
        assert told.startswith(f"viewer: 127.0.0.1 port {port} is taken by another program")
        assert f"--port {int(port) + 1}" in told
    finally:
        status = child.end(signal.SIGINT)
    assert status == 0, child.output
    assert "Traceback" not in child.output
    with contextlib.suppress(urllib.error.URLError):  # or another test's viewer has its port now
        assert new_keyspace.encode() not in read(url + "api/keyspace")
    assert list(tmp_path.iterdir()) == []


def test_for_others_it_makes_a_token_and_prints_it(env, keyspace, tmp_path):
    browser, opened = tmp_path / "browser", tmp_path / "opened"
    browser.write_text(f'#!/bin/sh\necho "$1" > {opened}.new; mv {opened}.new {opened}\n')
    browser.chmod(0o755)
    env["BROWSER"] = str(browser)
    others = ["--open", "--host", "0.0.0.0", "--port", "0"]  # noqa: S104 -- what is tested
    child = Child([*VIEWER, *others, "--keyspace", keyspace], env)
    try:
        line = child.await_line("http://")
        port, token = re.search(
            rf"http://{socket.gethostname()}:(\d+)/\?token=(\S+)", line
        ).groups()
        assert len(token) > 20
        await_true(opened.exists)
        assert opened.read_text().strip() in line
        url = f"http://127.0.0.1:{port}/api/keyspace"
        with pytest.raises(urllib.error.HTTPError, match="401"):
            read(url)
        assert keyspace.encode() in read(f"{url}?token={token}")
    finally:
        status = child.end(signal.SIGTERM)
    assert status == 0, child.output


def test_what_it_cannot_do_is_told_in_a_line(env):
    program = (
        "import sys\nsys.modules['aiohttp'] = None\n"
        "from cassandra_ros.cli.script import run_script\nrun_script('cassandra_ros.cli.viewer')"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], env=env, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 1
    assert done.stderr.startswith("viewer: the viewer needs the Python package aiohttp, which is")
    assert f"-m pip install -r {ROOT / 'requirements/viewer.txt'}" in done.stderr
    assert done.stderr.count("\n") == 1


def settings_of(*words):
    return read_settings(make_parser().parse_args(words))


@pytest.fixture
def no_login(monkeypatch, tmp_path):
    """An environment without a login of cqlsh's files, and without a token."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("TOKEN", "CQLSHRC"):
        monkeypatch.delenv(f"CASSANDRA_ROS_{name}", raising=False)
    return tmp_path


@pytest.mark.usefixtures("no_login")
def test_options_become_settings(monkeypatch):
    usual = settings_of()
    assert usual == ViewerSettings()
    assert (usual.host, usual.port, usual.token) == ("127.0.0.1", 8080, "")
    origins = ("--allow-origin", "https://a.b/", "--allow-origin", "http://localhost:3000")
    found = settings_of(*origins, "--port", "9000", "--cache", "/x", "--cache-size", "2G")
    assert found.allow_origin == ("https://a.b", "http://localhost:3000")
    assert (found.port, str(found.cache), found.cache_bytes) == (9000, "/x", 2 << 30)
    assert settings_of("--token", "t").token == "t"  # noqa: S105
    assert settings_of("--host", "::1").token == ""
    first, second = (settings_of("--host", "10.0.0.1").token for _ in range(2))
    assert first != second
    monkeypatch.setenv("CASSANDRA_ROS_TOKEN", "kept")
    assert settings_of("--host", "10.0.0.1").token == settings_of().token == "kept"  # noqa: S105
    options = make_parser().parse_args(["--store-host", "a,b", "--store-port", "9999"])
    assert (options.host, options.port) == ("a,b", 9999)
    for wrong in (("--port", "65536"), ("--port", "-1"), ("--cache-size", "much")):
        with pytest.raises(SystemExit):
            make_parser().parse_args(wrong)


def login_file(path, text="[PlainTextAuthProvider]\nusername = ann\npassword = x\n"):
    path.write_text(text)
    path.chmod(0o600)
    return str(path)


def test_of_a_store_with_a_login_it_asks_this_machine_for_a_token(no_login, monkeypatch, capsys):
    login = ("--credentials", login_file(no_login / "mine"))
    first, second = (settings_of(*login).token for _ in range(2))
    assert len(first) > 20 and first != second
    assert settings_of(*login, "--no-token") == settings_of() == ViewerSettings()
    by_key = "[connection]\nssl = true\n[ssl]\nvalidate = false\nuserkey = a\nusercert = b\n"
    assert settings_of("--cqlshrc", login_file(no_login / "rc", by_key)).token
    # The stores of a fleet may each have a login of their own.
    stores = f"[home]\nplace = a:1\n[husky]\nplace = b:2\ncredentials = {login[1]}\n"
    fleet = ("--store-file", login_file(no_login / "stores", stores), "--store", "home")
    assert settings_of(*fleet).token == ""
    assert settings_of(*fleet, "--store", "husky").token
    monkeypatch.setenv("CASSANDRA_ROS_TOKEN", "kept")
    assert settings_of(*login).token == "kept"  # noqa: S105
    assert settings_of(*login, "--no-token").token == ""
    for wrong, reason in (
        (("--host", "0.0.0.0"), "--no-token: other machines"),  # noqa: S104 -- what is tested
        (("--token", "t"), "not allowed with argument"),
        (("--token-file", "f"), "not allowed with argument"),
    ):
        with pytest.raises(SystemExit):
            settings_of(*wrong, "--no-token")
        assert reason in capsys.readouterr().err


@pytest.mark.usefixtures("no_login")
def test_a_token_is_read_from_a_file_or_a_descriptor(tmp_path, monkeypatch):
    monkeypatch.setenv("CASSANDRA_ROS_TOKEN", "of the environment")
    path = tmp_path / "token"
    assert settings_of("--token-file", login_file(path, " kept \nmore\n")).token == "kept"  # noqa: S105
    reads, writes = os.pipe()
    os.write(writes, "t\u00f6ken\n".encode())
    os.close(writes)
    assert settings_of("--token-file", f"/dev/fd/{reads}").token == "t\u00f6ken"  # noqa: S105
    os.close(reads)
    for text, mode, reason in (
        (b"\nkept\n", 0o600, "its first line is empty"),
        (b"", 0o600, "its first line is empty"),
        (b"\xff\n", 0o600, "cannot be read"),
        (b"kept\n", 0o644, f"chmod 600 {path}"),
    ):
        path.write_bytes(text)
        path.chmod(mode)
        with pytest.raises(InvalidOption, match=reason):
            settings_of("--token-file", str(path))
    for wrong in (tmp_path / "none", tmp_path):
        with pytest.raises(InvalidOption, match="cannot be read"):
            settings_of("--token-file", str(wrong))
    done = subprocess.run(
        [*VIEWER, "--token-file", str(tmp_path / "none")], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert done.stderr.startswith(f"viewer: --token-file {tmp_path / 'none'} cannot be read: ")


def test_the_address_is_one_that_a_browser_opens():
    assert address(ViewerSettings(), 8080) == "http://127.0.0.1:8080/"
    assert address(ViewerSettings(host="::1"), 1) == "http://[::1]:1/"
    shown = address(ViewerSettings(host="0.0.0.0", token="a b/ü"), 80)  # noqa: S104, S106
    assert shown == f"http://{socket.gethostname()}:80/?token=a%20b/%C3%BC"
