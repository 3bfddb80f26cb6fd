# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Conversion of serialised messages to columns of format ``ros`` and back, without objects.

Converters are compiled once per definition. Other rooms use ``wire_plan``, which joins the parts;
only ``cql_values``, ``layout`` and the field sizes are also used directly.
"""
