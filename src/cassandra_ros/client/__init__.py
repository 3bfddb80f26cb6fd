# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""RosCassandra, the class that programs use (paper section 3), and the statements that it runs."""
