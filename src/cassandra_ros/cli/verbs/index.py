# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Make, remove or list indexes: a condition on an indexed field reads only the rows it matches.

  cassandra_bag index /cmd_vel linear.x
  cassandra_bag index /tf transforms.child_frame_id
  cassandra_bag index --list
  cassandra_bag index --places

Messages that are stored already are indexed, with a progress bar. Topics may be recorded meanwhile:
messages that a recorder is just writing are found without the index, and are indexed when you
repeat the command. Repeating it also completes an interrupted one. The index works with all storage
formats but packed. With an array field, CONTAINS finds the messages that contain a value. Texts
over 1 KiB, arrays over 256 elements and NaN are not indexed: each statement with a condition on the
topic then reads the messages that have such a value, also after the index was removed. So make no
index on the ranges of a laser scan.

With --places the places of the robots are indexed, from tf and from topics with their poses, or
with latitude and longitude, so that NEAR reads only the poses around a place. Recorders do this
themselves; use the option for imports, and for recordings with --no-places. Runs that are still
being recorded are left out; --list shows which runs are indexed.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_origin_options, add_store_options, open_store
from cassandra_ros.cli.terminal_text import MessageBar, format_table, format_time
from cassandra_ros.cli.topic_options import stored_topics
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.topics.indexes import IndexState


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topic, field, what is to be done, and the store."""
    add = parser.add_argument
    add(
        "topics",
        metavar="TOPIC",
        nargs="?",
        type=lambda text: [text],
        help="a stored topic (default, with --list: all)",
    )
    text = "TOPIC is a regular expression that must match whole names; index each of these topics"
    add("-e", "--regex", action="store_true", help=text)
    add(
        "field",
        metavar="FIELD",
        nargs="?",
        help="dotted name of a field of its messages (default: none, with --list)",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--remove", action="store_true", help="remove the index on FIELD")
    what.add_argument(
        "--list",
        action="store_true",
        help="list the indexes of TOPIC (default: of all topics), and which are incomplete",
    )
    text = "make the index of places, for all runs or those of --run and --node-id"
    add("--places", action="store_true", help=text)
    add_origin_options(parser)
    add("-q", "--quiet", action="store_true", help="print errors only")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Make, remove or list the indexes, and print what was done."""
    if options.places:
        return _places(options)
    if options.run is not None or options.node_id is not None:
        options.parser.error("--run and --node-id go with --places")
    if options.list:
        if options.field is not None:
            options.parser.error("--list goes without FIELD")
        return _list(options)
    if options.field is None:
        options.parser.error("TOPIC and FIELD are needed, or --list")
    changes = []
    with open_store(options) as ros_cas:
        for name in stored_topics(ros_cas.catalog, options) or ():
            topic = ros_cas.getTopic(name)
            if options.remove:
                topic.removeIndex(options.field)
                text, answer = " removed", {}
            else:
                with MessageBar(f"indexing {options.field}") as bar:
                    count = topic.createIndex(options.field, progress=bar.reach)
                text, answer = f": {count} stored messages were taken in", {"messages": count}
            changes.append(
                {"topic": name, "field": options.field, "removed": options.remove, **answer}
            )
            if not (options.quiet or options.json):
                print(f"index on {shown(options.field)} of topic {shown(name)}{text}")
    if options.json:
        print_json(changes)
    return 0


def _list(options: argparse.Namespace) -> int:
    """Print the indexes on fields."""
    from cassandra_ros.topics.indexes import list_indexes

    with open_store(options) as ros_cas:
        names = stored_topics(ros_cas.catalog, options)
        topics = ros_cas.getAllTopics() if names is None else map(ros_cas.getTopic, names)
        directory = ros_cas.catalog.keyspace.directory
        states = [
            state for topic in topics for state in list_indexes(directory, topic.name, topic.tables)
        ]
    if options.json:
        print_json([{**state._asdict(), "finished": not state.missing} for state in states])
    elif states:
        _print_states(states)
    else:
        print("there is no index")
    return 0


def _places(options: argparse.Namespace) -> int:
    """Make the index of places, or with --list only look at it; print the state of each run."""
    if options.topics or options.field or options.remove:
        options.parser.error("--places goes without TOPIC and --remove")
    whose = {"nodeID": options.node_id, "run": options.run}
    with open_store(options) as ros_cas:
        if options.list:
            runs = ros_cas.upkeep.placesIndex(**whose)
        else:
            with MessageBar("noting places", unit=" s") as bar:
                runs = ros_cas.upkeep.indexPlaces(**whose, progress=bar.reach)
    if options.json:
        print_json([run_places._asdict() for run_places in runs])
    elif not runs:
        print("there is no run")
    elif not options.quiet:
        rows = [
            (
                shown(run_places.run),
                shown(run_places.node),
                format_time(run_places.first_ns),
                format_time(run_places.last_ns),
                run_places.state,
            )
            for run_places in runs
        ]
        print(format_table(("run", "node", "poses from", "to", "places"), rows))
    return 0


def _print_states(states: list[IndexState]) -> None:
    rows = [
        (
            shown(state.topic),
            shown(state.field),
            str(state.messages),
            str(state.missing),
            "not finished" if state.missing else "finished",
        )
        for state in states
    ]
    header = ("topic", "field", "messages", "not in it", "state")
    print(format_table(header, rows, right=("messages", "not in it")))
    if any(state.missing for state in states):
        print(
            "what is not in an index is found all the same, only slower; to take it in: "
            "cassandra_bag index TOPIC FIELD"
        )
