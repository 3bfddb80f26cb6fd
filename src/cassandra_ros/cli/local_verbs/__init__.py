# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The verbs of `local_cassandra`, one a file; `local_cassandra.VERBS` lists them."""
