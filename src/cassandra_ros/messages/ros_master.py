# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Calls to the ROS master without rospy, with a time limit."""

from __future__ import annotations

import errno
import http.client
import logging
import socket
import xmlrpc.client
from typing import Any, Iterable
from xml.parsers.expat import ExpatError

import rosgraph

from cassandra_ros.errors import ConnectionFailed, InvalidOption

TIMEOUT_SEC = 1.0
"""Time limit of a call, s."""
SILENT_SEC = 0.2
"""Time limit of a call after one without an answer, s, so that many calls do not wait long."""
PARAMETER_TIMEOUT_SEC = 10.0
"""Time limit of setting a parameter, s."""

_NO_ANSWER = (
    OSError,
    socket.timeout,
    xmlrpc.client.Error,
    http.client.HTTPException,
    ExpatError,
)
"""Errors of a call that no ROS master answers; the last ones if something else answers."""

_log = logging.getLogger(__name__)


class MasterTransport(xmlrpc.client.Transport):
    """HTTP transport to a master. A call without an answer raises OSError after the time limit.

    After such a failure the limit is SILENT_SEC, until the master answers again.
    """

    def __init__(self, timeout_sec: float) -> None:
        super().__init__()
        self._timeout_sec = timeout_sec
        self._silent = False

    def make_connection(self, host: str | tuple[str, dict[str, str]]) -> http.client.HTTPConnection:
        """Connect, see xmlrpc.client.Transport."""
        connection = super().make_connection(host)
        connection.timeout = SILENT_SEC if self._silent else self._timeout_sec
        return connection

    def request(self, *args: Any, **kwargs: Any) -> Any:
        """Make a call, see xmlrpc.client.Transport."""
        try:
            answer = super().request(*args, **kwargs)
        except socket.timeout as exc:
            self._silent = True
            # rospy unpacks number and text of an error, and takes this number as a network error.
            raise OSError(errno.ENODATA, f"no answer within {self._timeout_sec:g} s") from exc
        if self._silent:
            self._silent = False
            self.close()  # the connection still has the short time limit
        return answer


def master_proxy(timeout_sec: float = TIMEOUT_SEC) -> Any:
    """Return the master's API. A call without an answer raises OSError after timeout_sec.

    A wrong answer raises xmlrpc.client.Error, HTTPException or ExpatError.
    """
    transport = MasterTransport(timeout_sec)
    return xmlrpc.client.ServerProxy(rosgraph.get_master_uri(), transport=transport)


def master_uri() -> str:
    """Return the address of the ROS master: that of ``__master:=``, else ROS_MASTER_URI."""
    return str(rosgraph.get_master_uri())


def master_answers() -> bool:
    """Return whether a ROS master answers within TIMEOUT_SEC."""
    try:
        master_proxy().getPid("/cassandra_ros")
    except _NO_ANSWER as exc:
        _log.info("no ROS master at %s: %s", rosgraph.get_master_uri(), exc)
        return False
    return True


def topic_type(topic: str) -> str | None:
    """Ask the ROS master for the type of a topic. A missing leading slash is added.

    Return 'pkg/Name', or None if no master answers within TIMEOUT_SEC, or it does not know the
    type.
    """
    uri = rosgraph.get_master_uri()
    name = topic if topic.startswith("/") else "/" + topic
    try:
        code, status, pairs = master_proxy().getTopicTypes("/cassandra_ros")
        types = {str(key): str(value) for key, value in pairs}
    except _NO_ANSWER as exc:
        _log.info("no ROS master at %s (%s): type of %s left open", uri, exc, name)
        return None
    except (TypeError, ValueError) as exc:
        _log.warning("the ROS master at %s answers nonsense (%s)", uri, exc)
        return None
    if code != 1:
        _log.info("the ROS master at %s refuses: %s", uri, status)
        return None
    return None if types.get(name) == "*" else types.get(name)


def set_parameters(parameters: Iterable[tuple[str, object]]) -> int:
    """Set parameters, given by their full names, on the parameter server; return their number.

    Raises:
        ConnectionFailed: No ROS master answers within PARAMETER_TIMEOUT_SEC, or it refuses a
            parameter. Parameters that were set before stay set.
        InvalidOption: A value cannot be sent over XML-RPC.
    """
    uri, name, count = rosgraph.get_master_uri(), "", 0
    try:
        master = master_proxy(PARAMETER_TIMEOUT_SEC)
        for name, value in parameters:
            code, status, _ = master.setParam("/cassandra_ros", name, value)
            if code != 1:
                raise ConnectionFailed(f"the ROS master at {uri} refuses to set {name}: {status}")
            count += 1
    except _NO_ANSWER as exc:
        raise ConnectionFailed(
            f"no ROS master at {uri} takes parameters ({exc}): start roscore, or set "
            f"ROS_MASTER_URI; {count} parameters were set"
        ) from exc
    except (TypeError, ValueError, OverflowError) as exc:
        raise InvalidOption(f"parameter {name} cannot be sent over XML-RPC: {exc}") from exc
    return count
