# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ask: a statement is typed, its rows and plot appear, and a row opens the viewer at its moment."""

from __future__ import annotations
