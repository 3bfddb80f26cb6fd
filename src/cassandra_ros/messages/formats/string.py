# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Format ``string``: the text that ``rostopic echo`` prints, and the wire bytes."""

from __future__ import annotations

from typing import Sequence

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.formats.cassandra_topic_ import EncodedMessage
from cassandra_ros.messages.formats.text_column import TextFormat
from cassandra_ros.messages.tree.echo import echo_printer
from cassandra_ros.messages.tree.tree_reader import MessageTree


class CassandraTopic_string(TextFormat):
    """Text for people. It is never parsed: every row also holds the wire bytes."""

    NAME = "string"

    def __init__(self, msg_type: str, md5sum: str, definition: Definition | None) -> None:
        super().__init__(msg_type, md5sum, definition)
        self._print = echo_printer(self.definition)

    def print_tree(self, tree: MessageTree) -> str:
        """Return the text that rostopic prints."""
        return self._print(tree)

    def encode_wire(self, wire: bytes) -> EncodedMessage:
        """Return the text and the bytes of a message."""
        printed = self.print_wire(wire)
        text = None if printed is None else printed[0].encode()
        return EncodedMessage((text,), printed is None, wire)

    def decode_wire(self, columns: Sequence[bytes | None], raw: bytes | None) -> bytes:
        """Return the bytes that the row holds."""
        if raw is None:
            raise CorruptMessage(f"a row of {self.msg_type} in format string has no bytes")
        return raw
