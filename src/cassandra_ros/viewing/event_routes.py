# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Routes of events: those of a time range, or with a text in their name; and one that adds one."""

from __future__ import annotations

from itertools import islice
from typing import Iterator

from cassandra_ros.errors import AccessDenied
from cassandra_ros.read import LAST_NS, TimeRange
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.api_call import END, NODES, RUNS, START, ApiCall, whose_of
from cassandra_ros.viewing.catalog_routes import MAX_LISTED, listed_at_most, shown_ns
from cassandra_ros.viewing.lossless_json import JsonConverter
from cassandra_ros.viewing.route import Parameter, Route

_USUAL_EVENTS = 1000
_MAX_SEARCHED = 100_000
"""Maximum number of events whose names are compared with a searched text."""


def _events(call: ApiCall) -> Json:
    find = call.catalog.keyspace.events.find
    return listed_events(call, find(call.text("name"), within=within(call), whose=whose_of(call)))


def within(call: ApiCall) -> TimeRange:
    """Return the time range of the parameters ``start`` and ``end``."""
    start, end = call.time_ns("start"), call.time_ns("end")
    return TimeRange(start or 0, LAST_NS if end is None else end)


def listed_events(call: ApiCall, events: Iterator[Event]) -> dict[str, Json]:
    """Return as JSON the events with the text of a call in their name."""
    text, limit = call.text("text"), listed_at_most(call)
    fragment = (text or "").casefold()
    searched = islice(events, _MAX_SEARCHED if fragment else None)
    fitting = (event for event in searched if fragment in event.name.casefold())
    listed: list[Json] = [_answer(event) for event in islice(fitting, limit)]
    more = next(fitting, None) is not None or next(events, None) is not None
    return {"events": listed, "more": more}


def _add(call: ApiCall) -> Json:
    if not call.settings.allow_writes:
        raise AccessDenied(
            "this viewer only reads: start it with --allow-writes to add events here, or add them "
            "with cassandra_bag event add"
        )
    name, start, end = call.text("name"), call.time_ns("start"), call.time_ns("end")
    # Stamps are checked as times; None is refused, for the parameters are required.
    node = call.text("node") or ""
    event = call.catalog.keyspace.events.add(name or "", str(start), str(end), node)
    return _answer(event)


def _answer(event: Event) -> dict[str, Json]:
    return {
        "key": event.key,
        "name": event.name,
        "start": str(event.start_ns),
        "end": shown_ns(event.end_ns),
        "node": event.node,
        "labels": dict(event.labels),
        "values": {name: _exact(value) for name, value in event.values.items()},
    }


def _exact(value: object) -> Json:
    """Return a value of an event; JavaScript rounds integers above 2^53, which become texts."""
    if isinstance(value, dict):
        return {name: _exact(element) for name, element in value.items()}
    if isinstance(value, list):
        return [_exact(element) for element in value]
    return JsonConverter(None).shown(value)


ROUTES: tuple[Route, ...] = (
    Route(
        "/api/events",
        _events,
        "Events that meet a time range, in order of their starts; end null: the event lasts.",
        (
            START,
            END,
            Parameter("name", "text", "Name of the events; missing: all names."),
            Parameter("text", "text", "Text in the name, in capitals or not; missing: all names."),
            NODES,
            RUNS,
            Parameter(
                "limit",
                "count",
                f"Maximum number of events, to {MAX_LISTED}.",
                default=_USUAL_EVENTS,
            ),
        ),
    ),
    Route(
        "/api/events/add",
        _add,
        "Add an event, and answer it; only with --allow-writes.",
        (
            Parameter("name", "text", "Name of the event, 1 to 256 bytes.", required=True),
            Parameter("start", "time", "First time, included.", required=True),
            Parameter("end", "time", "Last time, included.", required=True),
            Parameter("node", "text", "nodeID of the robot; missing: of all robots."),
        ),
        writes=True,
    ),
)
