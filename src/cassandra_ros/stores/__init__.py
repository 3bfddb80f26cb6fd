# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Several stores: copies of topics in other stores, and many stores that are asked as one.

- ``copying/``: Replicator. ``table_pair`` is a table and its counterpart, ``bucket_copy`` copies as
  it is stored and ``converted_copy`` decoded, ``copy_status`` tells what the books say, and
  ``store_comparison`` compares two stores. ``quota`` finds what may be deleted since another store
  has it.
- ``fleet/``: Fleet. ``fleet_answer`` asks the stores and names those that do not answer,
  ``fleet_row`` merges their rows, each message once, ``fleet_books`` leaves out what another store
  has.

In: a RosCassandra for each store. Out: reports, merged rows.
This room imports client/ and what client/ imports.
"""
