# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is shown over time: timelines, series, envelopes, latest and latched messages.

A plot goes through three modules: ``plot_series`` says which numbers a statement gives over time,
``envelopes`` finds their minimum and maximum for each pixel bucket by bucket, and
``bucket_envelope`` reads one bucket, from zones where the format has them.
"""
