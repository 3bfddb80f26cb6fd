# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Home: what was imported stands there, and a window of it is chosen with mouse and keyboard."""

from __future__ import annotations
