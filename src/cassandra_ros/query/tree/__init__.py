# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Syntax trees of statements: grammar, parser, field names, literals, expressions."""
