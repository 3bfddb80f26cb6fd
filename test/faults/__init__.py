# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The fault table: something fails while numbered messages are stored; each is accounted for."""
