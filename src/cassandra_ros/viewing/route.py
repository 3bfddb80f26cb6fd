# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A route: one path of the API with its parameters and its handler."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Callable, Union

if TYPE_CHECKING:
    from cassandra_ros.viewing.answers import Answer
    from cassandra_ros.viewing.api_call import ApiCall

KINDS = {
    "text": "text",
    "texts": "texts, divided by commas, or the parameter several times",
    "lines": "a text, which commas do not divide; the parameter may be given several times",
    "time": "a time: seconds since 1970 (1368021980.25), ISO 8601 (2013-05-08T14:06:20Z, no zone "
    "means UTC), or nanoseconds since 1970, if it has 13 digits or more",
    "number": "a finite number",
    "count": "a whole number from 0",
    "flag": "true or false (1 or 0; without a value: true)",
}
"""Kinds of parameters, each with a description of its values."""

Value = Union[str, "tuple[str, ...]", int, float, bool, None]


@dataclass(frozen=True)
class Parameter:
    """A parameter in the query of a path."""

    name: str
    kind: str
    """One of KINDS."""
    summary: str
    """Description: one sentence with unit and limits."""
    required: bool = False
    default: Value = None


KEYSPACE = Parameter(
    "keyspace", "text", "Name of the keyspace; missing: that with which the viewer was started."
)
"""Parameter that every route has."""


def _takes_no_turn(call: ApiCall) -> bool:
    return False


@dataclass(frozen=True)
class Route:
    """A path and its handler, which is called on a thread: for GET and HEAD, or for POST."""

    path: str
    answer: Callable[[ApiCall], Answer]
    """Handler. Its errors of the tree in errors.py become a status and JSON."""
    summary: str
    """Description: one sentence."""
    parameters: tuple[Parameter, ...] = ()
    """Parameters in addition to KEYSPACE."""
    kind: str = "json"
    """Type of the answer: json, or a content type like image/jpeg."""
    takes_turns: Callable[[ApiCall], bool] = _takes_no_turn
    """Whether a call waits until few others like it run; it holds no handler thread meanwhile."""
    writes: bool = False
    """Whether it changes what is stored; then it answers POST only."""
