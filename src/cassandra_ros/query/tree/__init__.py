# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements as trees: grammar, parser, names of fields, literals, expressions."""
