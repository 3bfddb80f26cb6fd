# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is stored when, for Home's timeline."""

from __future__ import annotations

from typing import Dict, List, Optional, Sequence, Tuple

from cassandra_ros.overview.timeline.lanes import Lane, RunSpan, Timeline, View
from cassandra_ros.overview.timeline.time_cells import (
    MAX_CELLS,
    Scale,
    runs_of_cells,
    time_ranges_of_cells,
)
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.call import Call
from cassandra_ros.viewing.catalog_routes import shown_ns
from cassandra_ros.viewing.choice import END, NODES, RUNS, START, TOPICS, whose_chosen
from cassandra_ros.viewing.route import Parameter, Route
from cassandra_ros.viewing.viewer_settings import ViewerSettings

_PIXELS = 1000


def timeline_of(catalog: Catalog, settings: ViewerSettings) -> Timeline:
    """Make what a viewer's calls share; see Call.shared."""
    return Timeline(catalog)


def _answer(call: Call) -> Json:
    view = View(
        start=call.time_ns("start"),
        end=call.time_ns("end"),
        cells=call.count("pixels") or 0,
        topics=call.texts("topics") or None,
        whose=whose_chosen(call),
        detail=call.flag("detail"),
    )
    picture = call.shared(timeline_of).picture(view, call.gone)
    (first, last), scale = picture.extent or (None, None), picture.scale
    names = {run.writer: run.name for run in call.catalog.keyspace.registry.runs()}
    lanes: List[Json] = [_lane(lane, scale) for lane in picture.lanes]
    runs: List[Json] = [_run(span, names) for span in picture.runs]
    return {
        "first": shown_ns(first),
        "last": shown_ns(last),
        "eras": [[str(low), str(high)] for low, high in picture.eras],
        "start": None if scale is None else str(scale.start),
        "end": None if scale is None else str(scale.end),
        "cell_ns": None if scale is None else str(scale.step),
        "cells": 0 if scale is None else scale.cells,
        "lanes": lanes,
        "runs": runs,
    }


def _lane(lane: Lane, scale: Optional[Scale]) -> Dict[str, Json]:
    first, last = lane.times
    found: Dict[str, Json] = {
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
        found["counts"] = _lists(runs_of_cells(cells.counts))
        found["even"] = _lists(time_ranges_of_cells(cells.even))
        found["unknown"] = _lists(time_ranges_of_cells(cells.unknown))
        found["gaps"] = [[str(low), str(high)] for low, high in lane.gaps(scale)]
    return found


def _lists(numbers: Sequence[Sequence[int]]) -> Json:
    return [list(each) for each in numbers]


def _run(span: RunSpan, names: Dict[int, str]) -> Dict[str, Json]:
    return {
        "run": names.get(span.writer) or str(span.writer),
        "id": span.writer,
        "node": span.node,
        "first": str(span.first),
        "last": str(span.last),
        "messages": span.messages,
    }


ROUTES: Tuple[Route, ...] = (
    Route(
        "/api/timeline",
        _answer,
        "How many messages of each topic and robot lie in equal cells of a window of time. "
        "`counts` has runs of cells that are not empty: the first cell, then the count of each. "
        "Over the cells of `even`, three and more, messages are spread of which is only known that "
        "they lie there; "
        "in those of `unknown` nobody has counted. `gaps` are pauses of a run, between two "
        "messages. `eras` are the times in which messages lie, with ten years or more without a "
        "message between two of them. Where `exact` is false, messages and bytes are estimates. It "
        "is told by the directory, at a cost that does not grow with the messages.",
        (
            Parameter("start", START.kind, f"{START.summary} Missing: the first message's."),
            Parameter("end", END.kind, f"{END.summary} Missing: the last message's."),
            Parameter(
                "pixels", "count", f"So many cells at most, 1 to {MAX_CELLS}.", default=_PIXELS
            ),
            TOPICS,
            NODES,
            RUNS,
            Parameter(
                "detail",
                "flag",
                "Look into buckets that cover several cells, as far as a bound of keys allows.",
            ),
        ),
    ),
)
