# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Components that a table gets when it is made: they turn messages into columns."""

from __future__ import annotations

from typing import Callable, Mapping, NamedTuple, Optional, Protocol, Sequence, Tuple

from cassandra_ros.store.connection.protocol import Offsets

Encoded = Tuple[Sequence[Optional[bytes]], bool, Optional[bytes]]
"""Encoded values of the format's columns (None = unset), whether the row must be marked odd, and
the message if the columns cannot give it back."""
Indexed = Tuple[Sequence[Optional[bytes]], bool]
"""Encoded values of the shadow columns (None = unset), and whether the row must be marked odd."""
Zones = Tuple[Sequence[Optional[bytes]], Tuple[str, ...], bool]
"""Encoded values of the zone columns (None = unset), names of the fields with a NaN value (sorted),
and whether the block must be marked odd."""


class RowEncoder(Protocol):
    """Turns serialised messages into the columns of rows, and back."""

    @property
    def columns(self) -> Sequence[str]:
        """Names of the format's columns, in the format's order."""

    @property
    def zone_columns(self) -> Sequence[str]:
        """Names of the columns with minimum and maximum values in a block."""

    def encode_wire(self, wire: bytes) -> Encoded:
        """Return the columns of a message."""

    def encode_together(self, wires: Sequence[bytes]) -> Sequence[bytes | None]:
        """Return the columns of each message, each column after its size.

        None for a message = encode_wire must encode it. There is one result for each message.
        """

    def decode_together(
        self, data: bytes, starts: Offsets, ends: Offsets, sizes: Offsets
    ) -> Sequence[bytes | None]:
        """Return the messages, of these sizes, whose columns are from starts to ends in data.

        Each column follows its size. None for a message = the row must be decoded by itself.
        """

    def zones(self, wires: Sequence[bytes]) -> Zones:
        """Return the zones of serialised messages; the bytes may be damaged."""


class Shadows(NamedTuple):
    """The columns of a table's indexes."""

    names: tuple[str, ...]
    values: Callable[[bytes], Indexed]
    """Returns the values of the columns for a serialised message."""


class IndexEncoder(Protocol):
    """Turns serialised messages into the columns of indexes."""

    def shadows(self, indexes: Mapping[str, str]) -> Shadows | None:
        """Return the columns of a table's indexes; None if it has no index.

        Args:
            indexes: Indexed field → shadow column, as the table's comment says.
        """
