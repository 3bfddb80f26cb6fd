# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Routes of what is marked on a timeline: events, starts and ends of recordings, and losses.

A snapshot is a recording that starts when it is requested. Imports have no marks, because only the
time of the import is known, not that of the recording of its bag.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import Iterable, Iterator, Mapping

from cassandra_ros.errors import AccessDenied
from cassandra_ros.messages.stamps import to_ns
from cassandra_ros.read import Read
from cassandra_ros.store.tables.event_table import Event
from cassandra_ros.store.tables.registry import Loss, Run
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.api_call import END, NODES, RUNS, START, ApiCall, whose_of
from cassandra_ros.viewing.catalog_routes import limit_parameter, listed_at_most, shown_ns
from cassandra_ros.viewing.lossless_json import JsonConverter
from cassandra_ros.viewing.route import Parameter, Route

_USUAL_EVENTS = 1000
_USUAL_MARKS = 2000
_MAX_SEARCHED = 100_000
"""Maximum number of events whose names are compared with a searched text."""


def _events(call: ApiCall) -> Json:
    table, name = call.catalog.keyspace.events, call.text("name")
    return listed_events(call, table.find(name, within=call.time_range(), whose=whose_of(call)))


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


@dataclass(frozen=True)
class TimelineMark:
    """An event at a time or in a time range; the fields are the keys of the answer."""

    kind: str
    """'begin' or 'end' of a recording, or 'loss'."""
    start: int
    """Time, ns."""
    end: int
    """End of a loss, included, ns; the same as start for other kinds."""
    node: str
    run: str
    """Name of the run, or its writer id if it has no name."""
    text: str
    """Labels of a recording, or reason of a loss."""
    topic: str = ""
    """Name of the topic; '' = all topics."""
    count: int | None = None
    """Number of lost messages; None = not known."""


def _marks(call: ApiCall) -> Json:
    keyspace, read = call.catalog.keyspace, Read(call.time_range(), whose_of(call))
    losses = keyspace.runs.losses(call.texts("topics") or None, read)
    return listed_marks(call, keyspace.registry.runs(), losses, read)


def listed_marks(
    call: ApiCall, all_runs: Iterable[Run], losses: Iterable[Loss], read: Read
) -> dict[str, Json]:
    """Return as JSON the losses, and the starts and ends of those runs that a read selects."""
    limit, whose, time_range = listed_at_most(call), read.whose, read.time_range
    runs = {(run.writer, run.node): run for run in all_runs}
    marks = [_of_loss(loss, runs) for loss in losses]
    for run in runs.values():
        if (whose.nodes is None or run.node in whose.nodes) and (
            whose.writers is None or run.writer in whose.writers
        ):
            marks += [
                mark for mark in _of_run(run) if time_range.low <= mark.start <= time_range.high
            ]
    marks.sort(key=lambda mark: (mark.start, mark.kind, mark.topic))
    listed: list[Json] = [
        {**vars(mark), "start": str(mark.start), "end": str(mark.end)} for mark in marks[:limit]
    ]
    return {"marks": listed, "left_off": max(len(marks) - limit, 0)}


def _of_loss(loss: Loss, runs: Mapping[tuple[int, str], Run]) -> TimelineMark:
    run = runs.get((loss.writer, loss.node))
    return TimelineMark(
        kind="loss",
        start=loss.first_ns,
        end=loss.last_ns,
        node=loss.node,
        run=run.name if run is not None and run.name else str(loss.writer),
        text=loss.kind.value,
        topic=loss.topic,
        count=loss.count or None,
    )


def _of_run(run: Run) -> Iterator[TimelineMark]:
    if run.kind == "import":
        return
    name = run.name or str(run.writer)
    labels = sorted(run.public_labels.items())
    text = ", ".join(f"{key}={value}" if value else key for key, value in labels)
    for kind, time in (("begin", run.started), ("end", run.ended)):
        if time is not None:
            ns = to_ns(time)
            yield TimelineMark(kind, ns, ns, run.node, name, text)


ROUTES: tuple[Route, ...] = (
    Route(
        "/api/marks",
        _marks,
        "Starts and ends of recordings, and losses, the earliest first.",
        (
            START,
            END,
            Parameter("topics", "texts", "Topics whose losses are listed; missing: all topics."),
            NODES,
            RUNS,
            limit_parameter("marks", _USUAL_MARKS),
        ),
    ),
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
            limit_parameter("events", _USUAL_EVENTS),
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
