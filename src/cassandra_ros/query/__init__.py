# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The query language, and messages as arrays; it reads nothing itself.

- ``tree/`` parses a statement (by the grammar ``cql.lark``).
- ``plan/`` determines which part of it the store can answer or filter; that part is only ever
  weaker than the condition.
- ``rows/`` reads field values from messages, checks conditions and makes the rows of the result.
- ``arrays/``: batches of messages (``batch``), and what is made of them: numpy arrays, pandas
  frames and record batches of Arrow.

``protocols`` says what the caller must offer, which has the stored rows. The caller joins the
parts: topics/query_result.py for a statement, client/explanation.py for how it was answered.

In: the text of a statement, a source of rows. Out: a ``Read``, then rows of the result.
This room imports messages/. lark comes in here.
"""
