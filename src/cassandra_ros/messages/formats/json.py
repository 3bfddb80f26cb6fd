# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Format ``json``: the message as rosbridge writes it."""

from __future__ import annotations

import json
from base64 import b64decode, b64encode
from math import isfinite

from cassandra_ros.messages.formats.text_column import ParsedFormat
from cassandra_ros.messages.tree.tree_encoder import plain_bytes
from cassandra_ros.messages.tree.tree_reader import MessageTree


class CassandraTopic_json(ParsedFormat):
    """Strict, compact JSON: uint8[] and char[] as base64, NaN and infinity as null.

    A row whose text has a null also holds the wire bytes, which are read instead. 64-bit integers
    are numbers, as in rosbridge; JavaScript rounds them above 2**53.
    """

    NAME = "json"
    BYTE_CHARACTERS = 1

    def print_tree(self, tree: MessageTree) -> str:
        """Return the JSON text of a message."""
        try:
            return _encode(tree)
        except ValueError:  # a float is infinite or NaN
            return _encode(_finite(tree))

    def is_faithful(self, text: str) -> bool:
        """Return whether no float was written as null; all other values are read as written."""
        return "null" not in text

    def parse_own(self, text: str) -> object:
        """Return the parsed JSON."""
        return _decode(text)

    @staticmethod
    def field_bytes(value: object) -> bytes:
        """Return the bytes of a base64 text or a list of numbers, as rosbridge accepts."""
        return b64decode(value, validate=True) if isinstance(value, str) else plain_bytes(value)


def _base64(value: bytes) -> str:
    return b64encode(value).decode("ascii")


def _refuse(name: str) -> None:
    raise ValueError(f"{name} is not JSON")


def _float(text: str) -> float:
    """Return a number of a text, as strict JSON has it: 1e999 is refused, not infinite."""
    value = float(text)
    if not isfinite(value):
        raise ValueError(f"{text[:80]} is out of range")
    return value


def _finite(value: object) -> object:
    """Return a tree with None in place of infinite and NaN floats."""
    if isinstance(value, dict):
        return {name: _finite(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not isfinite(value) else value


_encode = json.JSONEncoder(
    ensure_ascii=False,
    check_circular=False,
    allow_nan=False,
    separators=(",", ":"),
    default=_base64,
).encode
_decode = json.JSONDecoder(parse_float=_float, parse_constant=_refuse).decode
