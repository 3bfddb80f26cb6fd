# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Completion with the Tab key: verbs, options, and topics, fields, runs and robots of the store.

The shell runs a program with an environment variable set, and argcomplete prints the candidates.
'cassandra_bag --completion' prints the shell code that does so.
"""

from __future__ import annotations

import argparse
import os
import sys
from itertools import islice
from typing import TYPE_CHECKING, Callable, Iterable

from cassandra_ros.cli.options import open_store
from cassandra_ros.cli.parsers import ASKED
from cassandra_ros.errors import CassandraRosError

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra

_MOST_EVENTS = 1000
"""Maximum number of events that are read for the candidates of --event."""


def answer_shell(parser: argparse.ArgumentParser) -> None:
    """If the shell asks for candidates, print them and end the program; else do nothing.

    Without argcomplete there are no candidates. If the store does not answer, there are no
    candidates from the store.
    """
    if ASKED not in os.environ:
        return
    try:
        import argcomplete
    except ImportError:
        sys.exit(1)  # the incomplete command line must not be executed
    offer_values(parser)
    argcomplete.autocomplete(parser)


def offer_values(parser: argparse.ArgumentParser) -> None:
    """Set the function that returns candidates for each argument of a parser and of its verbs."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                offer_values(verb)
        elif action.dest in _OFFERED and not action.choices and action.nargs != 0:
            action.completer = _completer(_OFFERED[action.dest])  # type: ignore[attr-defined]


_Offer = Callable[["RosCassandra", argparse.Namespace], Iterable[str]]
"""Function of the store and the options typed so far that returns candidates."""


def _completer(offer: _Offer) -> Callable[..., list[str]]:
    """Return the function that argcomplete calls for candidates, with the options typed so far."""

    def complete(parsed_args: argparse.Namespace, **_: object) -> list[str]:
        try:
            file_topics = _topics_of_files(parsed_args) if offer is _topics else None
            if file_topics is not None:
                return file_topics
            with open_store(parsed_args, make=True) as ros_cas:
                # The shell prints candidates as they are, and cannot enter unprintable characters.
                return sorted(filter(str.isprintable, offer(ros_cas, parsed_args)))
        except CassandraRosError:
            return []  # the shell cannot show an error here

    return complete


def _topics(ros_cas: RosCassandra, _options: argparse.Namespace) -> Iterable[str]:
    return [topic.name for topic in ros_cas.getAllTopics()]


def _topics_of_files(options: argparse.Namespace) -> list[str] | None:
    """Return the topics of the files of import or verify; None = the store has the topics.

    So it is for other verbs, and with --parquet, which takes a folder.
    """
    if getattr(options, "verb", "") not in ("import", "verify"):
        return None
    if getattr(options, "parquet", False):
        return None
    from cassandra_ros.files.bag.file_formats import open_file

    files = options.bags if options.verb == "import" else [options.bag]
    if files == [None]:  # verify --with another store
        return None
    topics = set()
    for path in files or ():
        with open_file(path) as reader:
            topics |= {connection.topic for connection in reader.connections.values()}
    return sorted(topics)


def _fields(ros_cas: RosCassandra, options: argparse.Namespace) -> Iterable[str]:
    from cassandra_ros.query.tree.field_names import all_fields

    named = getattr(options, "topics", None) or getattr(options, "topic", None) or ()
    topics = [named] if isinstance(named, str) else named
    tables = (table for name in topics for table in ros_cas.getTopic(name).tables)
    definitions = (table.definition for table in tables)
    return {
        field.column for definition in definitions if definition for field in all_fields(definition)
    }


def _runs(ros_cas: RosCassandra, _options: argparse.Namespace) -> Iterable[str]:
    return {run.name or str(run.writer) for run in ros_cas.runs()}


def _nodes(ros_cas: RosCassandra, _options: argparse.Namespace) -> Iterable[str]:
    return {info.node for info in ros_cas.info() if info.node}


def _keyspaces(ros_cas: RosCassandra, _options: argparse.Namespace) -> Iterable[str]:
    return [keyspace.name for keyspace in ros_cas.getKeyspaces()]


def _events(ros_cas: RosCassandra, _options: argparse.Namespace) -> Iterable[str]:
    return {event.name for event in islice(ros_cas.events(), _MOST_EVENTS)}


_OFFERED = {
    **dict.fromkeys(("topic", "topics", "more", "pause_topics", "odom", "store"), _topics),
    "field": _fields,
    **dict.fromkeys(("run", "name"), _runs),
    "event": _events,
    "node_id": _nodes,
    "keyspace": _keyspaces,
}
"""Name of an argument (its ``dest``) -> function that returns its candidates."""
