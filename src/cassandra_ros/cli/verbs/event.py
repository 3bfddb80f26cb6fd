# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Add, list, end and delete events: named time ranges of a robot, with labels and values.

  cassandra_bag event add bump --start 2013-05-08T14:06:20Z --end 2013-05-08T14:06:22Z
  cassandra_bag event add 'door open' --start 1368021980.5 --node-id husky --value angle=1.2
  cassandra_bag event list
  cassandra_bag event list 'bump%' --like --start 2013-05-08
  cassandra_bag event end 'door open'
  cassandra_bag event end 1368021980500000000-3f1c09ab77e2 --end 1368021990
  cassandra_bag event delete bump --end 2013-05-08

KEY is the key that list prints; a name that begins with - is written after --. An event without
--end lasts until 'event end' sets its end, by its key, or by its name if one of that name lasts.
One that a killed recorder began lasts too: list shows it as lasting. An event without --node-id is
of all robots. Other verbs and the player take the
name: --event bump. Messages stay when an event is deleted, and events when messages are deleted.
"""

from __future__ import annotations

import argparse
from itertools import islice
from typing import TYPE_CHECKING, Any, Iterator, Mapping

from cassandra_ros.arguments import exact_json
from cassandra_ros.cli.confirmation import add_dry_run_option, add_yes_option, confirm
from cassandra_ros.cli.json_answer import add_json_option, print_json, tell
from cassandra_ros.cli.options import (
    add_store_options,
    add_time_options,
    open_store,
    read_pair,
    read_pairs,
    read_times,
)
from cassandra_ros.cli.terminal_text import counted, format_table
from cassandra_ros.errors import EventNotFound, InvalidOption
from cassandra_ros.printable import shown
from cassandra_ros.quantities import whole_number

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra
    from cassandra_ros.store.tables.event_table import Event

_ACTIONS = ("add", "list", "end", "delete")
_HEADER = ("event", "robot", "start", "end", "labels", "values", "key")
_MOST_ENDED = 10_000
"""Maximum number of events of a name among which the one that lasts is searched."""
_MOST_SHOWN = 10
"""Maximum number of events shown before the question whether to delete them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what is done, the event, and the store."""
    add = parser.add_argument
    add("action", metavar="|".join(_ACTIONS), choices=_ACTIONS, help="what to do")
    text = "name of the event, or for end and delete its key (default: list all names)"
    add("event", metavar="NAME|KEY", nargs="?", help=text)
    add("--like", action="store_true", help="NAME is a pattern: %% is any text, _ any character")
    add_time_options(parser, "of the event; for list and delete of the time that it meets: ")
    text = "robot of the event; list also shows events without a robot (default: add: without a "
    text += "robot; list, delete: of all robots)"
    add("--node-id", metavar="N", help=text)
    text = "name or writer id of its run; list also shows events without a run (default: add: "
    text += "without a run; list, delete: of all runs)"
    add("--run", metavar="NAME", help=text)
    text = "with add: a label, a text; may be repeated (default: no labels)"
    add("--label", metavar="NAME=TEXT", action="append", type=_pair, default=[], help=text)
    text = "with add: a value, a number, true, false or text; may be repeated (default: no values)"
    add("--value", metavar="NAME=VALUE", action="append", type=_pair, default=[], help=text)
    text = "with list: maximum number of events to print (default: all)"
    add("-n", "--limit", metavar="COUNT", type=whole_number, help=text)
    add_dry_run_option(parser)
    add_yes_option(parser)
    add("-q", "--quiet", action="store_true", help="print errors only")
    add_json_option(parser)
    add_store_options(parser)


def _pair(text: str) -> tuple[str, str]:
    return read_pair(text, "=", "NAME=VALUE")


def run(options: argparse.Namespace) -> int:
    """Do what the action says."""
    if options.action != "list" and not options.event:
        options.parser.error(f"{options.action} needs the name or the key of an event")
    with open_store(options, make=options.action == "add") as ros_cas:
        return {"add": _add, "list": _list, "end": _end, "delete": _delete}[options.action](
            ros_cas, options
        )


def _add(ros_cas: RosCassandra, options: argparse.Namespace) -> int:
    start, end = read_times(options)
    if start is None:
        options.parser.error("add needs --start")
    values = read_pairs(options, "--value", ((name, _value(text)) for name, text in options.value))
    event = ros_cas.addEvent(
        options.event,
        start,
        end,
        nodeID=options.node_id or "",
        run=options.run,
        labels=read_pairs(options, "--label", options.label),
        values=values,
    )
    _tell(event, options, "added")
    return 0


def _value(text: str) -> object:
    """Return what a text means as JSON, else the text; InvalidOption: a number would change."""
    try:
        return exact_json(text)
    except InvalidOption:
        raise
    except (ValueError, RecursionError):
        return text


def _end(ros_cas: RosCassandra, options: argparse.Namespace) -> int:
    _, end = read_times(options)
    _tell(ros_cas.endEvent(_lasting_event(ros_cas, options), end), options, "ended")
    return 0


def _lasting_event(ros_cas: RosCassandra, options: argparse.Namespace) -> Event:
    """Return the event of a key, or the one that lasts of a name.

    Raises:
        EventNotFound: There is no such event.
        InvalidOption: The name has no event that lasts among the first _MOST_ENDED, or several.
    """
    name, whose = options.event, {"nodeID": options.node_id, "run": options.run}
    events = list(islice(ros_cas.events(name, **whose), _MOST_ENDED))
    if not events:  # the name is a key, then
        return ros_cas.catalog.keyspace.events.get(name)
    lasting = [event for event in events if event.end_ns is None]
    if len(lasting) == 1:
        return lasting[0]
    reason = f"{len(lasting)} events {name!r:.80} last"
    if not lasting:
        reason = f"event {name!r:.80} has ended already, at {_time(events[-1].end_ns or 0)}"
    named = (lasting or events)[-_MOST_SHOWN:]
    which = "of one of them" if len(named) > 1 else "again"
    keys = ", ".join(event.key for event in named)
    raise InvalidOption(f"{reason}; to set the end {which}, give its key: {keys}")


def _tell(event: Event, options: argparse.Namespace, done: str) -> None:
    text = f"event {shown(event.name)} is {done}; its key is {event.key}"
    tell(options, _facts(event), text)


def _selected_events(ros_cas: RosCassandra, options: argparse.Namespace) -> Iterator[Event]:
    start, end = read_times(options)
    which = {"like" if options.like else "name": options.event}
    return ros_cas.events(key=start, to_key=end, nodeID=options.node_id, run=options.run, **which)


def _list(ros_cas: RosCassandra, options: argparse.Namespace) -> int:
    events = islice(_selected_events(ros_cas, options), options.limit)
    if options.json:
        print_json([_facts(event) for event in events])
        return 0
    rows = list(map(_row, events))
    choices = (options.event, options.start, options.end, options.node_id, options.run)
    none = "no event is stored" if not any(choices) else "there is no such event"
    print(format_table(_HEADER, rows) if rows else none)
    return 0


def _delete(ros_cas: RosCassandra, options: argparse.Namespace) -> int:
    events = list(_selected_events(ros_cas, options))
    if not events:  # the name is a key, then
        events = [ros_cas.catalog.keyspace.events.get(options.event)]
    # The selection also has the events of all robots and of no run; these are not deleted.
    if options.node_id is not None:
        events = [event for event in events if event.node == options.node_id]
    if options.run is not None:
        writers = ros_cas.catalog.keyspace.runs.writers(options.run) or ()
        events = [event for event in events if event.writer in writers]
    if not events:
        raise EventNotFound(f"no event {options.event!r:.80} is of this robot and run alone")
    if not options.yes and not options.dry_run:
        table = format_table(_HEADER, list(map(_row, events[:_MOST_SHOWN])))
        confirm(f"Delete {counted(len(events), 'event')}?", table)
    for event in [] if options.dry_run else events:
        ros_cas.removeEvent(event)
    answer = {"deleted": [event.key for event in events], "dry_run": options.dry_run}
    done = "would be" if options.dry_run else "is" if len(events) == 1 else "are"
    tell(options, answer, f"{counted(len(events), 'event')} {done} deleted")
    return 0


def _facts(event: Event) -> dict[str, object]:
    return {**vars(event), "lasts": event.end_ns is None, "key": event.key}


def _row(event: Event) -> tuple[str, ...]:
    return (
        shown(event.name),
        shown(event.node) or "-",
        _time(event.start_ns),
        "lasts" if event.end_ns is None else _time(event.end_ns),
        _pairs(event.labels),
        _pairs(event.values),
        event.key,
    )


def _pairs(texts: Mapping[str, Any]) -> str:
    return shown(", ".join(f"{name}={text}" for name, text in sorted(texts.items()))) or "-"


def _time(ns: int) -> str:
    from cassandra_ros.messages.stamps import iso_time

    return iso_time(ns)[:23] + "Z"
