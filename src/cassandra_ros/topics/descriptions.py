# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Descriptions of topics as text, for repr, and as tables for notebooks."""

from __future__ import annotations

from typing import Callable, Iterable, Sequence

from cassandra_ros.errors import CassandraRosError
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.printable import PrintableList, html_table, shown
from cassandra_ros.store.tables.directory import Directory
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.topics.stored_totals import TopicInfo, describe
from cassandra_ros.topics.topic_table import TopicTable


def topic_facts(directory: Directory, tables: Sequence[TopicTable]) -> dict[str, str]:
    """Return the facts of a stored topic, by heading; counts and times come from the directory.

    Messages with names are not counted, because that would read all keys.
    """
    facts = {
        "type": _join(table.metadata.msg_type for table in tables),
        "format": _join(table.metadata.format for table in tables),
    }
    if any(table.named for table in tables):
        return {**facts, "messages": f"under names ({tables[0].metadata.key_format})"}
    infos = [info for info in describe(directory, tables) if info.count]
    facts["messages"] = str(sum(info.count for info in infos))
    firsts = [info.first_ns for info in infos if info.first_ns is not None]
    lasts = [info.last_ns for info in infos if info.last_ns is not None]
    if firsts and lasts:
        facts.update({"from": iso_time(min(firsts)), "to": iso_time(max(lasts))})
    robots = _join(info.node for info in infos if info.node)
    return {**facts, "robots": robots} if robots else facts


def _join(texts: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(texts))


def topic_line(
    name: str, directory: Directory, read_tables: Callable[[], Sequence[TopicTable]]
) -> str:
    """Return one line about a topic, also if it has no type yet or the store does not answer."""
    name = shown(name)
    try:
        tables = read_tables()
        if not tables:
            return f"<CassandraTopic {name}: no type yet, its first message fixes it>"
        facts = topic_facts(directory, tables)
    except CassandraRosError as exc:
        # A debugger must be able to show the object even if its store does not answer.
        return f"<CassandraTopic {name}: it cannot be read now: {shown(str(exc), None)}>"
    text = f"{facts['type']} in format {facts['format']}, messages: {facts['messages']}"
    if "from" in facts:
        text += f" from {facts['from']} to {facts['to']}"
    if "robots" in facts:
        text += f", robots: {shown(facts['robots'])}"
    return f"<CassandraTopic {name}: {text}>"


def topic_html(name: str, directory: Directory, tables: Sequence[TopicTable]) -> str:
    """Return the facts of a topic as an HTML table for a notebook."""
    facts = topic_facts(directory, tables) if tables else {"type": "none yet"}
    return html_table(("topic", name), list(facts.items()))


def _time(ns: int | None) -> str:
    """Return a time as text; '' = no time."""
    return "" if ns is None else iso_time(ns)


class InfoList(PrintableList[TopicInfo]):
    """Stored topics: a row for each topic, table and robot."""

    COLUMNS = {
        "topic": lambda info: info.topic,
        "type": lambda info: info.type,
        "format": lambda info: info.format,
        "robot": lambda info: info.node,
        "messages": lambda info: info.count,
        "bytes": lambda info: info.bytes,
        "from": lambda info: _time(info.first_ns),
        "to": lambda info: _time(info.last_ns),
        "lost": lambda info: info.lost,
    }


class RunList(PrintableList[Run]):
    """Recordings and imports."""

    COLUMNS = {
        "run": lambda run: run.name,
        "id": lambda run: run.writer,
        "robot": lambda run: run.node,
        "kind": lambda run: run.kind,
        "start": lambda run: run.started or "",
        "end": lambda run: run.ended or "",
        "state": lambda run: run.state,
        "messages": lambda run: sum(run.stored.values()),
        "lost": lambda run: sum(run.lost.values()),
        "labels": lambda run: ", ".join(f"{k}={v}" for k, v in run.labels.items()),
    }
