# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Parameters of routes that select topics, robots, runs and a time range."""

from __future__ import annotations

from cassandra_ros.arguments import check_node
from cassandra_ros.read import Whose
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.viewing.api_call import ApiCall
from cassandra_ros.viewing.route import Parameter

TOPICS = Parameter("topics", "texts", "Names of topics; missing: all topics that can be read.")
NODES = Parameter("nodes", "texts", "nodeIDs of robots; missing: all robots.")
RUNS = Parameter("runs", "texts", "Names or writer ids of runs; missing: all runs.")
START = Parameter("start", "time", "First time, included.")
END = Parameter("end", "time", "Last time, included.")
TIME = Parameter("time", "time", "Time that is shown first.")
WHOLE_RANGE = (
    Parameter("start", "time", "First time, included; missing: that of the first message."),
    Parameter("end", "time", "Last time, included; missing: that of the last message."),
)
"""Time range of routes that take all messages without it."""


def tables_of(call: ApiCall) -> list[TopicTable]:
    """Return the tables of the parameter ``topics``.

    Raises:
        TopicNotFound: A topic is not stored.
    """
    return call.catalog.tables(call.texts("topics") or None)


def whose_of(call: ApiCall) -> Whose:
    """Return the robots and runs of the parameters ``nodes`` and ``runs``.

    Raises:
        RunNotFound: The keyspace has no such run.
        InvalidName: A nodeID is not valid.
    """
    nodes, names = call.texts("nodes"), call.texts("runs")
    runs = call.catalog.keyspace.runs
    writers = [runs.writers(name) or frozenset() for name in names or ()]
    return Whose(
        tuple(map(check_node, nodes)) if nodes else None,
        frozenset().union(*writers) if names else None,
    )
