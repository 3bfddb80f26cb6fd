# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rows in Cassandra, without ROS: how they get there, how they are found and read.

- ``connection/``: the cluster. ``login`` decides where and as whom, ``sessions`` makes sessions
  anew, ``requests`` sends and repeats, ``driver_errors`` translates what the driver raises, and
  ``outage`` knows since when the store has not answered.
- ``tables/``: the tables of a keyspace. ``schema`` lists and makes them, ``directory`` lists the
  buckets of each table, with counts and times; the side tables hold runs, losses, events, books.
- ``blocks/``: blocks of messages, the rows of format ``packed``: packed, found, read.
- ``rows/``: ``writer`` and ``reader``, counts, and rows that are found by their keys.

A row holds one message or a block: ``tables/table_layout`` says what is asked of either,
``blocks/block_layout`` and ``rows/layouts`` answer it, and ``rows/layouts`` chooses.

In: a ``Read``, or rows with a table that has its encoder (made in topics/). Out: rows, one by one
or as portions. This room imports no other; each folder imports those that are listed before it. The
driver of Cassandra comes in here.
"""
