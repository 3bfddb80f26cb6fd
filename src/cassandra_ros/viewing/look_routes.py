# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages as they were sent, for the Studio: its topics, pages of a window, what was sent last."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from dataclasses import replace
from typing import Iterator, Sequence

from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import decode_cursor
from cassandra_ros.overview.latest_messages import Latest
from cassandra_ros.overview.timeline.lanes import Lane, View
from cassandra_ros.read import LAST_NS, Read, TimeRange, Whose
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.viewing.answers import Json, Stream
from cassandra_ros.viewing.call import Call
from cassandra_ros.viewing.catalog_routes import shown_ns
from cassandra_ros.viewing.choice import (
    END,
    NODES,
    RUNS,
    START,
    TOPICS,
    tables_chosen,
    whose_chosen,
)
from cassandra_ros.viewing.look_window import Held, default_window
from cassandra_ros.viewing.message_frames import CONTENT_TYPE, describe_channel, frames
from cassandra_ros.viewing.route import Parameter, Route
from cassandra_ros.viewing.studio import STUDIO_VERSION, studio_installed
from cassandra_ros.viewing.timeline_routes import timeline_of
from cassandra_ros.viewing.viewer_settings import ViewerSettings

PAGE_BYTES = 4 * 2**20
MAX_PAGE_BYTES = 64 * 2**20
_MAX_FINDERS = 16
_FINDER_SEC = 30
"""So long somebody who began to latch may stay unnoticed."""


def _connections(call: Call) -> Json:
    whose = whose_chosen(call)
    problems: list[Json] = []
    shown: dict[str, list[TopicTable]] = {}
    for table in tables_chosen(call):
        reason = _reason_not_shown(table)
        if reason:
            problems.append({"topic": table.metadata.topic, "text": reason})
        else:
            shown.setdefault(table.metadata.topic, []).append(table)
    view = View(cells=1, topics=sorted(shown), whose=whose)
    window = _window(call, view)
    view = replace(view, start=window.low, end=window.high)
    lanes = call.shared(timeline_of).picture(view, call.gone).lanes
    whole = Held.of_lanes(lane for lane in lanes if not _is_named(shown[lane.topic]))
    window = _cut(call, window, whole)
    return {
        "start": str(window.low),
        "end": str(window.high),
        "messages": whole.messages,
        "bytes": whole.size,
        "topics": [_topic(topic, shown[topic], lanes) for topic in sorted(shown)],
        "problems": problems,
    }


def _window(call: Call, view: View) -> TimeRange:
    """Return the window that was asked for, or is meant; view: of all that could be shown."""
    start, end, moment = (call.time_ns(name) for name in ("start", "end", "time"))
    newest = None
    if start is None and end is None and moment is None:
        extent = call.shared(timeline_of).picture(view, call.gone).extent
        newest = extent[1] if extent else None
    window = default_window(start, end, moment, newest)
    _check_order(window)
    return window


def _cut(call: Call, window: TimeRange, held: Held) -> TimeRange:
    """Let a window end where its messages do, at an end that nobody gave."""
    if held.first is None or held.last is None:
        return window
    low, high = max(window.low, held.first), min(window.high, held.last)
    low = low if call.time_ns("start") is None else window.low
    high = high if call.time_ns("end") is None else window.high
    return TimeRange(min(low, high), high)


def _reason_not_shown(table: TopicTable) -> str:
    """Say why nobody can look at a table's messages; '' where he can."""
    topic = table.metadata.topic
    if table.definition is None:
        return f"the messages of {topic} cannot be shown: their definition is none that can be read"
    if table.metadata.key_format == "hash":
        return f"the messages of {topic} cannot be shown: by key format hash they have no time"
    return ""


def _is_named(tables: Sequence[TopicTable]) -> bool:
    """Say whether messages are kept under names: when they were stored bounds no window."""
    return all(table.named for table in tables)


def _topic(topic: str, tables: Sequence[TopicTable], lanes: Sequence[Lane]) -> Json:
    held = (
        Held()
        if _is_named(tables)
        else Held.of_lanes(each for each in lanes if each.topic == topic)
    )
    # One type for the panels; messages of the others are read by their own.
    newest = max(tables, key=lambda table: (table.metadata.date, table.name))
    return {
        **describe_channel(newest),
        "messages": held.messages,
        "bytes": held.size,
        "first": shown_ns(held.first),
        "last": shown_ns(held.last),
    }


def _messages(call: Call) -> Stream:
    start, end = call.time_ns("start"), call.time_ns("end")
    time_range = TimeRange(0 if start is None else start, LAST_NS if end is None else end)
    _check_order(time_range)
    after = call.text("after")
    limit = call.count("bytes") or PAGE_BYTES
    if limit > MAX_PAGE_BYTES:
        raise InvalidOption(f"bytes={limit}: give at most {MAX_PAGE_BYTES}")
    # What is kept under names has no place among what passes by: /api/latest has it.
    rows = call.catalog.keyspace.rows.read(
        [table for table in _shown(call) if not table.named],
        Read(time_range, whose_chosen(call), after=None if after is None else decode_cursor(after)),
    )
    return Stream(frames(_until_gone(call, rows), limit), CONTENT_TYPE)


def _latest(call: Call) -> Stream:
    t, since = call.time_ns("time"), call.time_ns("start")
    finder = call.shared(_Finders).of(_shown(call), whose_chosen(call))
    rows = finder.before(LAST_NS - 1 if t is None else t, 0 if since is None else since)
    return Stream(frames(_until_gone(call, iter(rows))), CONTENT_TYPE)


def _shown(call: Call) -> list[TopicTable]:
    return [table for table in tables_chosen(call) if not _reason_not_shown(table)]


def _until_gone(call: Call, rows: Iterator[StoredRow]) -> Iterator[StoredRow]:
    for row in rows:
        if call.gone.is_set():
            return
        yield row


def _check_order(time_range: TimeRange) -> None:
    if time_range.low > time_range.high:
        raise InvalidOption(f"start={time_range.low} lies behind end={time_range.high}")


def _studio(call: Call) -> Json:
    return {"installed": studio_installed(call.settings.studio), "version": STUDIO_VERSION}


class _Finders:
    """Keeps what finds the last messages of some topics: it knows which of them are latched."""

    def __init__(self, catalog: Catalog, settings: ViewerSettings) -> None:
        self._keyspace = catalog.keyspace
        self._made: OrderedDict[object, Latest] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, tables: Sequence[TopicTable], whose: Whose) -> Latest:
        """Return the finder of some tables."""
        age = time.monotonic() // _FINDER_SEC
        key = (tuple(table.name for table in tables), whose, age)
        with self._lock:
            found = self._made.pop(key, None) or Latest(self._keyspace, tables, whose)
            self._made[key] = found
            while len(self._made) > _MAX_FINDERS:
                self._made.popitem(last=False)
        return found


_WINDOW = (TOPICS, START, END, NODES, RUNS)
_TIME = Parameter("time", "time", "The moment that is looked at.")

ROUTES: tuple[Route, ...] = (
    Route("/api/studio", _studio, "Whether the Studio is here that Look shows messages in."),
    Route(
        "/api/connections",
        _connections,
        "The topics of a window, how much of them lies in it, and how their messages are read.",
        (*_WINDOW, _TIME),
    ),
    Route(
        "/api/messages",
        _messages,
        "A page of the messages of a window as they were sent, in the order of their key times: "
        "frames of uint32 channel, uint32 size, int64 time (ns), all little endian, and size "
        "bytes; those of channel 0 are JSON (channel, problem, end).",
        (
            *_WINDOW,
            Parameter("after", "text", "Read on behind this place: what end.next says."),
            Parameter(
                "bytes",
                "count",
                f"The page ends behind so many bytes of messages, 1 to {MAX_PAGE_BYTES}.",
                default=PAGE_BYTES,
            ),
        ),
        CONTENT_TYPE,
    ),
    Route(
        "/api/latest",
        _latest,
        "The last message of each topic at or before a moment, as frames: of transforms those of "
        "the second before, of latched topics each publisher's, whenever that was sent.",
        (
            TOPICS,
            Parameter("time", "time", "The moment, included; missing: now."),
            Parameter("start", "time", "What is not latched counts from here on."),
            NODES,
            RUNS,
        ),
        CONTENT_TYPE,
    ),
)
