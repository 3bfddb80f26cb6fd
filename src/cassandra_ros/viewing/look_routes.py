# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Routes of messages for the Studio: topics, pages of a time range, and last messages.

Look opens a time range with the number of messages of each topic in it.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from dataclasses import replace
from functools import partial
from typing import (
    Callable,
    Collection,
    FrozenSet,
    Iterable,
    Iterator,
    Mapping,
    NamedTuple,
    Sequence,
    TypeVar,
)

from cassandra_ros.errors import InvalidOption, StoreUnavailable
from cassandra_ros.keys import SECOND_NS, decode_cursor
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.read import LAST_NS, Read, TimeRange, Whose
from cassandra_ros.stores.fleet.fleet_row import FleetRow
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.overview.latched_messages import LatchedFinder, Source
from cassandra_ros.topics.overview.latest_messages import Latest
from cassandra_ros.topics.overview.timeline.lanes import Lane, Picture, View
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.viewing.answers import Json, StreamedBody
from cassandra_ros.viewing.api_call import (
    END,
    NODES,
    RUNS,
    START,
    TIME,
    TOPICS,
    ApiCall,
    tables_of,
    whose_of,
)
from cassandra_ros.viewing.catalog_routes import shown_ns
from cassandra_ros.viewing.message_frames import CONTENT_TYPE, describe_channel, frames
from cassandra_ros.viewing.route import Parameter, Route
from cassandra_ros.viewing.studio import STUDIO_VERSION, studio_installed
from cassandra_ros.viewing.timeline_routes import timeline_of
from cassandra_ros.viewing.viewer_settings import ViewerSettings

MESSAGE_PAGE_BYTES = 4 * 2**20
"""Default size of the messages of a page, bytes."""
MAX_PAGE_BYTES = 64 * 2**20
"""Maximum size of the messages of a page, bytes."""
_RowT = TypeVar("_RowT", StoredRow, FleetRow)
_MAX_FINDERS = 16
"""Maximum number of cached lists of latched topics."""
_FINDER_SEC = 30
"""How long the list of latched topics is cached, s.

A publisher that starts latching is seen after this time at the latest.
"""


LatchedOf = Callable[[Collection[str], FrozenSet[Source], int], Collection[str]]
"""Returns which of some topics have a message that was latched by some runs before a time, ns."""


def _connections(call: ApiCall) -> Json:
    timeline = call.cached(timeline_of)
    draw = partial(timeline.picture, gone=call.gone)
    latched = partial(latched_topics, call.catalog)
    return connections_of(call, tables_of(call), whose_of(call), draw, latched)


def latched_topics(
    catalog: Catalog, topics: Collection[str], sources: frozenset[Source], t: int
) -> set[str]:
    """Return which of some topics have a latched message before t of one of some runs."""
    tables = [table for table in catalog.tables(None) if table.metadata.topic in topics]
    finder = LatchedFinder(catalog.keyspace, tables)
    return {row.topic for row in finder.of_sources(sources, t)} if finder.latches else set()


def connections_of(
    call: ApiCall,
    tables: Iterable[TopicTable],
    whose: Whose,
    draw: Callable[[View], Picture],
    latched: LatchedOf,
    problems: Iterable[Json] = (),
) -> dict[str, Json]:
    """Return as JSON the topics that have something to show in a time range.

    Args:
        tables: Tables of the topics.
        draw: Draws a timeline of them.
        problems: Topics that are left out, with the reasons.
    """
    shown: dict[str, list[TopicTable]] = {}
    unshown: dict[str, str] = {}
    for table in tables:
        reason = reason_not_shown(table)
        if reason:
            unshown[table.metadata.topic] = reason
        else:
            shown.setdefault(table.metadata.topic, []).append(table)
    view = View(cells=1, topics=sorted(shown), whose=whose)
    window = _window(call, view, draw)
    view = replace(view, start=window.low, end=window.high)
    lanes = draw(view).lanes
    whole = WindowContent.of_lanes(lane for lane in lanes if not _is_named(shown[lane.topic]))
    problems = [*problems, *_left_out(call, unshown, view, draw)]
    if whole.first is None and not any(map(_is_named, shown.values())):
        ends = f"from {iso_time(window.low)} to {iso_time(window.high)}"
        text = f"there is no message of this selection {ends}; Home shows the times of messages"
        problems.append({"topic": "", "text": text})
    there = {lane.topic for lane in lanes if lane.times[0] is not None}
    there.update(topic for topic in shown if _is_named(shown[topic]))
    absent = shown.keys() - there
    if absent:
        runs = draw(replace(view, topics=None)).runs
        there.update(latched(absent, frozenset((run.node, run.writer) for run in runs), window.low))
    window = _cut(call, window, whole)
    return {
        "start": str(window.low),
        "end": str(window.high),
        "messages": whole.messages,
        "bytes": whole.size,
        "topics": [_topic(topic, shown[topic], lanes) for topic in sorted(there)],
        "problems": problems,
    }


def _left_out(
    call: ApiCall, unshown: Mapping[str, str], view: View, draw: Callable[[View], Picture]
) -> Iterator[Json]:
    """Yield topics that cannot be shown and were asked for, or have messages in the view."""
    names_topics = bool(call.texts("topics"))
    lanes = () if names_topics or not unshown else draw(replace(view, topics=sorted(unshown))).lanes
    there = unshown if names_topics else {lane.topic for lane in lanes if lane.times[0] is not None}
    yield from ({"topic": topic, "text": unshown[topic]} for topic in sorted(there))


def _window(call: ApiCall, view: View, draw: Callable[[View], Picture]) -> TimeRange:
    """Return the requested or default time range.

    Args:
        view: All messages that can be shown.
    """
    start, end, moment = (call.time_ns(name) for name in ("start", "end", "time"))
    newest = None
    if start is None and end is None and moment is None:
        extent = draw(view).extent
        newest = extent[1] if extent else None
    window = default_window(start, end, moment, newest)
    _check_order(window)
    return window


def _cut(call: ApiCall, window: TimeRange, held: WindowContent) -> TimeRange:
    """Cut a time range to its messages, except at a start or end of the request."""
    if held.first is None or held.last is None:
        return window
    low, high = max(window.low, held.first), min(window.high, held.last)
    low = low if call.time_ns("start") is None else window.low
    high = high if call.time_ns("end") is None else window.high
    return TimeRange(min(low, high), high)


def reason_not_shown(table: TopicTable) -> str:
    """Return why the messages of a table cannot be shown; '' = they can."""
    topic = table.metadata.topic
    if table.definition is None:
        return f"the messages of {topic} cannot be shown: their definition cannot be read"
    if table.metadata.key_format == "hash":
        return f"the messages of {topic} cannot be shown: with key format hash they have no time"
    return ""


def _is_named(tables: Sequence[TopicTable]) -> bool:
    """Return whether messages are stored under names: their times limit no time range."""
    return all(table.named for table in tables)


def _topic(topic: str, tables: Sequence[TopicTable], lanes: Sequence[Lane]) -> Json:
    held = (
        WindowContent()
        if _is_named(tables)
        else WindowContent.of_lanes(lane for lane in lanes if lane.topic == topic)
    )
    # The panels get one type; messages of other types have their own channel.
    newest = max(tables, key=lambda table: (table.metadata.date, table.name))
    return {
        **describe_channel(newest),
        "messages": held.messages,
        "bytes": held.size,
        "first": shown_ns(held.first),
        "last": shown_ns(held.last),
    }


def _messages(call: ApiCall) -> StreamedBody:
    read, limit = page_read(call, whose_of(call))
    # Messages stored under names are not played: /api/latest has them.
    tables = [table for table in _shown_tables(call) if not table.named]
    rows = call.catalog.keyspace.rows.read(tables, read)
    return StreamedBody(frames(until_gone(call, rows), limit), CONTENT_TYPE)


def page_read(call: ApiCall, whose: Whose) -> tuple[Read, int]:
    """Return the read of a page of messages, and the size after which the page ends, bytes."""
    time_range = call.time_range()
    _check_order(time_range)
    after = call.text("after")
    limit = call.count("bytes") or MESSAGE_PAGE_BYTES
    if limit > MAX_PAGE_BYTES:
        raise InvalidOption(f"bytes={limit}: give at most {MAX_PAGE_BYTES}")
    return Read(time_range, whose, after=None if after is None else decode_cursor(after)), limit


def _latest(call: ApiCall) -> StreamedBody:
    finder = call.cached(_Finders).of(_shown_tables(call), whose_of(call))
    return StreamedBody(
        frames(until_gone(call, iter(finder.before(*moment_of(call))))), CONTENT_TYPE
    )


def moment_of(call: ApiCall) -> tuple[int, int]:
    """Return the last time of the last messages, and the first one of those not latched, ns."""
    t, since = call.time_ns("time"), call.time_ns("start")
    return LAST_NS - 1 if t is None else t, 0 if since is None else since


def _shown_tables(call: ApiCall) -> list[TopicTable]:
    return [table for table in tables_of(call) if not reason_not_shown(table)]


def until_gone(call: ApiCall, rows: Iterator[_RowT]) -> Iterator[_RowT]:
    """Yield rows while the client waits for them."""
    for row in rows:
        if call.gone.is_set():  # not an end: the client would take the rest for read
            raise StoreUnavailable("the client does not wait for the messages any more")
        yield row


def _check_order(time_range: TimeRange) -> None:
    if time_range.low > time_range.high:
        raise InvalidOption(f"start={time_range.low} lies after end={time_range.high}")


def studio_answer(call: ApiCall) -> Json:
    """Return whether the Studio is installed, and its version."""
    return {"installed": studio_installed(call.settings.studio), "version": STUDIO_VERSION}


class _Finders:
    """A cache of finders of last messages, which know the latched topics."""

    def __init__(self, catalog: Catalog, settings: ViewerSettings) -> None:
        self._keyspace = catalog.keyspace
        self._made: OrderedDict[object, Latest] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, tables: Sequence[TopicTable], whose: Whose) -> Latest:
        """Return the finder of some tables."""
        age = time.monotonic() // _FINDER_SEC
        key = (tuple(table.name for table in tables), whose, age)
        with self._lock:
            finder = self._made.pop(key, None) or Latest(self._keyspace, tables, whose)
            self._made[key] = finder
            while len(self._made) > _MAX_FINDERS:
                self._made.popitem(last=False)
        return finder


_WINDOW = (TOPICS, START, END, NODES, RUNS)

ROUTES: tuple[Route, ...] = (
    Route(
        "/api/studio",
        studio_answer,
        "Whether the Studio, in which Look shows messages, is installed.",
    ),
    Route(
        "/api/connections",
        _connections,
        "The topics with messages in a time range, or latched before it by a run with messages in "
        "it, or under names; their number of messages in it, and their schemas.",
        (*_WINDOW, TIME),
    ),
    Route(
        "/api/messages",
        _messages,
        "A page of the serialised messages of a time range, in the order of their key times: "
        "frames of uint32 channel, uint32 size, int64 time (ns), all little endian, and size "
        "bytes; those of channel 0 are JSON (channel, problem, end).",
        (
            *_WINDOW,
            Parameter("after", "text", "Cursor: end.next of the page before."),
            Parameter(
                "bytes",
                "count",
                f"Size of messages after which the page ends, bytes, 1 to {MAX_PAGE_BYTES}.",
                default=MESSAGE_PAGE_BYTES,
            ),
        ),
        CONTENT_TYPE,
    ),
    Route(
        "/api/latest",
        _latest,
        "The last message of each topic at or before a time, as frames: for transforms those of "
        "the second before, for latched topics the last one of each publisher, however old.",
        (
            TOPICS,
            Parameter("time", "time", "Last time, included; missing: now."),
            Parameter("start", "time", "First time of messages that are not latched."),
            NODES,
            RUNS,
        ),
        CONTENT_TYPE,
    ),
)


DAY_NS = 24 * 3600 * SECOND_NS


def default_window(
    start: int | None, end: int | None, time: int | None, newest: int | None
) -> TimeRange:
    """Return the time range to open; one day if start or end is missing.

    It is half a day on both sides of ``time``, else one day from the given end on, else the last
    day with messages.

    Args:
        start, end, time: Times of the request, ns; None = not given.
        newest: Time of reception of the last message, ns; None = no message is stored.
    """
    if start is not None and end is not None:
        return TimeRange(start, end)
    if time is not None:
        half = DAY_NS // 2
        return TimeRange(
            max(0, time - half) if start is None else start,
            min(LAST_NS, time + half) if end is None else end,
        )
    if start is not None:
        return TimeRange(start, min(LAST_NS, start + DAY_NS))
    end = newest or 0 if end is None else end
    return TimeRange(max(0, end - DAY_NS), end)


class WindowContent(NamedTuple):
    """The messages in a time range, as accurate as the directory."""

    messages: int = 0
    """Number of messages."""
    size: int = 0
    """Size of the messages, bytes."""
    first: int | None = None
    """Time of reception of the first message, ns; None = no message."""
    last: int | None = None
    """Time of reception of the last message, ns; None = no message."""

    @classmethod
    def of_lanes(cls, lanes: Iterable[Lane]) -> WindowContent:
        """Return the sum over some lanes."""
        lanes = list(lanes)
        firsts, lasts = ([lane.times[end] for lane in lanes] for end in (0, 1))
        return cls(
            sum(lane.messages for lane in lanes),
            sum(lane.bytes for lane in lanes),
            min((t for t in firsts if t is not None), default=None),
            max((t for t in lasts if t is not None), default=None),
        )
