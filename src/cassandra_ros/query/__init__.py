# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The query language, and messages as arrays; it reads nothing itself.

- ``tree/`` parses a statement (by the grammar ``cql.lark``).
- ``plan/`` determines which part of it the store can answer or filter; that part is only ever
  weaker than the condition.
- ``rows/`` reads field values from messages, checks conditions and makes the rows of the result.
- ``arrays/``: many messages as numpy arrays, pandas frames and record batches of Arrow.

``run`` joins the first three; ``explain`` reports how a statement was answered. ``protocols`` and
``source`` are what the caller has to offer, which has the stored rows.

In: the text of a statement, a source of rows. Out: a ``Read``, then rows of the result.
This room imports messages/. lark comes in here.
"""
