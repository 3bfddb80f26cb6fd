# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Serialised messages to columns of format ``ros`` and back, without message objects.

All is compiled once per definition. ``layout`` says which fields lie where on the wire and which
column holds each; ``skip`` finds where a message or field ends; ``walk`` cuts wire bytes into
columns and ``build`` puts columns together again; ``values`` is how CQL encodes values and lists,
and how they are read by people and queries. ``plan`` joins these into a ``WirePlan``, which
``formats/ros.py``, ``key_part``, ``index_field`` and the query language use; only ``values``,
``layout`` and ``skip`` are also used by themselves.
"""
