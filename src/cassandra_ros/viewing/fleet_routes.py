# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The routes of a viewer that shows several stores as one: each message once, in order of time.

They have the paths and parameters of those of one store. Each answer names the stores that did not
answer. Routes that one store answers are refused with what to do instead.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Callable, Collection, Dict, Iterable, Iterator, Mapping, Sequence, Union

from cassandra_ros.arguments import check_node, spellings
from cassandra_ros.errors import (
    DefinitionError,
    MessageNotFound,
    RunNotFound,
    SchemaConflict,
    TopicNotFound,
)
from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.tree.statement_completion import NameSource
from cassandra_ros.read import EVERYBODY, Read, Whose
from cassandra_ros.store.tables.registry import Loss, Run
from cassandra_ros.stores.fleet.fleet import find_row
from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer, settled, told
from cassandra_ros.stores.fleet.fleet_info import FleetTopicInfo, describe_topic
from cassandra_ros.stores.fleet.fleet_reads import (
    events_of,
    merged_topics,
    topic_names,
    topics_of,
    writers_of,
)
from cassandra_ros.stores.fleet.fleet_row import FleetRow, merged_rows
from cassandra_ros.stores.fleet.fleet_topic import FleetTopic, find_topic, topic_of
from cassandra_ros.topics.overview.latched_messages import is_latched, publisher_of
from cassandra_ros.topics.overview.latest_messages import (
    TRANSFORM_TYPES,
    TRANSFORMS_NS,
    Latest,
    sources_at,
)
from cassandra_ros.topics.overview.plot_series import SeriesRequest, read_rows_series
from cassandra_ros.topics.query_result import QueryResult
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.viewing import (
    ask_routes,
    catalog_routes,
    event_routes,
    image_routes,
    look_routes,
    timeline_routes,
)
from cassandra_ros.viewing.answers import Answer, Bytes, Json, StreamedBody
from cassandra_ros.viewing.api_call import ApiCall
from cassandra_ros.viewing.message_frames import CONTENT_TYPE, frames
from cassandra_ros.viewing.openapi import describe
from cassandra_ros.viewing.route import Route
from cassandra_ros.viewing.routes import ROUTES

_Told = Union[Dict[str, Json], Bytes, StreamedBody]
_Work = Callable[[ApiCall, FleetAnswer], _Told]


def _of_all(work: _Work, call: ApiCall) -> Answer:
    """Answer a call over all stores, and say which of them did not answer.

    A StreamedBody is not complete yet: it says so itself at its end, see ``_stream``.

    Args:
        work: Makes the answer. It is called again if a store goes away meanwhile, so it must change
            nothing.
    """
    fleet = call.fleet
    stores = fleet.begin(call.watch)
    try:
        answer = settled(stores, lambda: work(call, stores))
    finally:
        fleet.note(stores)
    if isinstance(answer, StreamedBody):
        return answer
    if isinstance(answer, Bytes):
        away = {"X-Missing": json.dumps(stores.missing)} if stores.partial else {}
        return replace(answer, headers={**answer.headers, **away})
    return {**answer, **_missing(stores)}


def _missing(stores: FleetAnswer) -> dict[str, Json]:
    return {"partial": stores.partial, "missing": dict(stores.missing)}


def _refuse(call: ApiCall) -> Answer:
    """Refuse a call that one store answers."""
    return {"store": repr(call.store)}  # raises the error that says what to do


def _whose(call: ApiCall, stores: FleetAnswer) -> Whose:
    """Return the robots and runs of a call, see api_call.whose_of.

    A run that only a store has that does not answer has no messages.

    Raises:
        RunNotFound: No store has one of the runs, and all stores answer.
    """
    nodes, runs = call.texts("nodes"), call.texts("runs")
    writers: set[int] = set()
    for run in runs or ():
        try:
            writers |= writers_of(stores, run)
        except RunNotFound:
            if not stores.partial:
                raise
    return Whose(
        tuple(map(check_node, nodes)) if nodes else None, frozenset(writers) if runs else None
    )


def _topics_of(call: ApiCall, stores: FleetAnswer) -> tuple[list[FleetTopic], list[Json]]:
    """Return the topics of a call, and those that cannot be read, with reasons.

    Raises:
        TopicNotFound: No store has a topic that the call names, and all stores answer.
        DefinitionError, SchemaConflict: A topic that the call names cannot be read.
    """
    names = call.texts("topics")
    topics: list[FleetTopic] = []
    problems: list[Json] = []
    for name in names or topic_names(stores):
        try:
            topics += topics_of(stores, [name])
        except TopicNotFound as exc:
            if not stores.partial:
                raise
            problems.append({"topic": name, "text": str(exc)})
        except (DefinitionError, SchemaConflict) as exc:
            if names:
                raise
            problems.append({"topic": name, "text": str(exc)})
    return list({frozenset(topic.names.items()): topic for topic in topics}.values()), problems


def _keyspace(call: ApiCall, stores: FleetAnswer) -> _Told:
    return {
        "keyspace": "",
        "exists": True,
        "text": "",
        "keyspaces": [],
        "stores": [*call.fleet.names],
        "allow_writes": False,
    }


def _notes(call: ApiCall, stores: FleetAnswer) -> _Told:
    def unknown_robot(node: str) -> str:
        reasons = stores.each(stores.catalogs, lambda c: c.keyspace.runs.unknown_robot(node))
        return next(iter(reasons.values()), "") if all(reasons.values()) else ""

    notes = timeline_routes.notes_of(call, unknown_robot, lambda: call.fleet.ends(stores))
    # A store that does not answer may have them.
    return {"notes": [] if stores.partial else notes}


def _topics(call: ApiCall, stores: FleetAnswer) -> _Told:
    topics, problems = _topics_of(call, stores)
    listed: list[Json] = []
    for topic in topics:
        entry = catalog_routes.topic_entry(topic)
        if call.flag("counts"):
            entry.update(_counts(list(describe_topic(stores, topic, EVERYBODY))))
        listed.append(entry)
    return {"topics": listed, "problems": problems}


def _counts(infos: Sequence[FleetTopicInfo]) -> dict[str, Json]:
    names = dict.fromkeys(name for info in infos for name in info.stores)
    return {
        **catalog_routes.totals(infos),
        "stores": {name: sum(info.stores.get(name, 0) for info in infos) for name in names},
    }


def _all_runs(stores: FleetAnswer, counts: bool = False) -> list[Run]:
    """Return the runs of all stores, each as the store describes it that knows most of it."""
    runs_of_store = stores.each(stores.catalogs, lambda c: catalog_routes.runs_of(c, counts))
    best: dict[tuple[int, str], Run] = {}
    for run in chain.from_iterable(runs_of_store.values()):
        key = run.writer, run.node
        best[key] = max(best.get(key, run), run, key=_known_of)
    return list(best.values())


def _known_of(run: Run) -> tuple[bool, bool, int]:
    return run.ended is not None, run.state == "recording", sum(run.stored.values())


def _runs(call: ApiCall, stores: FleetAnswer) -> _Told:
    return catalog_routes.listed_runs(call, _all_runs(stores, call.flag("counts")))


def _marks(call: ApiCall, stores: FleetAnswer) -> _Told:
    topics = call.texts("topics") or None
    read = Read(call.time_range(), _whose(call, stores))
    losses_of_store = stores.each(stores.catalogs, lambda c: c.keyspace.runs.losses(topics, read))
    losses: dict[tuple[object, ...], Loss] = {}
    for loss in chain.from_iterable(losses_of_store.values()):  # a copy may be older: a loss grows
        key = loss.topic, loss.node, loss.writer, loss.kind, loss.first_ns
        losses[key] = max(
            losses.get(key, loss),
            loss,
            key=lambda listed_loss: (listed_loss.last_ns, listed_loss.count),
        )
    return event_routes.listed_marks(call, _all_runs(stores), losses.values(), read)


def _events(call: ApiCall, stores: FleetAnswer) -> _Told:
    name, whose = call.text("name"), _whose(call, stores)
    events = events_of(stores, name, None, call.time_range(), whose)
    return event_routes.listed_events(call, events)


def _timeline(call: ApiCall, stores: FleetAnswer) -> _Told:
    view = timeline_routes.view_of(call, _whose(call, stores))
    picture = call.fleet.picture(stores, view, call.gone)
    return timeline_routes.shown_picture(picture, _all_runs(stores))


def _query(call: ApiCall, stores: FleetAnswer) -> _Told:
    _refuse_sql(call)
    limit = min(call.count("limit") or ask_routes.ANSWER_PAGE_ROWS, ask_routes.MAX_ANSWER_PAGE_ROWS)
    select = ask_routes.statement_of(call)
    topic = topic_of(stores, select)
    result = QueryResult(
        ask_routes.windowed(call, select, topic.tables),
        topic,
        _whose_asked(call, stores),
        after=call.text("after"),
        watch=call.watch,
    )
    with result:
        return ask_routes.page_of(call, result, topic.tables, limit)


def _refuse_sql(call: ApiCall) -> None:
    if ask_routes.is_sql(call):
        _refuse(call)


def _whose_asked(call: ApiCall, stores: FleetAnswer) -> Whose:
    """Return the robot and the runs of a statement, which itself names the robots if several."""
    return Whose.of(ask_routes.one_node(call), _whose(call, stores).writers)


def _plot(call: ApiCall, stores: FleetAnswer) -> _Told:
    _refuse_sql(call)
    select = ask_routes.statement_of(call)
    topic = topic_of(stores, select)
    request = SeriesRequest(_whose_asked(call, stores), watch=call.watch)
    select = ask_routes.windowed(call, select, topic.tables)
    series = read_rows_series(topic, select, ask_routes.window_of(call), request)
    return ask_routes.shown_series(series)


def _complete(call: ApiCall, stores: FleetAnswer) -> _Told:
    _refuse_sql(call)

    def definitions(name: str) -> Sequence[Definition]:
        known_names = {text for topic in topic_names(stores) for text in spellings(topic)}
        if name not in known_names:
            return ()
        tables = find_topic(stores, name).tables
        return [table.definition for table in tables if table.definition is not None]

    def nodes() -> Sequence[str]:
        nodes_of_store = stores.each(
            stores.catalogs, lambda c: {i.node for i in c.infos(None) if i.count}
        )
        return sorted(set().union(*nodes_of_store.values()) - {""})

    def runs() -> Sequence[str]:
        return list(dict.fromkeys(run.name for run in _all_runs(stores) if run.name))

    names = NameSource(lambda: topic_names(stores), definitions, nodes, runs)
    return ask_routes.completed(call, names)


def _connections(call: ApiCall, stores: FleetAnswer) -> _Told:
    topics, problems = _topics_of(call, stores)
    tables = [table for topic in topics for table in topic.tables]
    draw = partial(call.fleet.picture, stores, gone=call.gone)

    def latched(
        names: Collection[str], sources: frozenset[tuple[str, int]], t: int
    ) -> Collection[str]:
        of_store = stores.each(
            stores.catalogs, lambda c: look_routes.latched_topics(c, names, sources, t)
        )
        return set().union(*of_store.values())

    return look_routes.connections_of(call, tables, _whose(call, stores), draw, latched, problems)


def _messages(call: ApiCall, stores: FleetAnswer) -> _Told:
    read, limit = look_routes.page_read(call, _whose(call, stores))
    topics = [t for t in _topics_of(call, stores)[0] if not any(table.named for table in t.tables)]
    rows = merged_topics(stores, topics, read, {}, received=False)
    return _stream(call, stores, filter(_is_shown, rows), limit)


def _is_shown(row: FleetRow) -> bool:
    return not look_routes.reason_not_shown(row.table)


def _stream(
    call: ApiCall, stores: FleetAnswer, rows: Iterator[FleetRow], limit: int | None = None
) -> StreamedBody:
    """Return messages as frames, and note at the end which stores did not answer."""

    def chunks() -> Iterator[bytes]:
        try:
            yield from frames(look_routes.until_gone(call, rows), limit, stores.missing)
        finally:
            call.fleet.note(stores)

    return StreamedBody(chunks(), CONTENT_TYPE)


def _latest(call: ApiCall, stores: FleetAnswer) -> _Told:
    """Return the latest messages before a time, as ``look_routes`` does for one store.

    Which runs go on at that time is asked of all stores together: a robot's newest run may be in
    another store than its earlier ones.
    """
    whose, (t, since) = _whose(call, stores), look_routes.moment_of(call)
    names: dict[str, list[str]] = {}
    for topic in _topics_of(call, stores)[0]:
        for store, name in topic.names.items():
            names.setdefault(store, []).append(name)

    def make(store: str) -> Latest:
        catalog = stores.catalogs[store]
        tables = [t for t in catalog.tables(names[store]) if not look_routes.reason_not_shown(t)]
        return Latest(catalog.keyspace, tables, whose)

    finders = stores.each({store: store for store in names}, make)

    def sources(low: int, high: int) -> frozenset[tuple[str, int]]:
        return frozenset().union(*stores.each(finders, lambda f: f.sources(low, high)).values())

    present = sources_at(sources, t, since)

    def begin(finder: Latest) -> Iterator[StoredRow]:
        return iter(finder.before(t, since, present))

    rows = merged_rows(stores, {store: partial(begin, finder) for store, finder in finders.items()})
    return _stream(call, stores, iter(_held_messages(rows, t, since)))


def _held_messages(rows: Iterable[FleetRow], t: int, since: int) -> list[FleetRow]:
    """Return which of the last messages of each store hold at t, as one store with all tells it.

    Args:
        rows: What ``Latest.before`` of each store gave, in order of time.
    """
    last: dict[tuple[object, ...], FleetRow] = {}
    moving: set[str] = set()
    """Topics of transforms with messages so late that all of them count."""
    for row in rows:
        key: tuple[object, ...] = (row.topic,)
        if row.table.named:
            key = row.topic, row.node, row.name
            if row.t > t and key in last:
                continue  # a store without an earlier version gives its first
        elif row.table.msg_type in TRANSFORM_TYPES and row.t >= max(since, t - TRANSFORMS_NS):
            moving.add(row.topic)
            key = row.topic, row.identity
        elif _is_latched(row):
            holds_alone = row.table.msg_type in TRANSFORM_TYPES
            key = row.topic, row.identity if holds_alone else publisher_of(row)
        last[key] = row
    held_rows = (row for key, row in last.items() if len(key) > 1 or row.topic not in moving)
    return sorted(held_rows, key=lambda row: row.identity)


def _is_latched(row: FleetRow) -> bool:
    try:
        return is_latched(row.connection)
    except MessageNotFound:  # its store went away
        return False


def _row(call: ApiCall, stores: FleetAnswer) -> FleetRow:
    topic = call.text("topic") or ""
    key, nearest = image_routes.key_of(call, find_topic(stores, topic).key_of_text)
    row = find_row(stores, topic, key, nearest, None, None, None)
    if row is None:
        away = f"; these do not answer: {told(stores.missing)}" if stores.partial else ""
        raise MessageNotFound(f"no store has a message of topic {topic} at {key!r:.80}{away}")
    return row


def _message(call: ApiCall, stores: FleetAnswer) -> _Told:
    row = _row(call, stores)
    return row.ask(
        lambda stored_row: image_routes.message_answer(call, stored_row, _missing(stores))
    )


def _image(call: ApiCall, stores: FleetAnswer) -> _Told:
    return _row(call, stores).ask(partial(image_routes.image_answer, call))


def _describe(call: ApiCall) -> Json:
    return describe(FLEET_ROUTES)


_WORK: Mapping[str, _Work] = {
    "/api/keyspace": _keyspace,
    "/api/notes": _notes,
    "/api/topics": _topics,
    "/api/runs": _runs,
    "/api/marks": _marks,
    "/api/events": _events,
    "/api/timeline": _timeline,
    "/api/query": _query,
    "/api/plot": _plot,
    "/api/complete": _complete,
    "/api/connections": _connections,
    "/api/messages": _messages,
    "/api/latest": _latest,
    "/api/message": _message,
    "/api/image": _image,
}
"""Routes that all stores answer, by path."""
_STORELESS = {"/api/studio": look_routes.studio_answer, "/api/openapi.json": _describe}
"""Routes that need no store, by path."""


def _route_of_all(route: Route) -> Route:
    if route.path in _STORELESS:
        return replace(route, answer=_STORELESS[route.path])
    if route.path in _WORK:
        return replace(route, answer=partial(_of_all, _WORK[route.path]))
    return replace(route, answer=_refuse, summary=f"Refused: one store answers it. {route.summary}")


FLEET_ROUTES: tuple[Route, ...] = tuple(map(_route_of_all, ROUTES))
"""All routes of one store, in the same order."""
