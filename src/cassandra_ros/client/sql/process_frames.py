# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Frames between a program and its processes for statements: a kind, a length, and the content.

Record batches are streams of Arrow, everything else is JSON.
"""

from __future__ import annotations

import json
import struct
from typing import Any, Mapping

from cassandra_ros import errors
from cassandra_ros.errors import CassandraRosError

MAX_FRAME_BYTES = 64 << 20
"""Maximum size of a frame, bytes."""
HEAD = struct.Struct("<cI")
"""Head of a frame: its kind, and the length of its content in bytes."""

HELLO = b"H"
"""To the process, first: address and login of the store, and the limits of the process."""
ASK = b"A"
"""To the process: a statement."""
STOP = b"S"
"""To the process: end what runs."""
COLUMNS = b"C"
"""From the process: the names of the columns; the statement is right."""
BATCH = b"B"
"""From the process: some rows."""
PLAN = b"P"
"""From the process: the explanation of the statement."""
END = b"E"
"""From the process: the answer is whole, and why no message was found."""
STOPPED = b"T"
"""From the process: what ran has ended, because it was told to."""
ERROR = b"X"
"""From the process: the error that ended the statement."""
FATAL = b"F"
"""From the process: the error that ended the statement, and the process."""
LAST = (END, STOPPED, ERROR, FATAL)
"""Kinds of the last frame of an answer."""


def frame(kind: bytes, content: bytes) -> bytes:
    """Return a frame."""
    return HEAD.pack(kind, len(content)) + content


def json_frame(kind: bytes, values: Mapping[str, object]) -> bytes:
    """Return a frame of JSON; halves of surrogate pairs stay what they are."""
    return frame(kind, json.dumps(values).encode("ascii"))


def error_values(exc: BaseException) -> dict[str, object]:
    """Return an error as values of JSON; ``error_of`` makes it again, with its text alone.

    Of our errors 'error' is the class; '' = another class, whose name begins the text.
    """
    if isinstance(exc, errors.InvalidQuery):
        return {"error": "InvalidQuery", "args": [exc.statement, exc.position, exc.reason]}
    if isinstance(exc, CassandraRosError) and hasattr(errors, type(exc).__name__):
        return {"error": type(exc).__name__, "args": [str(exc)]}
    return {"error": "", "args": [f"{type(exc).__name__}: {exc}"]}


def error_of(values: Mapping[str, Any]) -> Exception:
    """Return an error from values of JSON; a RuntimeError for one that is not of our tree."""
    kind = getattr(errors, str(values["error"]), None)
    if isinstance(kind, type) and issubclass(kind, CassandraRosError):
        return kind(*values["args"])
    return RuntimeError(*values["args"])
