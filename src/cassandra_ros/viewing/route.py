# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A route: one path of the API, what it takes and who answers. All else is made of these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Callable, Union

if TYPE_CHECKING:
    from cassandra_ros.viewing.answers import Answer
    from cassandra_ros.viewing.call import Call

KINDS = {
    "text": "text",
    "texts": "texts, divided by commas, or the parameter several times",
    "lines": "a text, in which commas are no signs; the parameter may be given several times",
    "time": "a time: seconds since 1970 (1368021980.25), ISO 8601 (2013-05-08T14:06:20Z, no zone "
    "means UTC), or nanoseconds since 1970, for which 13 digits or more are taken",
    "number": "a finite number",
    "count": "a whole number from 0",
    "flag": "true or false (1 or 0; without a value: true)",
}
"""What a parameter may be, and how it is written."""

Value = Union[str, "tuple[str, ...]", int, float, bool, None]


@dataclass(frozen=True)
class Parameter:
    """A parameter in a path's query."""

    name: str
    kind: str
    """One of KINDS."""
    summary: str
    """One sentence, with unit and bounds."""
    required: bool = False
    default: Value = None


KEYSPACE = Parameter(
    "keyspace", "text", "Of this keyspace; missing: of that with which the viewer was started."
)
"""A parameter that each route takes."""


@dataclass(frozen=True)
class Route:
    """A path and the function that answers GET and HEAD there, on a thread of the pool."""

    path: str
    answer: Callable[[Call], Answer]
    """Raises errors of our tree, which become statuses and JSON."""
    summary: str
    """One sentence."""
    parameters: tuple[Parameter, ...] = ()
    """Without KEYSPACE."""
    kind: str = "json"
    """What is answered: json, or a content type as image/jpeg."""
