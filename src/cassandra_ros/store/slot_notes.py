# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Notes in the directory that a node has buckets in a slot, kept as long as its rows live."""

from __future__ import annotations

import time

from cassandra_ros.store.buckets import slotOf
from cassandra_ros.store.directory import Directory
from cassandra_ros.store.row_table import RowTable

AGAIN_SEC = 3600.0
"""A note that expires with its rows is renewed after so long, while rows are written."""
LONGER_SEC = 7200
"""How much longer than a row written now a note must stay."""


class SlotNotes:
    """What one writer has noted; guarded by its lock.

    Args:
        directory: Takes the notes.
    """

    def __init__(self, directory: Directory) -> None:
        self._directory = directory
        self._noted: dict[tuple[str, int, str], float] = {}

    def note(self, table: RowTable, node: str, bucket: int) -> None:
        """Note the slot of a bucket, unless that was done lately; before rows are written."""
        slot = (table.name, slotOf(bucket), node)
        # What is found by name is found by this note alone.
        ttl = 0 if table.named else table.metadata.ttl
        noted, now = self._noted.get(slot), time.monotonic()
        if noted is None or (ttl and now - noted > AGAIN_SEC):
            self._directory.addNode(*slot, ttl and ttl + LONGER_SEC)
            self._noted[slot] = now
