# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What `cassandra_bag info` prints about several stores."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Mapping, Sequence

from cassandra_ros.cli.terminal_text import counted, format_bytes, format_table
from cassandra_ros.printable import format_duration, shown

if TYPE_CHECKING:
    from cassandra_ros.stores.fleet.fleet_info import FleetTopicInfo

_HEADER = ("topic", "type", "format", "node", "messages", "size", "first", "last", "in")


def print_infos(infos: Sequence[FleetTopicInfo]) -> None:
    """Print a summary, and a line for each topic, type and robot."""
    from cassandra_ros.messages.stamps import iso_time

    firsts = [info.first_ns for info in infos if info.first_ns is not None]
    lasts = [info.last_ns for info in infos if info.last_ns is not None]
    if firsts and lasts:
        print(f"duration:  {format_duration(max(lasts) - min(firsts))}")
        print(f"start:     {iso_time(min(firsts))}")
        print(f"end:       {iso_time(max(lasts))}")
    print(f"size:      {format_bytes(sum(info.bytes for info in infos))}")
    topics = counted(len({info.topic for info in infos}), "topic")
    print(f"messages:  {sum(info.count for info in infos)} of {topics}, each counted once")
    if infos:
        print()
        print(format_table(_HEADER, list(map(_row, infos)), right=("messages", "size")))


def _row(info: FleetTopicInfo) -> Sequence[str]:
    from cassandra_ros.messages.stamps import iso_time

    return (
        shown(info.topic),
        info.type,
        ", ".join(info.formats),
        shown(info.node) or "-",
        str(info.count),
        format_bytes(info.bytes),
        "-" if info.first_ns is None else iso_time(info.first_ns),
        "-" if info.last_ns is None else iso_time(info.last_ns),
        ", ".join(f"{shown(name)} {count}" for name, count in info.stores.items()) or "-",
    )


def answer_of(infos: Sequence[FleetTopicInfo], missing: Mapping[str, str]) -> dict[str, object]:
    """Return the answer for YAML and JSON; ``missing`` is store → why it did not answer."""
    topics = []
    for info in infos:
        topics.append({**asdict(info), "messages": info.count, "size": info.bytes})
    return {
        "messages": sum(info.count for info in infos),
        "size": sum(info.bytes for info in infos),
        "partial": bool(missing),
        "missing": dict(missing),
        "topics": topics,
    }
