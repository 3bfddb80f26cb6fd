# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Stored messages as text for people and programs: as rostopic echo prints them, or as JSON."""

from __future__ import annotations

import json
from base64 import b64encode
from typing import Callable

from cassandra_ros.messages.formats.json import CassandraTopic_json
from cassandra_ros.messages.tree.echo import echo_printer
from cassandra_ros.messages.tree.tree_reader import Budget, tree_reader
from cassandra_ros.query.tree.json_values import MAX_ANSWER_BYTES, AnswerBound
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_table import TopicTable

_NO_LIMIT = 2**62
_REMEDY = (
    "give elements and characters, which leave long arrays and strings out, or read it in Python"
)
_Print = Callable[[bytes], str]


class MessageText:
    """Writes messages as text; the writer is compiled once for each table.

    Args:
        as_json: As rosbridge writes them: times as secs and nsecs, uint8[] as base64, NaN as null.
            False = as rostopic echo prints them.
        elements: Maximum number of elements of an array that are written; of a longer array only
            type and length. None = no limit.
        characters: Maximum number of characters of a string that are written; of a longer string
            only its length in bytes. None = no limit.
        bounded: Refuse texts with more characters than an answer may have bytes.
    """

    def __init__(
        self,
        as_json: bool,
        elements: int | None = None,
        characters: int | None = None,
        bounded: bool = False,
    ) -> None:
        self._max_text = MAX_ANSWER_BYTES if bounded else _NO_LIMIT
        """Maximum number of characters of a text."""
        self._json = as_json
        self._elements = _NO_LIMIT if elements is None else elements
        self._characters = _NO_LIMIT if characters is None else characters
        self._prints: dict[str, _Print] = {}
        """Table → function that writes its messages."""

    def of(self, row: StoredRow) -> str:
        """Return the text of a message.

        Raises:
            AnswerTooLarge: The text is bounded and would be longer.
            CorruptMessage: The bytes are not a message of the type.
        """
        print_message = self._prints.get(row.table.name)
        if print_message is None:
            print_message = self._prints[row.table.name] = self._print_of(row.table)
        return print_message(row.wire)

    def _print_of(self, table: TopicTable) -> _Print:
        """Return the function that writes the messages of a table."""
        metadata, definition, as_json = table.metadata, table.definition, self._json
        too_long = AnswerBound(f"the text of a message of topic {metadata.topic}", _REMEDY).error
        if definition is None:

            def print_bytes(wire: bytes) -> str:
                if as_json and len(wire) > self._max_text:
                    raise too_long()
                return _bytes_alone(metadata.msg_type, wire, as_json)

            return print_bytes
        reader, show = tree_reader(definition), echo_printer(definition)
        if as_json:
            show = CassandraTopic_json(metadata.msg_type, metadata.md5sum, definition).print_tree

        def print_wire(wire: bytes) -> str:
            tree = reader.read(wire, Budget(self._max_text, 1, self._elements, self._characters))
            if tree is None:
                raise too_long()
            return show(tree)

        return print_wire


def _bytes_alone(msg_type: str, wire: bytes, as_json: bool) -> str:
    """Return the text of a message without a usable definition."""
    if as_json:
        return json.dumps({"bytes": b64encode(wire).decode("ascii")})
    return f"# {len(wire)} bytes of {msg_type!r}, of which no usable definition is stored"
