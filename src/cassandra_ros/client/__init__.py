# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a program holds: RosCassandra (paper, section 3) and the ways to ask it.

``ros_cassandra`` has the class, ``statements`` runs its statements, and ``explanation`` tells how
one was answered. Folders:

- ``sql/``: SQL over all topics by DuckDB. ``sql_statement`` has sqlglot parse a statement, and
  checks it. ``pushed_conditions`` says what need not be read. ``table_sources``
  streams it to DuckDB, which checks every row again. ``sql_result`` is the answer.
  ``statement_processes`` runs the statements of clients of viewer and query server in processes of
  their own. ``sql_series`` makes the points of plots, ``lake`` writes topics as Parquet.
- ``spark/``: topics as DataFrames of Spark. The driver plans which buckets each partition reads
  (``part_plan``), the executors read them (``part_reader``). Nothing else imports this folder.

In: names, keys, statements. Out: topics, rows, tables.
This room imports topics/ and what topics/ imports. pyspark comes in here.
"""
