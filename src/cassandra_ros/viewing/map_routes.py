# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Occupancy grids made of stored scans and clouds."""

from __future__ import annotations

from cassandra_ros.viewing.route import Route

ROUTES: tuple[Route, ...] = ()
