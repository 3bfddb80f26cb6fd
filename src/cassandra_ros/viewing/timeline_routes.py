# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Routes of the timeline on Home: message counts over time, and notes on what is not stored."""

from __future__ import annotations

from typing import Callable, Iterable, Sequence

from cassandra_ros.read import Whose
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.overview.stored_ends import Ends, far_outside, wrong_unit
from cassandra_ros.topics.overview.timeline.lanes import Lane, Picture, RunSpan, Timeline, View
from cassandra_ros.topics.overview.timeline.time_cells import (
    MAX_TIMELINE_CELLS,
    Scale,
    runs_of_cells,
    time_ranges_of_cells,
)
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.api_call import (
    END,
    NODES,
    RUNS,
    START,
    TIME,
    TOPICS,
    WHOLE_RANGE,
    ApiCall,
    whose_of,
)
from cassandra_ros.viewing.catalog_routes import shown_ns
from cassandra_ros.viewing.route import Parameter, Route
from cassandra_ros.viewing.viewer_settings import ViewerSettings

_PIXELS = 1000
"""Default number of cells."""


def timeline_of(catalog: Catalog, settings: ViewerSettings) -> Timeline:
    """Make the timeline that the calls on one keyspace share; see ApiCall.cached."""
    return Timeline(catalog)


def _answer(call: ApiCall) -> Json:
    picture = call.cached(timeline_of).picture(view_of(call, whose_of(call)), call.gone)
    return shown_picture(picture, call.catalog.keyspace.registry.runs())


def view_of(call: ApiCall, whose: Whose) -> View:
    """Return what a call asks to be drawn, of some robots and runs."""
    return View(
        start=call.time_ns("start"),
        end=call.time_ns("end"),
        cells=call.count("pixels") or 0,
        topics=call.texts("topics") or None,
        whose=whose,
        detail=call.flag("detail"),
    )


def shown_picture(picture: Picture, all_runs: Iterable[Run]) -> dict[str, Json]:
    """Return a picture as JSON; its runs are named as those that are known."""
    (first, last), scale = picture.extent or (None, None), picture.scale
    names = {run.writer: run.name for run in all_runs}
    lanes: list[Json] = [_lane(lane, scale) for lane in picture.lanes]
    runs: list[Json] = [_run(span, names) for span in picture.runs]
    return {
        "first": shown_ns(first),
        "last": shown_ns(last),
        "periods": [[str(low), str(high), count] for low, high, count in picture.periods],
        "start": None if scale is None else str(scale.start),
        "end": None if scale is None else str(scale.end),
        "cell_ns": None if scale is None else str(scale.step),
        "cells": 0 if scale is None else scale.cells,
        "lanes": lanes,
        "runs": runs,
    }


def _lane(lane: Lane, scale: Scale | None) -> dict[str, Json]:
    first, last = lane.times
    entry: dict[str, Json] = {
        "topic": lane.topic,
        "node": lane.node,
        "types": sorted({table.metadata.msg_type for table in lane.tables}),
        "formats": sorted({table.metadata.format for table in lane.tables}),
        "key": next((t.metadata.key_part or t.metadata.key_format for t in lane.tables), "time"),
        "messages": lane.messages,
        "bytes": lane.bytes,
        "exact": lane.exact,
        "rate_hz": lane.rate_hz,
        "writing": lane.writing,
        "first": shown_ns(first),
        "last": shown_ns(last),
    }
    if scale is not None:
        cells = lane.cells(scale)
        entry["counts"] = _lists(runs_of_cells(cells.counts))
        entry["even"] = _lists(time_ranges_of_cells(cells.even))
        entry["unknown"] = _lists(time_ranges_of_cells(cells.unknown))
        entry["gaps"] = [[str(low), str(high)] for low, high in lane.gaps(scale)]
    return entry


def _lists(numbers: Sequence[Sequence[int]]) -> Json:
    return [list(row) for row in numbers]


def _run(span: RunSpan, names: dict[int, str]) -> dict[str, Json]:
    return {
        "run": names.get(span.writer) or str(span.writer),
        "id": span.writer,
        "node": span.node,
        "first": str(span.first),
        "last": str(span.last),
        "messages": span.messages,
    }


def _notes(call: ApiCall) -> Json:
    unknown_robot = call.catalog.keyspace.runs.unknown_robot
    return {"notes": notes_of(call, unknown_robot, lambda: call.cached(timeline_of).ends())}


def notes_of(
    call: ApiCall, unknown_robot: Callable[[str], str], stored_ends: Callable[[], Ends | None]
) -> list[Json]:
    """Say which robots of a call are not stored, and which times are far from what is stored.

    Args:
        unknown_robot: Returns why a robot is not stored; '' = it is.
        stored_ends: Returns the times of the first and the last message; None = no message.
    """
    notes: list[Json] = [*filter(None, map(unknown_robot, call.texts("nodes") or ()))]
    times = {name: call.time_ns(name) for name in ("start", "end", "time")}
    ends = stored_ends() if any(ns is not None for ns in times.values()) else None
    for name, ns in times.items():
        if ns is not None and ends is not None:
            reason = wrong_unit(str(ns), ns, ends) or far_outside(name, ns, ends)
            notes += [f"{name}={ns} {reason}"] if reason else []
    return notes


ROUTES: tuple[Route, ...] = (
    Route(
        "/api/timeline",
        _answer,
        "The number of messages of each topic and robot in equal cells of a time range. "
        "`counts` has sequences of cells that are not empty: the first cell, then the count of "
        "each. `even` are ranges of three or more cells over which messages of unknown position "
        "are spread evenly; in the cells of `unknown` messages have not been counted. `gaps` are "
        "pauses of a run between two messages. `periods` are the time ranges with messages (first "
        "and last time, number of messages), separated by pauses in which all of them would be a "
        "few pixels wide, or of ten years. If `exact` is false, messages and bytes are estimates. "
        "The answer comes from the directory; its cost does not grow with the messages.",
        (
            *WHOLE_RANGE,
            Parameter(
                "pixels",
                "count",
                f"Maximum number of cells, 1 to {MAX_TIMELINE_CELLS}.",
                default=_PIXELS,
            ),
            TOPICS,
            NODES,
            RUNS,
            Parameter(
                "detail",
                "flag",
                "Read keys of buckets that cover several cells, up to a maximum number of keys.",
            ),
        ),
    ),
    Route(
        "/api/notes",
        _notes,
        "`notes` say which robots of the call are not stored, and which times are far from what "
        "is stored. A viewer of several stores has none if one of them does not answer.",
        (NODES, START, END, TIME),
    ),
)
