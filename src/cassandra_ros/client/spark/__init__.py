# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Topics as DataFrames of Spark: the driver plans, the executors read the store themselves."""

from __future__ import annotations

from cassandra_ros.client.spark.topic_frame import topic

__all__ = ["topic"]
