# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The one question asked of a ROS master without rospy: what type a topic has."""

from __future__ import annotations

import http.client
import logging
import socket
import xmlrpc.client
from typing import Any, cast

import rosgraph

TIMEOUT_SEC = 1.0

_log = logging.getLogger(__name__)


class _Transport(xmlrpc.client.Transport):
    """HTTP that gives up after TIMEOUT_SEC."""

    def make_connection(self, host: str | tuple[str, dict[str, str]]) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = TIMEOUT_SEC
        return connection


def topic_type(topic: str) -> str | None:
    """Ask the ROS master for the type of a topic; a missing leading slash is added.

    Return 'pkg/Name', or None: no master answers within a second, or it does not know the topic.
    """
    uri = rosgraph.get_master_uri()
    name = topic if topic.startswith("/") else "/" + topic
    try:
        master = xmlrpc.client.ServerProxy(uri, transport=_Transport())
        code, status, pairs = cast(Any, master.getTopicTypes("/cassandra_ros"))
        types = {str(key): str(value) for key, value in pairs}
    except (OSError, socket.timeout, xmlrpc.client.Error, http.client.HTTPException) as exc:
        _log.info("no ROS master at %s (%s): type of %s left open", uri, exc, name)
        return None
    except (TypeError, ValueError) as exc:
        _log.warning("the ROS master at %s answers nonsense (%s)", uri, exc)
        return None
    if code != 1:
        _log.info("the ROS master at %s refuses: %s", uri, status)
        return None
    return None if types.get(name) == "*" else types.get(name)
