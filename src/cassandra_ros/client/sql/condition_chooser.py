# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Choice of what the server checks for SQL: as for our language, but NaN exceeds all bounds."""

from __future__ import annotations

from typing import Any, Iterable, Sequence

import numpy as np

from cassandra_ros.messages.wire.message_stacks import planes_of, stacker
from cassandra_ros.messages.wire.zones import zone_map
from cassandra_ros.query.plan.pushdown import Pushdown, Watch, unwatched
from cassandra_ros.query.protocols import Table, UnpackedMessages
from cassandra_ros.query.tree.syntax import Expression
from cassandra_ros.read import Query, Sift

_FLOATS = ("float32", "float64")


class ConditionChooser:
    """Chooses for every bucket what the server checks; see Chooser in read.py.

    In DuckDB NaN is greater than all numbers, so it satisfies a lower bound. Cassandra orders it in
    the same way; zones leave it out, and list the fields with a NaN.

    Args:
        condition: The condition; None is always true.
        floats: Paths of the float fields with a lower bound.
        watch: Called repeatedly; an exception from it ends the read.

    Attributes:
        pushdown: Counts of buckets and blocks.
    """

    def __init__(
        self, condition: Expression | None, floats: Iterable[str], watch: Watch = unwatched
    ) -> None:
        self.pushdown = Pushdown(condition, watch=watch)
        self._floats = sorted(floats)

    @property
    def checks(self) -> bool:
        """Whether there is a condition to check."""
        return self.pushdown.checks

    def choose(self, table: Table, bucket: Sequence[Any]) -> Sequence[Query] | None:
        """Return the queries whose rows include all matching rows; None = read all rows."""
        chosen = self.pushdown.choose(table, bucket)
        if chosen is None or not table.packed or table.definition is None:
            return chosen
        named = [name for name in self._floats if name in zone_map(table.definition).fields]
        nan = [((("_nan", "CONTAINS", name.encode()),), False) for name in named]
        return [*chosen, *nan]

    def few(self, table: Table) -> bool:
        """Return whether only few rows were found so far."""
        return self.pushdown.few(table)

    def learn(self, table: Table, bucket: Sequence[Any], rows: int) -> None:
        """Record the rows found in a bucket."""
        self.pushdown.learn(table, bucket, rows)

    def sift(self, table: Table) -> Sift | None:
        """Return the filter of blocks for a table; None if it would leave no message out."""
        sift = self.pushdown.sift(table)
        if sift is None or table.definition is None:
            return sift
        paths = {
            name: column.field_type
            for name, column in zone_map(table.definition).fields.items()
            if name in self._floats and column.field_type in _FLOATS
        }
        if set(paths) != set(self._floats):
            return None  # a field without zones, or of another type in this definition
        finder = stacker(table.definition)
        # The sift may check messages of any size by their heads, also those that fit no stack.
        by_head = all(path in finder.head for path in paths)

        def sift_but_nan(block: UnpackedMessages) -> Any:
            mask = sift(block)
            if mask is None:
                return None
            groups = [(planes_of(g.stored, g.rises), g.members) for g in block.groups]
            if by_head:
                stacks = [finder.heads(groups)]
            else:
                stacks = [stack for group in groups for stack in finder.stacks(*group)[0]]
            for stack in stacks:
                for path, base in paths.items():
                    mask[stack.members] |= np.isnan(stack.numbers(path, base)).any(axis=0)
            return mask

        return sift_but_nan if paths else sift

    def opened(self, table: Table, messages: int, kept: int) -> None:
        """Record an unpacked block: its number of messages, and how many were kept."""
        self.pushdown.opened(table, messages, kept)
