# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The context of a recording at its start: ROS parameters and node graph."""

from __future__ import annotations

import logging
import threading

import rospy

from cassandra_ros.messages.ros_master import master_proxy
from cassandra_ros.nodes.ros_node import MASTER_ERRORS
from cassandra_ros.recording.recording import Recording
from cassandra_ros.store.tables.context_blob import NodeGraph, RunContext

_log = logging.getLogger(__name__)

TIMEOUT_SEC = 5.0
"""Maximum time for each of three answers of the master, s."""


def take_context() -> RunContext:
    """Return parameters and node graph of the master.

    Raises:
        MASTER_ERRORS: The master does not answer.
        ValueError: The answer of the master has another form.
    """
    name, master = rospy.get_name(), master_proxy(TIMEOUT_SEC)
    _, _, params = master.getParam(name, "/")
    _, _, (publishers, subscribers, services) = master.getSystemState(name)
    _, _, types = master.getTopicTypes(name)
    graph = NodeGraph(dict(publishers), dict(subscribers), dict(services), dict(types))
    return RunContext(params if isinstance(params, dict) else {}, graph)


def keep_context(recording: Recording) -> threading.Thread:
    """Store the present context with a run, in the background."""

    def work() -> None:
        try:
            recording.put_context(take_context())
        except (*MASTER_ERRORS, ValueError, TypeError) as exc:
            _log.warning("the parameters of run %s could not be read: %s", recording.name, exc)

    thread = threading.Thread(target=work, name="recorder-context", daemon=True)
    thread.start()
    return thread
