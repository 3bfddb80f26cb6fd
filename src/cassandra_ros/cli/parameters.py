# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Private ROS parameters of a node: one for each option of its program, with _ for -: ~node_id."""

from __future__ import annotations

import argparse
from typing import Collection, Mapping

from cassandra_ros.cli.parsers import Parser
from cassandra_ros.errors import InvalidOption
from cassandra_ros.quantities import truth

COMMAND_LINE_ONLY = ("help", "help_all", "version", "quiet", "dry_run", "udp")
"""Options that are no parameters: they end the program at once, concern its terminal, or are
refused."""


def parameter_words(
    parser: Parser, parameters: Mapping[str, object], without: Collection[str] = ()
) -> list[str]:
    """Return the parameters of a node as arguments, to be put before those of the command line.

    The parser has just read the command line. Parameters that it gives, too, are left out; only
    lists get the values of both. Empty parameters, which a launch file may set, count as missing.

    Args:
        parser: Parser of the program.
        parameters: Values by the names of the parameters.
        without: Names in the parsed options (``dest``) whose parameters are left out, because the
            command line gives them in another way.
    """
    actions = actions_by_parameter(parser)
    words: list[str] = []
    for name, value in parameters.items():
        action = actions.get(name)
        if action is None and isinstance(value, dict):
            continue  # of another node, in a namespace that has the node's name
        if action is None:
            parser.error(f"there is no parameter ~{name}: parameters are called like options")
        if isinstance(value, dict):
            parser.error(f"parameter ~{name} is a mapping: give a text, or a list of texts")
        if action.dest in parser.given or action.dest in without or value == "":
            continue
        values = value if isinstance(value, list) else [value]
        if not action.option_strings:
            texts = value.split() if isinstance(value, str) else map(str, values)
            # ~topics may be -a, as for rosbag record; all options have their long names here.
            words += ["--all" if text == "-a" else text for text in texts]
        elif action.nargs == 0:
            # --no-diagnostics and its like are given if the parameter is false.
            try:
                if truth(str(value)) != (action.const is False):
                    words.append(action.option_strings[-1])
            except InvalidOption as exc:
                parser.error(f"parameter ~{name}: {exc}")
        else:
            words += [f"{action.option_strings[-1]}={text}" for text in values if text != ""]
    return words


def long_name(action: argparse.Action) -> str:
    """Return the name of an option for parameters and launch files: its last long name, with _.

    A flag that turns something off is named after what it turns off: ~diagnostics, because
    ~no_diagnostics would mean the opposite.
    """
    is_off = action.nargs == 0 and action.const is False
    if is_off or not action.option_strings:
        return action.dest
    return action.option_strings[-1].lstrip("-").replace("-", "_")


def actions_by_parameter(parser: argparse.ArgumentParser) -> Mapping[str, argparse.Action]:
    """Return the options of a parser by the names of their parameters: ``dest`` and long_name."""
    actions: dict[str, argparse.Action] = {}
    for action in parser._actions:
        if action.dest not in COMMAND_LINE_ONLY:
            actions.update(dict.fromkeys((action.dest, long_name(action)), action))
    return actions
