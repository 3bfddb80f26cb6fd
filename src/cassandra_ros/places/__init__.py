# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where a robot was when: its poses, and the coarse cells by which they are found.

Below topics/, whose statements and ``near`` use it: it knows a topic by ``query.source.Source``, as
transforms/ does, and finds one by a function that raises TopicNotFound.
"""
