# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Serialised messages to columns of format ``ros`` and back, without message objects.

All is compiled once per definition. ``plan`` joins the parts, and is what other rooms use: only
``values``, ``layout`` and ``skip`` are also used by themselves.
"""
