# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""ROS types without a database: stamps, definitions, connections, classes and wire layouts.

``definition`` checks what comes from outside, ``classes`` makes message objects of it, and
``wire`` turns serialised messages into columns and back without making objects.
"""
