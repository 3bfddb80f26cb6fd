# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Writes the options of recorder and player into their pages and launch files: ``make doc``.

The parsers of the programs are the source. What is written stands between two comments of each
file, BEGIN and END below; all else in it is written by hand.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Iterable, Iterator, Mapping, Sequence
from xml.sax.saxutils import quoteattr

from cassandra_ros.cli import player, recorder
from cassandra_ros.cli.parameters import COMMAND_LINE_ONLY, long_name

ROOT = Path(__file__).resolve().parents[1]
BEGIN, END = "<!-- options: written by 'make doc' -->", "<!-- end of the options -->"
_OURS = "ours"
LIKE_RECORD = {
    "keep": "-a -e --node -l --duration -b --tcpnodelay -q -h",
    "adapt": "-x -o -O --split --size --max-splits --repeat-latched -p -s -L -j --lz4 --chunksize",
    "drop": "--udp",
}
"""Options of rosbag record: those that mean the same here, or nearly, and those without use."""
LIKE_PLAY = {
    "keep": "--topics -s -u -r --pause --pause-topics --skip-empty -l -k --wait-for-subscribers "
    "--rate-control-topic --rate-control-max-delay -p --queue --clock --hz -q -h",
    "adapt": "-i -d",
}
NOT_PLAYED = (
    ("--bags", "adapt", "a store has runs instead of files: `--run`"),
    (
        "--try-future-version",
        "drop",
        "a bag is imported first; one of an unknown version is refused there",
    ),
)
"""Options of rosbag play that the player lacks."""
_STORE = ("host", "port", "keyspace", "cqlshrc", "credentials")
"""Arguments that a launch file has once for all its nodes."""


def tables(
    parser: argparse.ArgumentParser,
    like: Mapping[str, str],
    lacking: Sequence[tuple[str, str, str]] = (),
) -> str:
    """Return a table for each group of options: names, kind, help text."""
    kinds = {name: kind for kind, names in like.items() for name in names.split()}
    parts: list[str] = []
    for group in parser._action_groups:
        rows = list(_rows(group._group_actions, kinds))
        if group.title == "options":
            rows += [f"| `{name}` | {kind} | {text} |" for name, kind, text in lacking]
        if rows:
            text = f"\n{_sentence(group.description)}\n" if group.description else ""
            head = "| option | | here |\n| --- | --- | --- |"
            parts.append(f"### {_sentence(group.title or '')}\n{text}\n{head}\n" + "\n".join(rows))
    return "\n\n".join(parts)


def _rows(actions: Iterable[argparse.Action], kinds: Mapping[str, str]) -> Iterator[str]:
    for action in actions:
        if action.option_strings:
            names = ", ".join(f"`{name}`" for name in action.option_strings)
            value = f" *{_escaped(action.metavar)}*" if isinstance(action.metavar, str) else ""
            kind = next((kinds[n] for n in action.option_strings if n in kinds), _OURS)
            yield f"| {names}{value} | {kind} | {_escaped(_help(action))} |"


def _help(action: argparse.Action) -> str:
    return (action.help or "") % vars(action)


def _escaped(text: str) -> str:
    for sign in "|*<>[]":
        text = text.replace(sign, f"\\{sign}")
    return text


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _by_argument(
    parser: argparse.ArgumentParser, without: Sequence[str] = ()
) -> dict[str, argparse.Action]:
    """Return the options of a program by the names of their arguments in a launch file."""
    return {
        long_name(action): action
        for action in parser._actions
        if action.dest == "quiet" or action.dest not in COMMAND_LINE_ONLY
        if action.dest not in without
    }


def _argument(name: str, action: argparse.Action, default: str = "") -> str:
    is_flag = action.nargs == 0
    value = ("true" if action.const is False else "false") if is_flag else default
    text = f"false: {_help(action)}" if action.const is False else _help(action)
    return f'  <arg name="{name}" default="{value}" doc={quoteattr(text)} />'


def recorder_arguments() -> tuple[str, str]:
    """Return the arguments of the launch file that are the recorder's, and its parameters."""
    named = _by_argument(recorder.make_parser(), (*_STORE, "quiet"))
    arguments = [
        _argument(name, action, "-a" if name == "topics" else "") for name, action in named.items()
    ]
    parameters = []
    for name, action in named.items():
        # Lists of YAML; but a regular expression is given as it is, without quotes for YAML.
        if isinstance(action.default, list) and name != "exclude":
            value = f'<rosparam param="{name}" subst_value="true">[$(arg {name})]</rosparam>'
        else:
            kind = "bool" if action.nargs == 0 else "str"
            value = f'<param name="{name}" value="$(arg {name})" type="{kind}" />'
        parameters.append(f"    {value}")
    return "\n".join(arguments), "\n".join(parameters)


def player_arguments() -> str:
    """Return the arguments of the launch file of the player, and how its command line has them."""
    parser = player.make_parser()
    named = _by_argument(parser, ("more",))  # --topics says the same as the argument topics
    named["stores"] = named.pop("store")
    lines = [_argument(name, action) for name, action in named.items()]
    flags = [
        f"('{action.option_strings[-1]} ' if {name} else '')"
        for name, action in named.items()
        if action.nargs == 0
    ]
    flags += [
        "' '.join(['--store ' + store for store in stores.split()])",
        "(' --pause-topics ' + pause_topics if pause_topics else '')",
    ]
    single = [name for name, action in named.items() if action.nargs is None and name != "stores"]
    values = [f"--{name.replace('_', '-')}=&quot;$(arg {name})&quot;" for name in single]
    joint = " +\n              "
    lines += [
        f'  <arg name="flags"\n       value="$(eval {joint.join(flags)})" />',
        '  <arg name="values"\n       value="' + "\n              ".join(values) + '" />',
    ]
    return "\n".join(lines)


def written(path: Path, *parts: str) -> str:
    """Return the text of a file with new parts between its comments BEGIN and END."""
    text = path.read_text(encoding="utf-8")
    pieces = text.split(BEGIN)
    assert len(pieces) == len(parts) + 1, path  # noqa: S101 - a file of this repository
    after = [piece.split(END, 1)[1] for piece in pieces[1:]]
    blank = "\n" if path.suffix == ".md" else ""
    return pieces[0] + "".join(
        f"{BEGIN}\n{blank}{part}\n{blank}{_indent(piece)}{END}{rest}"
        for part, piece, rest in zip(parts, pieces, after)
    )


def _indent(before: str) -> str:
    return before[len(before.rstrip(" ")) :]


def texts() -> dict[Path, str]:
    """Return the text that each file should have."""
    doc, launch = ROOT / "doc", ROOT / "launch"
    play = tables(player.make_parser(), LIKE_PLAY, NOT_PLAYED)
    return {
        doc / "record.md": written(doc / "record.md", tables(recorder.make_parser(), LIKE_RECORD)),
        doc / "play.md": written(doc / "play.md", play),
        launch / "cassandra_ros.launch": written(
            launch / "cassandra_ros.launch", *recorder_arguments()
        ),
        launch / "play.launch": written(launch / "play.launch", player_arguments()),
    }


if __name__ == "__main__":
    for variable in [name for name in os.environ if name.startswith("CASSANDRA_ROS_")]:
        del os.environ[variable]  # the pages have the defaults of a user who has set none
    for file, content in texts().items():
        file.write_text(content, encoding="utf-8")
