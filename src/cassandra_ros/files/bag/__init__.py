# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Bags and MCAP files: read, import, export and verify them; no rospy here.

We read and write bag format 2.0 ourselves: chunk by chunk in bounded memory, without generated
classes (a definition in a bag is text from outside), and with all connections byte for byte. MCAP
files are written by the mcap library. They are read by our own walk over their records
(``mcap_format``); the library parses those that describe the file.
"""
