# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Timelines of stored messages, as counts in equal cells of time, for pictures.

``lanes`` makes a lane of each topic and robot. ``directory_reader`` takes the counts of buckets
from the directory, for long time ranges from a sample of it. Where few messages are visible,
``bucket_detail`` reads their times from keys and from the headers of blocks, within a budget.
``time_cells`` turns counts into cells, with gaps and estimated counts. ``merged_pictures`` puts the
pictures of several stores together. No message is read.
"""
