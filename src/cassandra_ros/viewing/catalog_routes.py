# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What there is: the keyspace, its topics, runs and marks."""

from __future__ import annotations

from cassandra_ros.viewing.route import Route

ROUTES: tuple[Route, ...] = ()
