# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Windows of time as files: /window.bag and /window.mcap, for rosbag, Foxglove, Lichtblick, curl.

A window is written to disk as it is read, and sent from there, in parts where parts are asked for:
Foxglove and Lichtblick open a file by asking for all of it, look how long it is, and then take the
parts that they show. Its ETag tells the content: what was stored since makes it another one. Parts
that are asked for without If-Range are of the file that was opened last, so that one that is looked
at while it is recorded stays one file.
"""

from __future__ import annotations

import hashlib
from functools import partial
from pathlib import Path
from typing import Iterator

from cassandra_ros.bag.exporter import export_bag, why_empty
from cassandra_ros.bag.message_file import MessageProgress
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import InvalidOption, MessageNotFound
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.overview.content_version import content_version
from cassandra_ros.overview.latched_messages import latched_before
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.viewing.answers import Answer, SpooledFile, Stream
from cassandra_ros.viewing.call import Call
from cassandra_ros.viewing.route import Parameter, Route
from cassandra_ros.viewing.selected import SELECTION, Selected, selected
from cassandra_ros.viewing.spool import Spool
from cassandra_ros.viewing.viewer_settings import ViewerSettings

_CONTENT_TYPES = {"bag": "application/x-rosbag", "mcap": "application/x-mcap"}
_COMPRESSIONS = {"bag": ("none", "lz4", "bz2"), "mcap": ("none", "lz4", "zstd")}
_STREAM = Parameter(
    "stream",
    "flag",
    "Send the file while it is written: at once, but without its length and not in parts, which "
    "Foxglove and Lichtblick need.",
)


def make_spool(settings: ViewerSettings) -> Spool:
    """Make the spool of a viewer; half of those who are answered at a time may wait for files."""
    return Spool(settings.spool, settings.spool_bytes, max(1, settings.threads // 2))


def _answer(call: Call, ending: str) -> Answer:
    wanted, compression = selected(call), _compression(call, ending)
    latched, streamed = call.flag("latched"), ending == "mcap" and call.flag("stream")
    spool, name = call.shared_by_all(make_spool), _name(call.catalog, wanted, ending)
    request = _digest(repr((ending, wanted, compression, latched, call.catalog.keyspace.name)))
    headers = call.headers
    if "range" in headers and not {"if-range", "if-match"}.intersection(headers):
        known = spool.latest(request)
        if known is not None:
            return SpooledFile(known.path, name, _CONTENT_TYPES[ending], known.key)
    key = _digest(request + _version(call.catalog, wanted, latched))
    write = partial(_write, call.store, wanted, compression, latched)

    def chunks() -> Iterator[bytes]:
        with spool.lease(key, request, name, write) as lease:
            yield from lease.follow(call.gone)

    if streamed:
        disposition = f'attachment; filename="{name}"'
        return Stream(
            chunks(),
            _CONTENT_TYPES[ending],
            {"Content-Disposition": disposition, "ETag": f'"{key}"'},
        )
    with spool.lease(key, request, name, write) as lease:
        return SpooledFile(lease.wait(call.gone), name, _CONTENT_TYPES[ending], key)


def _compression(call: Call, ending: str) -> str | None:
    found, known = call.text("compression"), _COMPRESSIONS[ending]
    if found is not None and found not in known:
        raise InvalidOption(
            f"compression {found[:80]!r} is none of {', '.join(known)}, which {ending} files have"
        )
    return found


def _name(catalog: Catalog, wanted: Selected, ending: str) -> str:
    """Return as which a window is saved: of letters that every file system takes."""
    begin = "" if wanted.start is None else "_" + iso_time(wanted.start.ns)[:19]
    return f"{catalog.keyspace.name}{begin}.{ending}".replace(":", "-")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()[:32]


def _version(catalog: Catalog, wanted: Selected, latched: bool) -> str:
    """Return what tells the content of a window; of the directory."""
    topics, time_range, before = wanted.topics, wanted.time_range, []
    if latched and wanted.start is not None:
        before = latched_before(
            catalog,
            time_range.low,
            topics,
            to=time_range.high,
            nodeID=wanted.node,
            run=wanted.whose.writers,
            where=wanted.where or None,
        )
    tables = catalog.tables(topics)
    return content_version(catalog.keyspace.directory, tables, time_range, wanted.whose, before)


def _write(
    store: RosCassandra,
    wanted: Selected,
    compression: str | None,
    latched: bool,
    path: Path,
    progress: MessageProgress,
) -> None:
    try:
        export_bag(
            store,
            path,
            topics=wanted.topics,
            start=wanted.start,
            end=wanted.end,
            nodeID=wanted.node,
            compression=compression,
            progress=progress,
            where=wanted.where or None,
            run=wanted.whose.writers,
            latched=latched,
        )
    except MessageNotFound as exc:
        reason = why_empty(store.catalog, wanted.topics, wanted.node, wanted.whose.writers)
        raise MessageNotFound(f"there is no such message: {reason}") from exc


def _parameters(ending: str) -> tuple[Parameter, ...]:
    usual = "none" if ending == "bag" else "zstd"
    known = ", ".join(_COMPRESSIONS[ending])
    parameters = (
        *SELECTION,
        Parameter("compression", "text", f"One of {known} (default: {usual})."),
        Parameter(
            "latched",
            "flag",
            "Begin with what was latched before the start: the last such message of each "
            "publisher, at the time of the start.",
            default=True,
        ),
    )
    return parameters if ending == "bag" else (*parameters, _STREAM)


ROUTES: tuple[Route, ...] = tuple(
    Route(
        f"/window.{ending}",
        partial(_answer, ending=ending),
        f"Messages as {what}, as cassandra_bag export writes it; also in parts (Range).",
        _parameters(ending),
        _CONTENT_TYPES[ending],
    )
    for ending, what in (("bag", "a bag of format 2.0"), ("mcap", "an MCAP of profile ros1"))
)
