# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What records, without rospy: runs, a buffer bounded in bytes, counts by topic, losses.

``recording`` takes messages and stores them on a thread of its own; ``run_series`` splits it into
runs, ``topic_settings`` and ``filters`` decide by topic. ``backlog`` keeps what waits in memory and
on disk; ``left_runs`` and ``spool_drain`` store what an earlier run has left there. ``snapshot``
holds the last seconds. ``quota_keeper`` keeps the store below its maximum size.

In: topic, connection header and bytes of each message. Out: stored messages, ``TopicReport``.
Each message that came is stored, on disk, or counted as lost with a reason.
This room imports files/spool/, stores/copying/, topics/ and what topics/ imports.
"""
