# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the Tab key offers, asked for by a real shell as the printed lines have it ask."""

from __future__ import annotations

import shlex
import subprocess
import sys

import pytest
from bag.truth import string_connection, string_wire
from conftest import WORKSPACE

from cassandra_ros.cli import cassandra_bag
from cassandra_ros.files.bag.bag_writer import BagWriter

# Bash and zsh call the function of a command with what was typed in these variables.
TAB = 'COMP_LINE={0} COMP_POINT=${{#COMP_LINE}}; {1}; printf "%s|" "${{COMPREPLY[@]}}"; echo'


@pytest.fixture
def press_tab(ros_env, env):
    """Return what a shell offers for each of some lines that were typed so far."""

    def run(*lines, shell="bash"):
        program = WORKSPACE / "devel/bin/cassandra_bag"
        text = [] if shell == "bash" else ["autoload -U compinit", "compinit -u"]
        text.append(f'eval "$({program} --completion {shell})"')
        for line in lines:
            asked = "_cassandra_ros_bag"
            if line.startswith("rosrun "):  # bash also splits the line for it
                words = shlex.split(line)
                asked = f"COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; _cassandra_ros_rosrun"
            text.append(TAB.format(shlex.quote(line), asked))
        options = ["--norc"] if shell == "bash" else ["-f"]
        done = subprocess.run(
            [shell, *options, "-c", "\n".join(text)],
            env={**ros_env, **{k: v for k, v in env.items() if k.startswith("CASSANDRA_ROS_")}},
            capture_output=True,
            text=True,
            timeout=300,
        )
        return [
            [word.strip() for word in line.split("|")[:-1]] for line in done.stdout.splitlines()
        ]

    return run


@pytest.mark.suite("all", "it starts many programs")
@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_verbs_options_topics_and_fields(shell, press_tab, call, tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        for topic in ("/cam/left", "/cam/right", "/tf"):
            writer.write(writer.connection(string_connection(topic)), 1, string_wire("x"))
    assert call("import", path, "--topics", "/cam/left", "/tf", "-q") == (0, "", "")
    lines = {
        "cassandra_bag ver": ["verify"],
        "cassandra_bag export --comp": ["--compression"],
        "cassandra_bag info /c": ["/cam/left"],
        f"cassandra_bag verify {tmp_path} --parquet --topics /c": ["/cam/left"],
        "cassandra_bag --comp": ["--completion"],
        "cassandra_bag index /tf d": ["data"],
        f"cassandra_bag verify {path} --topics /cam": ["/cam/left", "/cam/right"],
        "cassandra_bag verify --with home --topics /cam": ["/cam/left"],
    }
    assert press_tab(*lines, shell=shell) == list(lines.values())


@pytest.mark.suite("all", "it starts a program")
def test_bash_also_completes_the_other_programs_after_rosrun(press_tab):
    assert press_tab("rosrun cassandra_ros recorder --no-sp") == [["--no-spool"]]


def test_a_tab_runs_nothing_where_argcomplete_is_missing(monkeypatch, capsys):
    monkeypatch.setenv("_ARGCOMPLETE", "1")
    monkeypatch.setitem(sys.modules, "argcomplete", None)
    with pytest.raises(SystemExit) as ended:
        cassandra_bag.main(["delete", "--yes", "/tf"])
    assert ended.value.code == 1
    assert capsys.readouterr() == ("", "")


def test_how_it_is_switched_on_is_in_the_help(capsys):
    with pytest.raises(SystemExit):
        cassandra_bag.main(["--help"])
    assert 'eval "$(cassandra_bag --completion bash)"' in capsys.readouterr().out
