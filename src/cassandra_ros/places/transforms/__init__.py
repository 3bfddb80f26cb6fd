# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""tf transforms at a past time, from the stored messages of the transform topics."""
