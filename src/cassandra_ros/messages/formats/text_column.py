# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The common part of the text formats: one column of at most 64 KiB."""

from __future__ import annotations

from abc import abstractmethod
from typing import Sequence

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.formats.cassandra_topic_ import CassandraTopic_, EncodedMessage
from cassandra_ros.messages.tree.tree_encoder import plain_bytes, tree_encoder
from cassandra_ros.messages.tree.tree_reader import Budget, MessageTree, tree_reader

MAX_COLUMN_BYTES = 64 * 1024
"""Maximum size of the text of a message in its column, bytes; a longer one is shortened."""

_WHOLE = (MAX_COLUMN_BYTES, MAX_COLUMN_BYTES)
_SHORTENED = (
    (256, MAX_COLUMN_BYTES),
    (16, MAX_COLUMN_BYTES),
    (0, MAX_COLUMN_BYTES),
    (0, 256),
    (0, 0),
)
"""Pairs of maximum array length (elements) and string size (bytes), tried until the text fits."""


class TextFormat(CassandraTopic_):
    """A message as a text for people.

    In a text over 64 KiB, long arrays and then long strings are replaced by the text that
    ``rostopic echo --noarr --nostr`` prints for them.
    """

    COLUMNS = {"_data": "text"}
    BYTE_CHARACTERS = 3
    """Minimum number of characters in the text for one byte of uint8[] or char[]."""

    def __init__(self, msg_type: str, md5sum: str, definition: Definition | None) -> None:
        super().__init__(msg_type, md5sum, definition)
        self.definition: Definition = self._usable()
        self._reader = tree_reader(self.definition)

    @abstractmethod
    def print_tree(self, tree: MessageTree) -> str | None:
        """Return the text of a message; None if it cannot be printed."""

    def print_wire(self, wire: bytes) -> tuple[str, MessageTree, bool] | None:
        """Return the text of a message, the printed tree, and whether the tree is shortened.

        None: the bytes are malformed, or even the shortest text is too long.
        """
        limits = _SHORTENED if len(wire) > MAX_COLUMN_BYTES else (_WHOLE, *_SHORTENED)
        for elements, length in limits:
            budget = Budget(MAX_COLUMN_BYTES, self.BYTE_CHARACTERS, elements, length)
            try:
                tree = self._reader.read(wire, budget)
                text = None if tree is None else self.print_tree(tree)
            except (CorruptMessage, RecursionError):
                return None
            if tree is not None and text is not None and len(text.encode()) <= MAX_COLUMN_BYTES:
                return text, tree, budget.shortened
        return None


class ParsedFormat(TextFormat):
    """A text that is parsed to read the message; if inexact, the row also holds the bytes."""

    def __init__(self, msg_type: str, md5sum: str, definition: Definition | None) -> None:
        super().__init__(msg_type, md5sum, definition)
        self._build = tree_encoder(self.definition, self.field_bytes)

    @staticmethod
    def field_bytes(value: object) -> bytes:
        """Return the bytes of uint8[] or char[] from the value that a parsed text has for them.

        Raises ValueError or TypeError: the value means no bytes.
        """
        return plain_bytes(value)

    @abstractmethod
    def is_faithful(self, text: str) -> bool:
        """Return whether a text of print_tree certainly parses to the same tree.

        If it says so, the text is not parsed before it is stored.
        """

    @abstractmethod
    def parse_own(self, text: str) -> object:
        """Return the parsed text of print_tree; other texts may raise any exception."""

    def parse(self, text: str) -> object:
        """Return the parsed text, which anyone may have edited; may raise any Exception."""
        return self.parse_own(text)

    def encode_wire(self, wire: bytes) -> EncodedMessage:
        """Return the text of a message, and its bytes if the text does not give them back."""
        printed = self.print_wire(wire)
        if printed is None:
            return EncodedMessage((None,), True, wire)
        text, tree, shortened = printed
        exact = not shortened and self._is_exact(text, tree, wire)
        return EncodedMessage((text.encode(),), not exact, None if exact else wire)

    def _is_exact(self, text: str, tree: MessageTree, wire: bytes) -> bool:
        """Return whether the text of a tree gives back the bytes from which the tree was made."""
        try:
            return self._build(tree if self.is_faithful(text) else self.parse_own(text)) == wire
        except (CorruptMessage, RecursionError):
            return False

    def decode_wire(self, columns: Sequence[bytes | None], raw: bytes | None) -> bytes:
        """Return the row's wire bytes if it holds them, else build them from the text."""
        if raw is not None:
            return raw
        text, row = columns[0], f"a row of {self.msg_type}"
        if text is None or len(text) > MAX_COLUMN_BYTES:
            raise CorruptMessage(f"{row} in format {self.NAME} has no text of at most 64 KiB")
        try:
            tree = self.parse(text.decode())
        except Exception as exc:  # parsers raise many exceptions for a hostile text
            raise CorruptMessage(f"{row} is no {self.NAME}: {str(exc)[:200]}") from exc
        return self._build(tree)
