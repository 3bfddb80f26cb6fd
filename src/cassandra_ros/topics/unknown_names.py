# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Says why a condition finds nothing: it names a robot, a run or an event that is not stored."""

from __future__ import annotations

import logging
from typing import Iterable, Iterator, Sequence
from weakref import WeakSet

from cassandra_ros.keys import MAX_NS
from cassandra_ros.query.plan.bounds import disk_of, distinct
from cassandra_ros.query.protocols import WGS84, Stays, Table
from cassandra_ros.query.tree.syntax import (
    TIMED,
    Compare,
    Expression,
    InEvent,
    Leaf,
    Literal,
    Near,
    NodeOperand,
    OneOf,
    RunOperand,
    given,
    leaves,
)
from cassandra_ros.read import Read

_log = logging.getLogger(__name__)
_told: WeakSet[Stays] = WeakSet()
"""Lookups of places of which a warning said that they find no robot. Several topics may share one,
which is told once."""


def names_anything(condition: Expression | None) -> bool:
    """Return whether a condition names a robot, a run, an event or a place."""
    return any(isinstance(leaf, TIMED) or _names(leaf) for leaf in leaves(condition))


def warn_of_unknown_names(
    condition: Expression | None, tables: Sequence[Table], read: Read
) -> list[str]:
    """Log a warning for each name in a condition that is not stored, with similar names.

    Args:
        condition: The condition, after with_stays. It has found no message.
        tables: Tables of the topic, which may be in several keyspaces.
        read: Time range of the messages that were asked for.

    Returns:
        The texts.
    """
    return warn_of(_unknown_names(condition, tables, read))


def warn_of(reasons: Iterable[str]) -> list[str]:
    """Log the reasons for which no message is found, each once; return them. '' is no reason."""
    texts = list(dict.fromkeys(filter(None, reasons)))
    for reason in texts:
        _log.warning("no message is found: %s", reason)
    return texts


def _unknown_names(
    condition: Expression | None, tables: Sequence[Table], read: Read
) -> Iterator[str]:
    """Yield the reason for each name in a condition that finds nothing."""
    runs = distinct(table.runs for table in tables)
    events = distinct(table.events for table in tables)
    for leaf in leaves(condition) if tables else ():
        if isinstance(leaf, Near):
            yield from filter(None, [_no_robot_near(leaf, read)])
        elif isinstance(leaf, InEvent):
            name = str(leaf.name.value)
            yield from _of_all([source.unknown(name, leaf.like) for source in events])
        for is_robot, literal in _names(leaf):
            name = str(literal.value)
            yield from _of_all(
                [
                    source.unknown_robot(name) if is_robot else source.unknown(name)
                    for source in runs
                ]
            )


def _names(leaf: Leaf) -> Sequence[tuple[bool, Literal]]:
    """Return the names of robots (True) or runs (False) that a comparison asks for by = or IN."""
    if not isinstance(leaf, (Compare, OneOf)) or getattr(leaf, "operator", "=") != "=":
        return ()
    if not isinstance(leaf.operand, (NodeOperand, RunOperand)):
        return ()
    is_robot = isinstance(leaf.operand, NodeOperand)
    return [(is_robot, literal) for literal in given(leaf)]


def _of_all(reasons: Sequence[str]) -> Sequence[str]:
    """Return the first reason if each keyspace gives one; else the name is stored in one."""
    return reasons[:1] if all(reasons) else ()


def _no_robot_near(near: Near, read: Read) -> str:
    """Say, once, that no robot was on the disk of NEAR in the time of a read; else ''."""
    low, high = read.time_range
    if near.stays is None or near.stays in _told:
        return ""
    if next(near.stays.spans(low, min(high, MAX_NS)), None) is not None:
        return ""
    _told.add(near.stays)
    x, y, radius, frame, _ = disk_of(near)
    if frame == WGS84:
        return f"no robot was within {radius:g} m of latitude {x:g}, longitude {y:g} at that time"
    return (
        f"no robot was within {radius:g} m of ({x:g}, {y:g}) in frame {frame} at that time; x and "
        "y are metres in this frame, no latitude and longitude: these take a radius with its unit, "
        "as NEAR(43.47, -80.54, 20m)"
    )
