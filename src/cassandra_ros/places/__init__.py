# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where a robot was when: its poses, and the coarse cells by which they are found."""
