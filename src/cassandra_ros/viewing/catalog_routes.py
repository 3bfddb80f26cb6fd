# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What there is: the keyspace, its topics and runs."""

from __future__ import annotations

from datetime import datetime
from typing import Iterable, Sequence

from cassandra_ros.errors import InvalidOption
from cassandra_ros.messages.stamps import to_ns
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.stores.fleet.fleet_info import FleetTopicInfo
from cassandra_ros.stores.fleet.fleet_topic import FleetTopic
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.run_list import list_runs
from cassandra_ros.topics.stored_totals import TopicInfo
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.api_call import RUNS, TOPICS, ApiCall
from cassandra_ros.viewing.route import Parameter, Route

MAX_LISTED = 10_000
"""Maximum number of runs or marks in one answer."""
_USUAL_RUNS = 500


def _keyspace(call: ApiCall) -> Json:
    store = call.store
    keyspaces: list[Json] = [
        {
            "keyspace": info.name,
            "topics": info.topics,
            "tables": info.tables,
            "copies": dict(info.copies),
        }
        for info in store.getKeyspaces()
    ]
    absence = call.catalog.keyspace.side_tables.absence()
    return {
        "keyspace": store.keyspace,
        "exists": not absence,
        "text": absence,
        "keyspaces": keyspaces,
        "stores": [],
        "allow_writes": call.settings.allow_writes,
    }


def _topics(call: ApiCall) -> Json:
    store, names = call.store, call.texts("topics")
    topics = [store.getTopic(name) for name in names] if names else store.getAllTopics()
    if not call.flag("counts"):
        return {"topics": [topic_entry(topic) for topic in topics]}
    infos: dict[str, list[TopicInfo]] = {}
    for info in store.info([topic.name for topic in topics]) if topics else ():
        infos.setdefault(info.topic, []).append(info)
    return {
        "topics": [{**topic_entry(topic), **_counts(infos.get(topic.name, []))} for topic in topics]
    }


def topic_entry(topic: CassandraTopic | FleetTopic) -> dict[str, Json]:
    """Return the description of a topic, without anything that is counted over its messages."""
    tables = [table.metadata for table in topic.tables]
    return {
        "topic": topic.name,
        "types": _distinct(table.msg_type for table in tables),
        "formats": _distinct(table.format for table in tables),
        "key": _distinct(table.key_part or table.key_format for table in tables),
        "indexes": _distinct(field for table in tables for field in table.indexes),
        "ttl_sec": max((table.ttl for table in tables), default=0),
        "comment": next((table.comment for table in tables if table.comment), ""),
        "meta": {name: value for table in tables for name, value in table.user.items()},
    }


def _distinct(texts: Iterable[str]) -> list[Json]:
    return list(dict.fromkeys(texts))


def totals(infos: Sequence[TopicInfo | FleetTopicInfo]) -> dict[str, Json]:
    """Return the robots, the counts and the time range of a topic."""
    starts = [info.first_ns for info in infos if info.first_ns is not None]
    ends = [info.last_ns for info in infos if info.last_ns is not None]
    return {
        "nodes": _distinct(info.node for info in infos if info.count),
        "messages": sum(info.count for info in infos),
        "bytes": sum(info.bytes for info in infos),
        "start": shown_ns(min(starts, default=None)),
        "end": shown_ns(max(ends, default=None)),
    }


def _counts(infos: Sequence[TopicInfo]) -> dict[str, Json]:
    """Return the counts of a topic, in total and by table and robot."""
    fullest = max(infos, key=lambda info: info.count, default=None)
    # A topic in two formats has its losses at both.
    lost = {info.node: info.lost for info in infos}
    return {
        **totals(infos),
        # The rate of one robot: the sum over several robots would mislead.
        "rate_hz": None if fullest is None else fullest.rate_hz,
        "lost": sum(lost.values()),
        "tables": [_table(info) for info in infos],
    }


def _table(info: TopicInfo) -> Json:
    return {
        "table": info.table,
        "type": info.type,
        "md5sum": info.md5sum,
        "format": info.format,
        "node": info.node,
        "messages": info.count,
        "bytes": info.bytes,
        "start": shown_ns(info.first_ns),
        "end": shown_ns(info.last_ns),
        "rate_hz": info.rate_hz,
        "bucket_ns": str(info.bucket_ns),
    }


def shown_ns(ns: int | None) -> str | None:
    """Return a time, ns since 1970, as a text: JavaScript's numbers cannot hold it."""
    return None if ns is None else str(ns)


def shown_time(time: datetime | None) -> str | None:
    """Return a time of the registry, UTC, as a text of ns since 1970."""
    return None if time is None else str(to_ns(time))


def _runs(call: ApiCall) -> Json:
    return listed_runs(call, runs_of(call.catalog, call.flag("counts")))


def runs_of(catalog: Catalog, counts: bool) -> list[Run]:
    """Return the runs of a keyspace; counts: messages of runs that did not end are counted, too."""
    return list_runs(catalog.keyspace, catalog.tables(None) if counts else ())


def listed_runs(call: ApiCall, runs: Iterable[Run]) -> dict[str, Json]:
    """Return the selected runs as JSON."""
    names, limit = call.texts("runs"), listed_at_most(call)
    by_topic, counts = call.flag("by_topic"), call.flag("counts")
    selected = [r for r in runs if not names or r.name in names or str(r.writer) in names]
    selected.sort(key=lambda run: str(run.started), reverse=True)
    listed: list[Json] = [_run(run, by_topic, counts) for run in selected[:limit]]
    return {"runs": listed, "left_off": max(len(selected) - limit, 0)}


def limit_parameter(what: str, default: int) -> Parameter:
    """Return the parameter that ``listed_at_most`` reads; ``what`` is listed."""
    text = f"Maximum number of {what}, to {MAX_LISTED}."
    return Parameter("limit", "count", text, default=default)


def listed_at_most(call: ApiCall) -> int:
    """Return the parameter limit.

    Raises:
        InvalidOption: The limit is above MAX_LISTED.
    """
    limit = call.count("limit")
    if limit is None or limit > MAX_LISTED:
        raise InvalidOption(f"limit {limit}: an answer lists at most {MAX_LISTED}")
    return limit


def _run(run: Run, by_topic: bool, counts: bool) -> dict[str, Json]:
    counted = counts or run.ended is not None
    entry: dict[str, Json] = {
        "run": run.name or str(run.writer),
        "id": run.writer,
        "node": run.node,
        "kind": run.kind,
        "state": run.state,
        "started": shown_time(run.started),
        "ended": shown_time(run.ended),
        "source": run.source,
        "host": run.host,
        "format": run.format,
        "labels": dict(run.public_labels),
        "messages": sum(run.stored.values()) if counted else None,
        "lost": sum(run.lost.values()),
    }
    if by_topic:
        entry.update(stored_of=dict(run.stored), lost_of=dict(run.lost))
    return entry


ROUTES: tuple[Route, ...] = (
    Route(
        "/api/keyspace",
        _keyspace,
        "The keyspace that is shown, and the other keyspaces that have topics. A viewer of several "
        "stores has their names in `stores`; each of its answers has `partial`, and in `missing` "
        "the stores that did not answer, with the reason.",
    ),
    Route(
        "/api/topics",
        _topics,
        "Topics, sorted by name: types, formats, number of messages and time range.",
        (TOPICS, Parameter("counts", "flag", "Count messages, from the directory.", default=True)),
    ),
    Route(
        "/api/runs",
        _runs,
        "Recordings and imports, the latest first: state, labels, stored and lost messages.",
        (
            RUNS,
            limit_parameter("runs", _USUAL_RUNS),
            Parameter("by_topic", "flag", "Add stored_of and lost_of, messages by topic."),
            Parameter(
                "counts",
                "flag",
                "Count messages of runs that did not end, too, from the directory.",
                default=True,
            ),
        ),
    ),
)
