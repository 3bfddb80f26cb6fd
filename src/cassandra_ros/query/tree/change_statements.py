# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Syntax trees of statements that change the store; their parts are in syntax.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Optional, Union

from cassandra_ros.query.tree.syntax import Expression, Path


@dataclass(frozen=True)
class Delete:
    """A DELETE statement with all its values bound."""

    text: str
    topic: str
    topic_position: int
    condition: Expression


@dataclass(frozen=True)
class Truncate:
    """A TRUNCATE statement."""

    text: str
    topic: str
    topic_position: int


@dataclass(frozen=True)
class IndexName:
    """Name of an index; in lower case unless it was quoted."""

    text: str
    position: int


@dataclass(frozen=True)
class Indexed:
    """``topic (field)``: the indexed field."""

    topic: str
    topic_position: int
    field: Path


@dataclass(frozen=True)
class CreateIndex:
    """A CREATE INDEX statement."""

    text: str
    on: Indexed
    name: Optional[IndexName]
    unless_exists: bool
    """Whether the statement has IF NOT EXISTS."""


@dataclass(frozen=True)
class DropIndex:
    """A DROP INDEX statement."""

    text: str
    index: Union[IndexName, Indexed]
    if_exists: bool


Change = Union[Delete, Truncate, CreateIndex, DropIndex]
"""Any statement that changes the store."""
