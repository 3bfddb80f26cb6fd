# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Requests and answers of the service ~mark, which recorder and query_server have."""

from __future__ import annotations

from typing import Mapping

from cassandra_ros.arguments import exact_json
from cassandra_ros.errors import InvalidOption
from cassandra_ros.nodes.ros_node import ros_time
from cassandra_ros.srv import MarkResponse
from cassandra_ros.store.tables.event_table import Event


def read_values(text: str) -> Mapping[str, object]:
    """Read the values of an event, a JSON object; '' = none; raises InvalidOption."""
    try:
        values = exact_json(text) if text.strip() else {}
    except InvalidOption:
        raise
    except (ValueError, RecursionError):
        values = None
    if not isinstance(values, dict):
        raise InvalidOption(f'values are a JSON object, as {{"force": 12.5}}, not {text!r:.80}')
    return values


def pack_event(event: Event, response: MarkResponse) -> None:
    """Write the event that a call began or ended into its answer."""
    response.key, response.lasting = event.key, event.end_ns is None
    ns = event.start_ns if event.end_ns is None else event.end_ns
    response.time = ros_time(ns)
