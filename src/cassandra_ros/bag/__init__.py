# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bags and MCAP files: read, import, export and verify them; no rospy here.

The reader and the writer of bag format 2.0 are our own: chunk by chunk in bounded memory, without
generated classes (a definition in a bag is text from outside), every connection byte for byte. MCAP
files go the same way, their records by the mcap library.
"""
