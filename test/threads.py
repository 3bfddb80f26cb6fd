# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Functions that run at the same time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor


def together(*works):
    """Run functions on threads at the same time, to their ends; raise their errors."""
    with ThreadPoolExecutor(len(works)) as pool:
        runs = [pool.submit(work) for work in works]
    for run in runs:
        run.result()
