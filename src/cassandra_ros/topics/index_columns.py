# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class IndexColumns: makes the columns of a topic's indexes from its messages."""

from __future__ import annotations

import logging
from functools import partial
from typing import Callable, Mapping, Optional, Tuple

from cassandra_ros.errors import InvalidName
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.index_field import IndexField
from cassandra_ros.messages.key_part import KeyPart
from cassandra_ros.tables.row_encoder import Indexed, Shadows

_log = logging.getLogger(__name__)

_Value = Callable[[bytes], Tuple[Optional[bytes], bool]]
"""Returns the value of a serialised message in an index (None = unset), and whether it is odd."""


class IndexColumns:
    """Makes the index columns of one topic table.

    Args:
        topic: Name of the topic, for the log.
        definition: Definition of its messages; None = it is unusable.
        digest: The key field whose index holds the md5 of a whole array; None = no such field.
    """

    def __init__(
        self, topic: str, definition: Optional[Definition], digest: Optional[KeyPart]
    ) -> None:
        self._topic = topic
        self._definition = definition
        self._digest = digest
        self._known: tuple[Mapping[str, str], dict[str, IndexField]] = ({}, {})

    def fields(self, indexes: Mapping[str, str]) -> dict[str, IndexField]:
        """Return the indexes that conditions can use, by field.

        Args:
            indexes: Indexed field → shadow column, as the table's comment says.
        """
        known, fields = self._known
        if self._definition is not None and known != indexes:
            fields = {}
            for field, shadow in indexes.items():
                if self._digest is not None and self._digest.field == field:
                    continue  # an index of whole arrays, not of their elements
                try:
                    fields[field] = IndexField(self._definition, field, shadow)
                except InvalidName as exc:
                    _log.warning("an index of topic %s is not used: %s", self._topic, exc)
            self._known = indexes, fields
        return fields

    def shadows(self, indexes: Mapping[str, str]) -> Optional[Shadows]:
        """Return the columns of these indexes; None if there is no index."""
        values: dict[str, _Value] = {i.shadow: i.value for i in self.fields(indexes).values()}
        if self._digest is not None:
            values[indexes[self._digest.field]] = partial(_digest_of, self._digest)
        if not values:
            return None
        encoders = tuple(values.values())

        def together(wire: bytes) -> Indexed:
            encoded: list[Optional[bytes]] = []
            odd = False
            for value in encoders:
                one, is_odd = value(wire)
                encoded.append(one)
                odd = odd or is_odd
            return encoded, odd

        return Shadows(tuple(values), together)


def _digest_of(part: KeyPart, wire: bytes) -> tuple[Optional[bytes], bool]:
    value = part.value(wire)
    return (None, True) if value is None else (part.index(value), False)
