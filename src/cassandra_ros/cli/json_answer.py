# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Output of verbs for other programs: one JSON document on standard output.

Times of messages are integer nanoseconds, in fields that end in _ns. Wall clock times (the start of
a run, say) are ISO 8601 in UTC. Sizes are bytes. A missing value is null. Warnings and errors go to
standard error.
"""

from __future__ import annotations

import argparse
import base64
import json
import math
from dataclasses import asdict, is_dataclass
from datetime import datetime, timezone
from enum import Enum
from typing import Mapping

from cassandra_ros.cli.terminal_text import write_utf8


def add_json_option(parser: argparse._ActionsContainer) -> None:
    """Add --json."""
    parser.add_argument(
        "--json",
        action="store_true",
        help="print the answer as one JSON document, for other programs: times in nanoseconds, "
        "sizes in bytes",
    )


def print_json(answer: object) -> None:
    """Print a value that plain() accepts as JSON. Unprintable characters are escaped."""
    write_utf8()
    text = json.dumps(plain(answer), ensure_ascii=False, allow_nan=False, indent=1)
    print("".join(c if c.isprintable() or c == "\n" else json.dumps(c)[1:-1] for c in text))


def tell(options: argparse.Namespace, answer: object, text: str) -> None:
    """Print what a verb has to say: with --json the answer, else the text, unless -q is given.

    Args:
        options: The parsed options.
        answer: A value that plain() accepts.
        text: The same for people; '' = there is nothing to say.
    """
    if options.json:
        print_json(answer)
    elif text and not getattr(options, "quiet", False):
        print(text)


def plain(value: object) -> object:
    """Return a value in the types of JSON.

    Accepted are dataclasses, mappings, lists, tuples, sets, texts, numbers, True, False, None,
    enumerations (their values), datetimes (without a zone they are UTC) and bytes (base64). NaN and
    infinities become null.

    Raises:
        TypeError: The value, or a part of it, has another type.
    """
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Enum):
        return plain(value.value)
    if value is None or isinstance(value, (str, int)):
        return value
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(name): plain(inner) for name, inner in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(inner) for inner in value]
    if isinstance(value, (bytes, bytearray)):
        return base64.b64encode(value).decode("ascii")
    if isinstance(value, datetime):
        return _utc(value)
    raise TypeError(f"{type(value).__name__} cannot be part of an answer")


def _utc(when: datetime) -> str:
    # Datetimes of the driver are UTC but have no time zone.
    aware = when if when.tzinfo else when.replace(tzinfo=timezone.utc)
    return aware.astimezone(timezone.utc).isoformat().replace("+00:00", "Z")
