# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Format ``packed``: a row of the table is a block of consecutive messages of one connection.

For the rooms above the store each message is a row as in format ``binary``. ``store/blocks/`` packs
the messages of a block. The row also holds minimum and maximum of each field, so that queries can
skip blocks.
"""

from __future__ import annotations

from cassandra_ros.messages.definition import Definition
from cassandra_ros.messages.formats.binary import CassandraTopic_binary
from cassandra_ros.messages.wire.zones import ZoneMap, zone_map

BLOCK_COLUMNS = {
    "_last": "bigint",  # key time of the last message, ns
    "_n": "int",  # number of messages
    "_data": "blob",
    "_gone": "set<int>",  # positions of deleted messages
    "_nan": "frozen<set<text>>",  # fields with a NaN value
}


class CassandraTopic_packed(CassandraTopic_binary):
    """Serialised messages, many in one row: for high rates and long retention.

    The tables are small and fast to write and to read. Other programs see blobs and zone maps.
    """

    NAME = "packed"
    PACKED = True

    def __init__(self, msg_type: str, md5sum: str, definition: Definition | None) -> None:
        super().__init__(msg_type, md5sum, definition)
        self.zone_map: ZoneMap = zone_map(self._usable())
        self.zones = self.zone_map.measure

    def table_columns(self) -> dict[str, str]:
        """Return the columns of a block."""
        return {**BLOCK_COLUMNS, **self.zone_map.columns}
