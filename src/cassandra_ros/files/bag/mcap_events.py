# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Events as metadata of an MCAP file: one record named NAME for each event, with texts by name.

Other readers ignore these records, or show them as they are.
"""

from __future__ import annotations

import json
from typing import Mapping

from cassandra_ros.arguments import (
    check_event_name,
    check_event_values,
    check_integer,
    check_labels,
    check_new_node,
    check_text,
)
from cassandra_ros.errors import BagError, CassandraRosError
from cassandra_ros.read import LAST_NS
from cassandra_ros.store.tables.event_table import Event

NAME = "cassandra_ros.event"
"""Name of the metadata record of an event. It is in the files, so it must not change."""
MAX_EVENT_BYTES = 1 << 20
"""Maximum size of a record that is read as an event, bytes."""
MAX_EVENTS = 100_000
"""Maximum number of events that are read of a file."""
_MAX_ID_BYTES = 64
"""Maximum size of the id of an event in a file, bytes; ours are shorter."""


def fields_of(event: Event) -> dict[str, str]:
    """Return the fields of the metadata record of an event."""
    return {
        "name": event.name,
        "start_ns": str(event.start_ns),
        "end_ns": "" if event.end_ns is None else str(event.end_ns),
        "node": event.node,
        "labels": json.dumps(dict(event.labels), ensure_ascii=False),
        "values": json.dumps(dict(event.values), ensure_ascii=False),
        "id": event.id,
    }


def event_of(fields: Mapping[str, str], where: str) -> Event:
    """Return the event in the fields of a metadata record, which any program may have written.

    Raises:
        BagError: A field is missing, is not of its form, or is one that addEvent refuses.
    """
    try:
        end = fields.get("end_ns", "")
        start_ns = _time("start_ns", fields["start_ns"])
        end_ns = None if end == "" else _time("end_ns", end)
        if end_ns is not None and end_ns < start_ns:
            raise BagError("its end is before its start")
        return Event(
            check_event_name(fields["name"]),
            start_ns,
            end_ns,
            check_new_node(fields.get("node", "")),
            labels=check_labels(json.loads(fields.get("labels") or "{}")),
            values=check_event_values(json.loads(fields.get("values") or "{}")),
            id=check_text("id", fields["id"], _MAX_ID_BYTES),
        )
    except (KeyError, ValueError, RecursionError, CassandraRosError) as exc:
        raise BagError(f"{where}: an event in its metadata is damaged: {exc}") from exc


def _time(name: str, text: str) -> int:
    """Return a time of an event, ns, 0 to LAST_NS - 1; raises InvalidOption for any other text."""
    # Not int() alone: it takes ' 1_0 ', too, and is slow for a very long text.
    digits = text.isascii() and text.isdigit() and len(text) < 20
    return check_integer(name, int(text) if digits else text, 0, LAST_NS - 1)
