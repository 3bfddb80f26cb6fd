# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Format ``packed``: a row of the table is a block of consecutive messages of a connection.

Above the store each message is a row as in format ``binary``. What a block holds is packed in
``store/blocks/``; beside it stand the least and the greatest value of each field, by which blocks
are skipped.
"""

from __future__ import annotations

from cassandra_ros.formats.binary import CassandraTopic_binary
from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.wire.zones import zone_map

BLOCK_COLUMNS = {
    "_last": "bigint",  # key time of the last message
    "_n": "int",  # messages
    "_data": "blob",
    "_gone": "set<int>",  # positions of those that were deleted
    "_nan": "frozen<set<text>>",  # fields of which a value is NaN
}


class CassandraTopic_packed(CassandraTopic_binary):
    """The serialised messages, many in a row: for high rates and long keeping.

    Small and quick to write and to read; other programs see blobs and zone maps.
    """

    NAME = "packed"
    PACKED = True

    def __init__(self, msg_type: str, md5sum: str, definition: Definition | None) -> None:
        super().__init__(msg_type, md5sum, definition)
        self.zones = zone_map(self._usable())

    def table_columns(self) -> dict[str, str]:
        """Return the columns of a block."""
        return {**BLOCK_COLUMNS, **self.zones.columns}
