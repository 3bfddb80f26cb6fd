# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The experiments, in their order."""

from __future__ import annotations

from typing import Callable

from suite.context import Context
from suite.experiments import (
    bags,
    conditions,
    copies,
    growth,
    live,
    lookups,
    sql,
    start,
    writers,
    writing,
)

EXPERIMENTS: dict[str, Callable[[Context], None]] = {
    "writing": writing.run,
    "bags": bags.run,
    "copies": copies.run,
    "growth": growth.run,
    "lookups": lookups.run,
    "clauses": conditions.run_clauses,
    "conditions": conditions.run,
    "sql": sql.run,
    "live": live.run,
    "start": start.run,
    "writers": writers.run,
    "cluster": writers.run_cluster,
}
