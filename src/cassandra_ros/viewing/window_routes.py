# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Time ranges as files: /window.bag and /window.mcap, for rosbag, Foxglove, Lichtblick and curl.

The messages are written to a file on disk, which is sent as a whole or in requested parts:
Foxglove and Lichtblick open a file by requesting all of it, read its length, and then request the
parts that they show. The ETag identifies the content: it changes when further messages are stored.
Parts requested without If-Range are taken from the file that was requested last, so that a client
that looks at a topic while it is recorded gets all parts of one file.
"""

from __future__ import annotations

import hashlib
import re
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Iterator, Mapping

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import InvalidOption, MessageNotFound
from cassandra_ros.files.bag.exporter import export_bag, why_empty
from cassandra_ros.files.bag.message_file import MessageProgress
from cassandra_ros.messages.stamps import Stamp, iso_time
from cassandra_ros.read import Nodes, Read, TimeRange, Whose
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.overview.content_version import content_version
from cassandra_ros.topics.overview.latched_messages import latched_before
from cassandra_ros.topics.overview.plot_series import NEAR_KEPT_SEC
from cassandra_ros.topics.row_finder import Where, range_between
from cassandra_ros.viewing.answers import Answer, CachedFile, StreamedBody
from cassandra_ros.viewing.api_call import END, NODES, RUNS, START, TOPICS, ApiCall, whose_of
from cassandra_ros.viewing.download_cache import DownloadCache
from cassandra_ros.viewing.route import Parameter, Route
from cassandra_ros.viewing.viewer_settings import ViewerSettings

_WHERE = Parameter(
    "where",
    "lines",
    "'TOPIC: CONDITION': only messages of the topic that satisfy the condition, written as in CQL; "
    "other topics are complete.",
)
SELECTION = (TOPICS, START, END, NODES, RUNS, _WHERE)
"""Parameters that ``read_selection`` reads."""


@dataclass(frozen=True)
class MessageSelection:
    """A selection of messages."""

    topics: tuple[str, ...] | None
    """Stored names of the topics, sorted; None = all."""
    start: Stamp | None
    """First time of reception, included; None = not limited."""
    end: Stamp | None
    """Last time of reception, included; None = not limited."""
    whose: Whose
    where: Mapping[str, Where]
    """Condition by topic. If several robots are selected, it restricts the messages to them."""

    @property
    def time_range(self) -> TimeRange:
        """Selected time range, ns."""
        return range_between(self.start, self.end)


def read_selection(call: ApiCall) -> MessageSelection:
    """Read the parameters SELECTION of a call.

    Raises:
        TopicNotFound, RunNotFound: A topic or run is not stored.
        InvalidOption: The start lies after the end, a condition has no topic, or a topic has two
            conditions.
    """
    start, end = call.stamp("start"), call.stamp("end")
    if start is not None and end is not None and start > end:
        raise InvalidOption(f"start {start} lies after end {end}")
    catalog, names, whose = call.catalog, call.texts("topics"), whose_of(call)
    topics = tuple(sorted({catalog.get(name).name for name in names})) if names else None
    where = _of_nodes(catalog, topics, _conditions(catalog, call.lines("where")), whose.nodes)
    return MessageSelection(topics, start, end, whose, where)


def _conditions(catalog: Catalog, lines: tuple[str, ...]) -> dict[str, Where]:
    conditions: dict[str, Where] = {}
    for line in lines:
        topic, _, condition = (text.strip() for text in line.partition(":"))
        if not (topic and condition):
            raise InvalidOption(f"where {line[:200]!r} is not of the form 'TOPIC: CONDITION'")
        name = catalog.get(topic).name
        if name in conditions:
            raise InvalidOption(f"where has two conditions for {name}; join them with AND or OR")
        conditions[name] = condition
    return conditions


def _of_nodes(
    catalog: Catalog, topics: tuple[str, ...] | None, where: dict[str, Where], nodes: Nodes
) -> dict[str, Where]:
    """Add the selected robots to the conditions if there are several: reads take one, or all."""
    if nodes is None or len(nodes) == 1:
        return where
    names = [topic.name for topic in catalog.all(None)] if topics is None else topics
    of_them = f"NODE IN ({', '.join('?' * len(nodes))})"
    conditions: dict[str, Where] = dict(where)
    for name in names:
        condition = where.get(name)
        conditions[name] = (of_them if condition is None else f"({condition}) AND {of_them}", nodes)
    return conditions


_MOVING = re.compile(r"\b(near|now|today)\b", re.IGNORECASE)
"""What a condition's answer may change by, although the messages stay: poses, and the time."""
_CONTENT_TYPES = {"bag": "application/x-rosbag", "mcap": "application/x-mcap"}
_COMPRESSIONS = {"bag": ("none", "lz4", "bz2"), "mcap": ("none", "lz4", "zstd")}
_STREAM = Parameter(
    "stream",
    "flag",
    "Send the file while it is written: it begins at once, but has no length and no parts, which "
    "Foxglove and Lichtblick need.",
)


def make_cache(settings: ViewerSettings) -> DownloadCache:
    """Return the cache of a viewer; at most half of the handler threads may wait for files."""
    return DownloadCache(settings.cache, settings.cache_bytes, max(1, settings.threads // 2))


def _answer(call: ApiCall, ending: str) -> Answer:
    selection, compression = read_selection(call), _compression(call, ending)
    latched, streamed = call.flag("latched"), ending == "mcap" and call.flag("stream")
    cache, name = call.cached_by_viewer(make_cache), _name(call.catalog, selection, ending)
    request = _digest(repr((ending, selection, compression, latched, call.catalog.keyspace.name)))
    headers = call.headers
    if "range" in headers and not {"if-range", "if-match"}.intersection(headers):
        latest = cache.latest(request)
        if latest is not None:
            return CachedFile(latest.path, name, _CONTENT_TYPES[ending], latest.key)
    key = _digest(request + _version(call.catalog, selection, latched))
    write = partial(_write, call.store, selection, compression, latched)

    def chunks() -> Iterator[bytes]:
        with cache.lease(key, request, name, write) as lease:
            yield from lease.follow(call.gone)

    if streamed:
        disposition = f'attachment; filename="{name}"'
        return StreamedBody(
            chunks(),
            _CONTENT_TYPES[ending],
            {"Content-Disposition": disposition, "ETag": f'"{key}"'},
        )
    with cache.lease(key, request, name, write) as lease:
        return CachedFile(lease.wait(call.gone), name, _CONTENT_TYPES[ending], key)


def _compression(call: ApiCall, ending: str) -> str | None:
    compression, choices = call.text("compression"), _COMPRESSIONS[ending]
    if compression is not None and compression not in choices:
        raise InvalidOption(
            f"compression {compression[:80]!r} is not possible in {ending} files: "
            f"give one of {', '.join(choices)}"
        )
    return compression


def _name(catalog: Catalog, selection: MessageSelection, ending: str) -> str:
    """Return the name under which a browser saves the file, valid in every file system."""
    begin = "" if selection.start is None else "_" + iso_time(selection.start.ns)[:19]
    return f"{catalog.keyspace.name}{begin}.{ending}".replace(":", "-")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()[:32]


def _version(catalog: Catalog, selection: MessageSelection, latched: bool) -> str:
    """Return a text that identifies the content of a selection, computed from the directory."""
    topics, time_range, before = selection.topics, selection.time_range, []
    if latched and selection.start is not None:
        before = latched_before(
            catalog,
            time_range.low,
            topics,
            to=time_range.high,
            nodeID=selection.whose.node,
            run=selection.whose.writers,
            where=selection.where or None,
        )
    keyspace = catalog.keyspace
    read = Read(time_range, selection.whose)
    version = content_version(keyspace.directory, catalog.tables(topics), read, before)
    # An MCAP has the events, too, and a condition may choose by them.
    version += "".join(map(repr, keyspace.events.find(None, within=time_range, whose=read.whose)))
    if any(_MOVING.search(repr(condition)) for condition in (selection.where or {}).values()):
        version += f" {time.time() // NEAR_KEPT_SEC}"
    return version


def _write(
    store: RosCassandra,
    selection: MessageSelection,
    compression: str | None,
    latched: bool,
    path: Path,
    progress: MessageProgress,
) -> None:
    """Write the selected messages into a file of the cache.

    The cache calls it on a thread of its own, which may go on after the request has ended.

    Args:
        path: The file. Its ending, which ``_name`` gave it, decides between a bag and an MCAP.
        progress: See MessageProgress. Its exception ends the writing, which nothing else does.

    Raises:
        MessageNotFound: There is no such message; the text says why.
    """
    try:
        export_bag(
            store,
            path,
            topics=selection.topics,
            start=selection.start,
            end=selection.end,
            nodeID=selection.whose.node,
            compression=compression,
            progress=progress,
            where=selection.where or None,
            run=selection.whose.writers,
            latched=latched,
            event_nodes=selection.whose.nodes,
        )
    except MessageNotFound as exc:
        whose = selection.whose
        reason = why_empty(store.catalog, selection.topics, whose.node, whose.writers)
        raise MessageNotFound(f"there is no such message: {reason}") from exc


def _parameters(ending: str) -> tuple[Parameter, ...]:
    usual = "none" if ending == "bag" else "zstd"
    choices = ", ".join(_COMPRESSIONS[ending])
    parameters = (
        *SELECTION,
        Parameter("compression", "text", f"One of {choices} (default: {usual})."),
        Parameter(
            "latched",
            "flag",
            "Begin with the messages latched before the start: the last one of each "
            "publisher, at the time of the start.",
            default=True,
        ),
    )
    return parameters if ending == "bag" else (*parameters, _STREAM)


ROUTES: tuple[Route, ...] = tuple(
    Route(
        f"/window.{ending}",
        partial(_answer, ending=ending),
        f"Messages as {what}, as written by cassandra_bag export; Range gives parts of it.",
        _parameters(ending),
        _CONTENT_TYPES[ending],
    )
    for ending, what in (("bag", "a bag of format 2.0"), ("mcap", "an MCAP of profile ros1"))
)
