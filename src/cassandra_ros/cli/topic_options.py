# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Options that select topics: by name, or with -e by regular expressions."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, AbstractSet

from cassandra_ros.arguments import matching
from cassandra_ros.errors import TopicNotFound

if TYPE_CHECKING:
    from cassandra_ros.topics.catalog import Catalog

_EXPRESSION = set("*+?[](){}|^$\\")
"""Characters that never occur in a ROS topic name."""


def add_topics(
    parser: argparse._ActionsContainer,
    text: str = "only these topics (default: all)",
    nargs: str = "*",
) -> None:
    """Add TOPIC ... as positional arguments, and -e; stored_topics reads them.

    Args:
        text: Help text of TOPIC.
        nargs: '*', or '+' if at least one topic must be given.
    """
    parser.add_argument("topics", nargs=nargs, metavar="TOPIC", help=text)
    parser.add_argument(
        "-e",
        "--regex",
        action="store_true",
        help="each TOPIC is a regular expression, which must match the whole name",
    )


def add_topics_option(parser: argparse._ActionsContainer, after: str) -> None:
    """Add --topics and -e REGEX to a verb whose positional arguments are files.

    Args:
        after: The argument after which --topics must be given, as 'FILE.bag'.
    """
    parser.add_argument(
        "--topics",
        nargs="+",
        action="extend",
        metavar="TOPIC",
        help=f"only these topics (default: all); give it after {after}; may be repeated",
    )
    parser.add_argument(
        "-e",
        "--regex",
        metavar="REGEX",
        action="append",
        help="only topics whose whole name matches this regular expression, in addition to those "
        "of --topics; may be repeated",
    )


def stored_topics(catalog: Catalog, options: argparse.Namespace) -> list[str] | None:
    """Return the stored names of the topics that the options select; None = all topics.

    Raises:
        TopicNotFound: A topic is not stored, or no topic matches an expression.
        InvalidOption: A regular expression is invalid.
    """
    names, expressions = _names_and_expressions(options)
    if names is None and expressions is None:
        return None
    topics: list[str] = []
    for name in names or ():
        try:
            topics.append(catalog.get(name).name)
        except TopicNotFound as exc:
            raise TopicNotFound(f"{exc}{_hint(name)}") from exc
    if expressions:
        stored = {topic.name for topic in catalog.all(None)}
        where = f"keyspace {catalog.keyspace.name}"
        topics += sorted(matching("-e", expressions, stored, where))
    return list(dict.fromkeys(topics))  # each once


def topics_among(
    options: argparse.Namespace, present: AbstractSet[str], where: str
) -> list[str] | None:
    """Return the names of the topics of a file that the options select; None = all topics.

    Names that were given are not checked; the reader of the file finds them with or without slash.

    Raises:
        TopicNotFound: No topic of the file matches an expression.
        InvalidOption: A regular expression is invalid.
    """
    names, expressions = _names_and_expressions(options)
    if names is None and expressions is None:
        return None
    return sorted(set(names or ()) | matching("-e", expressions or (), present, where))


def _names_and_expressions(
    options: argparse.Namespace,
) -> tuple[list[str] | None, list[str] | None]:
    """Return the names and the regular expressions that the options give; None = not given.

    -e of add_topics is a flag that makes TOPIC ... expressions; -e of add_topics_option takes one.
    """
    if isinstance(options.regex, bool):
        given = options.topics or None
        return (None, given) if options.regex else (given, None)
    return options.topics, options.regex


def _hint(name: str) -> str:
    """Return a hint for a name that was meant as a regular expression; '' = it was not."""
    if _EXPRESSION.isdisjoint(name):
        return ""
    return "; names are taken as they stand: with -e (--regex) they are regular expressions"
