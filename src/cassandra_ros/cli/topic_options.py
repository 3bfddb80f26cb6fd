# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How topics are named on a command line: by name, or with -e by regular expressions."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, AbstractSet

from cassandra_ros.errors import TopicNotFound
from cassandra_ros.topics.patterns import matching

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra

_EXPRESSION = set("*+?[](){}|^$\\")
"""Signs that are in no topic of ROS."""


def add_topics(
    parser: argparse._ActionsContainer,
    text: str = "only these topics (default: all)",
    nargs: str = "*",
) -> None:
    """Add TOPIC ... as the verb's own words, and -e; stored_topics reads them.

    Args:
        text: What the topics are for.
        nargs: '*', or '+' where at least one must be named.
    """
    parser.add_argument("topics", nargs=nargs, metavar="TOPIC", help=text)
    parser.add_argument(
        "-e",
        "--regex",
        action="store_true",
        help="each TOPIC is a regular expression, which must match the whole name",
    )


def add_topics_option(parser: argparse._ActionsContainer, behind: str) -> None:
    """Add --topics and -e REGEX to a verb whose own words are files; either may be given.

    Args:
        behind: The word that --topics must stand behind, as 'FILE.bag'.
    """
    parser.add_argument(
        "--topics",
        nargs="+",
        metavar="TOPIC",
        help=f"only these topics (default: all; stands behind {behind})",
    )
    parser.add_argument(
        "-e",
        "--regex",
        metavar="REGEX",
        action="append",
        help="only topics whose whole name matches this regular expression, beside those of "
        "--topics; may be repeated",
    )


def stored_topics(ros_cas: RosCassandra, options: argparse.Namespace) -> list[str] | None:
    """Return the names of the topics that are asked for, as they are stored; None = all.

    Raises:
        TopicNotFound: A topic is not stored, or an expression matches none.
        InvalidOption: An expression is none.
    """
    names, expressions = _asked(options)
    if names is None and expressions is None:
        return None
    found = {}
    for name in names or ():
        try:
            found[ros_cas.getTopic(name).name] = True
        except TopicNotFound as exc:
            raise TopicNotFound(f"{exc}{_hint(name)}") from exc
    if expressions:
        every = {topic.name for topic in ros_cas.getAllTopics()}
        where = f"keyspace {ros_cas.keyspace}"
        found.update(dict.fromkeys(sorted(matching("-e", expressions, every, where)), True))
    return list(found)


def topics_among(
    options: argparse.Namespace, present: AbstractSet[str], where: str
) -> list[str] | None:
    """Return the names that are asked for of those that a file holds; None = all.

    Names stay as they were given: who reads the file finds them with or without slash.

    Raises:
        TopicNotFound: An expression matches none.
        InvalidOption: An expression is none.
    """
    names, expressions = _asked(options)
    if names is None and expressions is None:
        return None
    found = set(names or ()) | matching("-e", expressions or (), present, where)
    return sorted(found)


def _asked(options: argparse.Namespace) -> tuple[list[str] | None, list[str] | None]:
    """Return the names and the expressions of either way to give them."""
    if isinstance(options.regex, bool):
        asked = options.topics or None
        return (None, asked) if options.regex else (asked, None)
    return options.topics, options.regex


def _hint(name: str) -> str:
    if _EXPRESSION.isdisjoint(name):
        return ""
    return "; names are taken as they stand: with -e (--regex) they are regular expressions"
