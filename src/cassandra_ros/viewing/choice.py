# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What of the store a page looks at: topics, robots and runs, as its address names them."""

from __future__ import annotations

from cassandra_ros.arguments import check_node
from cassandra_ros.read import Whose
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.viewing.call import Call
from cassandra_ros.viewing.route import Parameter

TOPICS = Parameter("topics", "texts", "Names of topics; missing: all that can be read.")
NODES = Parameter("nodes", "texts", "nodeIDs of robots; missing: all.")
RUNS = Parameter("runs", "texts", "Names or writer ids of runs; missing: all.")
START = Parameter("start", "time", "The first moment, included.")
END = Parameter("end", "time", "The last moment, included.")


def tables_chosen(call: Call) -> list[TopicTable]:
    """Return the tables of ``topics``.

    Raises:
        TopicNotFound: One of them is not stored.
    """
    return call.catalog.tables(call.texts("topics") or None)


def whose_chosen(call: Call) -> Whose:
    """Return whose messages ``nodes`` and ``runs`` mean.

    Raises:
        RunNotFound, InvalidName: There is no such run; a nodeID is none.
    """
    nodes, names = call.texts("nodes"), call.texts("runs")
    runs = call.catalog.keyspace.runs
    writers = [runs.writers(name) or frozenset() for name in names or ()]
    return Whose(
        tuple(map(check_node, nodes)) if nodes else None,
        frozenset().union(*writers) if names else None,
    )
