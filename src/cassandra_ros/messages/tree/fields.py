# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which fields of a message are numbers, and with what struct those side by side are read."""

from __future__ import annotations

import struct
from typing import Sequence

from cassandra_ros.messages.spec import Field
from cassandra_ros.messages.wire.values import CODES

_OTHERS = ("time", "duration", "byte", "char")
NUMBER_CODES = {name: code for name, code in CODES.items() if name not in _OTHERS}
"""struct codes of all primitive types (old names resolved) but string, time and duration."""

TIME_CODES = {"time": "<II", "duration": "<ii"}
TIME_NAMES = ("secs", "nsecs")


def numberRuns(fields: Sequence[Field]) -> list[list[Field]]:
    """Return fields in order, those together that one struct reads: numbers, or bools."""
    runs: list[list[Field]] = []
    for field in fields:
        if runs and _is_number(field) and _is_number(runs[-1][-1]):
            if (field.type == "bool") == (runs[-1][-1].type == "bool"):
                runs[-1].append(field)
                continue
        runs.append([field])
    return runs


def runStruct(run: Sequence[Field]) -> struct.Struct | None:
    """Return what reads a run of numbers, None where it is one field of another kind."""
    if not _is_number(run[0]):
        return None
    return struct.Struct("<" + "".join(NUMBER_CODES[field.base] for field in run))


def isBytes(field: Field) -> bool:
    """Return whether a field's tree is bytes."""
    return field.is_array and field.base == "uint8"


def _is_number(field: Field) -> bool:
    return not field.is_array and field.base in NUMBER_CODES
