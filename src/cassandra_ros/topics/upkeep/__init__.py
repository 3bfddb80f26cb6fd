# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Work on stored topics: retention, deletion, checks, conversion, the index of places."""
