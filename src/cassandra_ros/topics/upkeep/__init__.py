# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Work on stored topics: retention, deletion, checks, conversion, the index of places.

``upkeep`` has class Upkeep, which programs and verbs call. ``retention_rules`` finds what a rule
deletes: by age and size from the directory, and around messages that are to be kept. ``deletion``
deletes by time, robot, run and condition. Both delete through topics/removal.py, which marks the
directory first, then deletes rows and their chunks. ``store_check`` reads everything back, compares
it with checksums, zones and the directory, and repairs. ``conversion`` copies a topic into a table
of another format (``table_copy``); one change of that table's comment puts it in the place of the
old ones, while readers go on (topics/row_reader.py). ``run_changes`` gives runs another name or
labels, and another robot by such a copy.
"""
