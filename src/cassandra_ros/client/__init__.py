# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a program holds: RosCassandra (paper, section 3) and the ways to ask it.

``ros_cassandra`` has the class, ``statements`` runs its statements. Folders:

- ``sql/``: SQL over all topics by DuckDB. ``sql_statement`` checks a statement, ``needed_columns``
  and ``pushed_conditions`` say what is read, ``table_sources`` streams it, ``sql_result`` answers.
  ``statement_processes`` runs the statements of strangers in processes. ``lake`` writes Parquet.
- ``spark/``: topics as DataFrames of Spark: the driver plans, the executors read.

In: names, keys, statements. Out: topics, rows, tables.
This room imports topics/ and what lies below. pyspark comes in here.
"""
