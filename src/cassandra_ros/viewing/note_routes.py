# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What of a page's address is not stored: robots, and times that lie far outside."""

from __future__ import annotations

from typing import Callable

from cassandra_ros.topics.overview.stored_ends import Ends, far_outside, wrong_unit
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.api_call import END, NODES, START, TIME, ApiCall
from cassandra_ros.viewing.route import Route
from cassandra_ros.viewing.timeline_routes import timeline_of


def _answer(call: ApiCall) -> Json:
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
        "/api/notes",
        _answer,
        "`notes` say which robots of the call are not stored, and which times are far from what "
        "is stored. A viewer of several stores has none if one of them does not answer.",
        (NODES, START, END, TIME),
    ),
)
