# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bags and MCAP files: read, import, export and verify them; no rospy here.

We read and write bag format 2.0 ourselves: chunk by chunk in bounded memory, without generated
classes (a definition in a bag is text from outside), and with all connections byte for byte. MCAP
files are read and written in the same way; the mcap library parses and writes their records.
"""
