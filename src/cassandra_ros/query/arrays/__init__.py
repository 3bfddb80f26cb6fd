# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Many messages as numpy arrays and pandas frames, out of the rows of a topic."""
