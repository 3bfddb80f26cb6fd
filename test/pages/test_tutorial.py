# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The tutorial is walked from its first command to its last, on a Cassandra of its own."""

from __future__ import annotations

import dataclasses

import pytest
from conftest import ROOT, SHARED
from pages.walk import Walk, check, commands, pieces

from cassandra_ros.local_server import LocalCluster, free_port
from cassandra_ros.local_server.cluster_settings import new_settings, save_settings

TUTORIAL = (ROOT / "doc/tutorial.md").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def home(ros_env, tmp_path, monkeypatch):
    """A home of its own, where the local Cassandra takes a free port and little memory."""
    data = tmp_path / "ros/cassandra_ros"
    data.mkdir(parents=True)
    settings = dataclasses.replace(new_settings(), port=free_port(), heap_mb=512)
    save_settings(data, settings)
    env = {name: text for name, text in ros_env.items() if not name.startswith("CASSANDRA_ROS_")}
    env.update(
        HOME=str(tmp_path),
        ROS_HOME=str(data.parent),
        ROS_LOG_DIR=str(tmp_path / "log"),
        ROS_MASTER_URI=f"http://127.0.0.1:{free_port()}",
        CASSANDRA_ROS_JARS=ros_env["CASSANDRA_ROS_JARS"],
        CASSANDRA_ROS_PORT=str(settings.port),
        JAVA_TOOL_OPTIONS=SHARED,
    )
    for name in ("CASSANDRA_ROS_HOST", "CASSANDRA_ROS_KEYSPACE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("CASSANDRA_ROS_PORT", str(settings.port))
    try:
        yield env
    finally:
        LocalCluster(data).stop()


def with_ports(text, cassandra, viewer):
    """Return the page for a machine where others have its ports."""
    text = text.replace("127.0.0.1:9042", f"127.0.0.1:{cassandra}")
    text = text.replace("127.0.0.1:8080", f"127.0.0.1:{viewer}")
    return text.replace("cassandra_ros viewer\n", f"cassandra_ros viewer --port {viewer}\n")


@pytest.mark.suite("all", "it types the whole tutorial")
def test_every_command_of_the_tutorial_does_what_it_shows(home):
    walk = Walk(home)
    try:
        walk.follow(with_ports(TUTORIAL, home["CASSANDRA_ROS_PORT"], free_port()))
    finally:
        walk.close()
    assert len(walk.typed) > 20


def shown(text):
    """Commands and lines of Python of a page."""
    for language, block in pieces(text):
        if language == "python":
            yield from (line for line in block.splitlines() if line.startswith(">>> "))
        elif language != "comment":
            yield from (
                command.partition("  #")[0].rstrip() for command, _ in commands(language, block)
            )


def test_what_the_readme_shows_is_in_the_tutorial():
    """The tests run the tutorial, so they run these commands, except make demo and make test."""
    steps = README.split("## First steps")[1]
    known = set(shown(TUTORIAL))
    assert [line for line in shown(steps) if line not in known] == []
    blocks = {block for _, block in pieces(TUTORIAL)}
    for language, block in pieces(steps):
        if language in ("python", ""):
            assert block in blocks, block


def test_a_walk_notices_what_is_wrong(ros_env):
    walk = Walk(ros_env)
    try:
        walk.follow("```\n$ echo a b 7 s\na … 8 s\n$ false\n```\n\n```sh\nexport A=1\n```\n")
        for page in (
            "```sh\nfalse\n```\n",
            "```\n$ echo $A\n2\n```\n",
            "```sh\necho 1\n```\n```\n2\n```\n",
            "```python\n>>> 1 + 1\n3\n```\n",
        ):
            with pytest.raises(AssertionError):
                walk.follow(page)
        walk.follow(
            "<!-- terminal 2 -->\n<!-- until: on -->\n```sh\necho on; sleep 100\n```\n"
            "<!-- terminal 1 -->\n```\n$ echo $A\n1\n```\n<!-- terminal 2 -->\n<!-- Ctrl-C -->\n"
        )
    finally:
        walk.close()
    with pytest.raises(AssertionError):
        check("a", "b")
    check("answers after 7 s\n", "starting (pid 7): waiting for it … 10 s\nanswers after 12 s\n")
    check(
        "run a\n", "[WARN] [1.0]: waiting for the ROS master at http://h:1 (x): start it\nrun a\n"
    )
