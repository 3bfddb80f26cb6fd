# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The plan of a recorder: the topics that it would record now."""

from __future__ import annotations

import rospy

from cassandra_ros.nodes.subscriptions import published_topics, subscribed_topics
from cassandra_ros.recording.dry_run import PlannedTopic, plan_topics
from cassandra_ros.recording.recording_options import RecorderOptions
from cassandra_ros.topics.catalog import Catalog


def make_plan(catalog: Catalog, options: RecorderOptions) -> list[PlannedTopic]:
    """Return the plan for each topic that would be recorded now; raises one of MASTER_ERRORS."""
    named = [] if options.regex else [rospy.resolve_name(name) for name in options.topics]
    if options.node:
        named += subscribed_topics(rospy.resolve_name(options.node))
    topics = {topic for topic in named if not options.excludes(topic)}
    topics.update(filter(options.chooses, published_topics()))
    _, _, pairs = rospy.get_master().getTopicTypes()
    types = dict(pairs)
    return plan_topics(catalog, options.settings, {t: types.get(t, "") for t in topics})
