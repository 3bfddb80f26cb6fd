# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The tables of SQL that are no topics: topics, runs, losses, events, constants of messages."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Callable, Mapping, Sequence

from cassandra_ros.client.sql.table_sources import ListSource
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.query.tree.json_values import to_json
from cassandra_ros.read import Read
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.run_list import list_runs

Rows = Sequence[Sequence[Any]]
_EPOCH = datetime(1970, 1, 1)


def _topics(catalog: Catalog) -> Rows:
    return [
        (i.topic, i.node, i.type, i.md5sum, i.format, i.key, i.count, i.bytes)
        + (i.first_ns, i.last_ns, i.rate_hz, i.lost)
        for i in catalog.infos(None)
    ]


def _runs(catalog: Catalog) -> Rows:
    return [
        (r.name or str(r.writer), r.node, r.kind, r.state, r.source, r.host)
        + (_ns(r.started), _ns(r.ended), sum(r.stored.values()), sum(r.lost.values()))
        + (to_json(dict(r.public_labels)), r.writer)
        for r in list_runs(catalog.keyspace, catalog.tables(None))
    ]


def _losses(catalog: Catalog) -> Rows:
    runs = catalog.keyspace.runs
    return [
        (x.topic, x.node, runs.text(x.writer), x.kind.value, x.first_ns, x.last_ns, x.count or None)
        for x in runs.losses(None, Read())
    ]


def _events(catalog: Catalog) -> Rows:
    runs = catalog.keyspace.runs
    return [
        (e.name, e.node, runs.text(e.writer) if e.writer else "", e.start_ns, e.end_ns)
        + (to_json(dict(e.labels)), to_json(dict(e.values)), e.key)
        for e in catalog.keyspace.events.find()
    ]


def _constants(catalog: Catalog) -> Rows:
    """Return the constants of all message types of the topics: whole, as a number, and as text."""
    values_of: dict[tuple[str, str], tuple[int | None, float | None, str]] = {}
    for table in catalog.tables(None):
        specs = {} if table.definition is None else table.definition.specs
        for spec in specs.values():
            for constant in spec.constants:
                whole = int(constant.value) if isinstance(constant.value, int) else None
                number = None if isinstance(constant.value, str) else float(constant.value)
                values_of[spec.type, constant.name] = (whole, number, str(constant.value))
    return [(*names, *values) for names, values in sorted(values_of.items())]


def _ns(time: datetime | None) -> int | None:
    """Return the ns since 1970 of a time in UTC, which the registry keeps in ms."""
    if time is None:
        return None
    length = time.replace(tzinfo=None) - _EPOCH
    return (length.days * 86_400 + length.seconds) * SECOND_NS + length.microseconds * 1000


_TEXT, _INT, _TIME = "string", "int64", "time"
LISTED: Mapping[str, tuple[Mapping[str, str], Callable[[Catalog], Rows]]] = {
    "topics": (
        {
            **{"TOPIC": _TEXT, "NODE": _TEXT, "type": _TEXT, "md5sum": _TEXT, "format": _TEXT},
            **{"key": _TEXT, "messages": _INT, "bytes": _INT, "first": _TIME, "last": _TIME},
            **{"rate_hz": "float64", "lost": _INT},
        },
        _topics,
    ),
    "runs": (
        {
            **{"RUN": _TEXT, "NODE": _TEXT, "kind": _TEXT, "state": _TEXT, "source": _TEXT},
            **{"host": _TEXT, "started": _TIME, "ended": _TIME, "messages": _INT, "lost": _INT},
            **{"labels": _TEXT, "writer": _INT},
        },
        _runs,
    ),
    "events": (
        {
            **{"EVENT": _TEXT, "NODE": _TEXT, "RUN": _TEXT, "first": _TIME, "last": _TIME},
            **{"labels": _TEXT, "values": _TEXT, "key": _TEXT},
        },
        _events,
    ),
    "constants": (
        {"TYPE": _TEXT, "NAME": _TEXT, "value": "decimal", "number": "float64", "text": _TEXT},
        _constants,
    ),
    "losses": (
        {
            **{"TOPIC": _TEXT, "NODE": _TEXT, "RUN": _TEXT, "reason": _TEXT},
            **{"first": _TIME, "last": _TIME, "messages": _INT},
        },
        _losses,
    ),
}
"""Columns with their types, and the function that makes the rows, by name of the table. The values
of a row are in the order of the columns."""


def listed_source(arrow: Any, catalog: Catalog, name: str) -> ListSource:
    """Return one of the tables in LISTED; ``arrow`` is the module pyarrow."""
    columns, rows = LISTED[name]
    # All other types are functions of pyarrow. The decimal holds uint64.
    special = {_TIME: arrow.timestamp("ns"), "decimal": arrow.decimal128(20, 0)}
    kinds = {
        column: special[kind] if kind in special else getattr(arrow, kind)()
        for column, kind in columns.items()
    }
    return ListSource(arrow, arrow.schema(list(kinds.items())), lambda: rows(catalog))
