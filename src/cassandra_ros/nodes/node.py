# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Becoming a node: its name, its log on /rosout, its time."""

from __future__ import annotations

import copy
import logging
import socket
import struct
import time
import xmlrpc.client
from http.client import HTTPException
from typing import Mapping, Sequence
from urllib.parse import urlparse
from xml.parsers.expat import ExpatError

import rospy

from cassandra_ros.errors import ClockNotSet
from cassandra_ros.messages.ros_master import MasterTransport
from cassandra_ros.nodes.subscription import subscribe
from cassandra_ros.printable import shown_lines

_OURS = "cassandra_ros"
_ROSPY = "rosout"
"""The logger behind rospy.logwarn and its like."""
_LOG = "/rosout"
_STAMP = struct.Struct("<II")
REMAP = "__name:="
_TIMEOUT_SEC = 2.0
MASTER_SEC = 5.0
"""How long an answer of the master is waited for."""
MASTER_ERRORS = (OSError, HTTPException, xmlrpc.client.Error, ExpatError)
"""What asking a master raises that is away, or dies in the middle of its answer."""


def own_name(default: str, argv: Sequence[str]) -> tuple[str, str, bool]:
    """Return a node's base name, its full name in our namespace, and whether such a node lives.

    The base name is ``default`` where the command line has no ``__name:=x``.
    """
    given = [word[len(REMAP) :] for word in argv if word.startswith(REMAP)]
    name = given[-1] if given else default
    full_name = str(rospy.get_namespace()) + name
    return name, full_name, _is_taken(full_name)


def _is_taken(full_name: str) -> bool:
    """Say whether a node of this name lives; False also where no master answers yet."""
    try:
        code, _, uri = rospy.get_master().lookupNode(full_name)
    except MASTER_ERRORS:
        return False  # init_node waits for the master
    if code != 1:
        return False
    where = urlparse(uri)
    try:
        socket.create_connection((where.hostname, where.port), _TIMEOUT_SEC).close()
    except ConnectionRefusedError:
        return False  # it died without a word
    except OSError:
        return True  # out of reach is not dead
    return True


class _Forwarder(logging.Handler):
    """Hands records to rospy's logger, with the place in the code that they come from."""

    def emit(self, record: logging.LogRecord) -> None:
        target = logging.getLogger(_ROSPY)
        if target.isEnabledFor(record.levelno):
            safe = copy.copy(record)
            # rospy prints it: names of topics and publishers come from outside.
            safe.msg, safe.args = shown_lines(record.getMessage()), None
            target.handle(safe)


def log_as_rosout() -> None:
    """Log on /rosout whatever that is remapped to; call it after an init_node without rosout.

    A node that plays a stored /rosout under another name would write its own log there.
    """
    mappings = rospy.names.get_resolved_mappings()
    renamed = mappings.pop(_LOG, None)
    rospy.impl.rosout.init_rosout()
    rospy.impl.rosout.load_rosout_handlers(None)
    if renamed is not None:
        mappings[_LOG] = renamed


def forward_logging() -> None:
    """Forward the logger ``cassandra_ros``; call it after rospy.init_node."""
    logger = logging.getLogger(_OURS)
    if any(isinstance(handler, _Forwarder) for handler in logger.handlers):
        return
    logger.addHandler(_Forwarder())
    logger.setLevel(logging.INFO)
    logger.propagate = False  # rospy's logger writes to the node's log file already
    for name in list(logging.root.manager.loggerDict):
        # init_node configures logging anew, which disables loggers that exist.
        if name.split(".")[0] == _OURS:
            logging.getLogger(name).disabled = False
    # The driver's own warnings speak of things that its caller chose.
    logging.getLogger("cassandra").setLevel(logging.ERROR)


def bound_master_calls() -> None:
    """Let rospy give up a call to its master that is not answered; call it after rospy.init_node.

    It would wait for ever: a robot that has left the network could not end a recording.
    """
    # In their place: others hold them, too, as the log's own look for a parameter.
    for proxy in rospy.core._xmlrpc_cache.values():
        proxy._ServerProxy__transport = MasterTransport(MASTER_SEC)


def follow_clock() -> None:
    """Let rospy's time be the simulated one where /use_sim_time says so.

    rospy subscribes to /clock itself with a queue of one message, which a second subscription in
    the process then shares: a recorder of /clock would lose most of it. So the node is started with
    ``disable_rostime=True``, and /clock is followed here.
    """
    if rospy.get_param("/use_sim_time", False):
        rospy.rostime._set_rostime(rospy.Time(0, 0))
        subscribe("/clock", _take)


def now_ns() -> int:
    """Tell the time; exactly, while rospy's wall clock goes through a float."""
    if rospy.rostime.is_wallclock():
        return time.time_ns()
    now = int(rospy.rostime.get_rostime().to_nsec())
    if not now:
        raise ClockNotSet("simulated time is in use and no /clock message had come")
    return now


def _take(topic: str, header: Mapping[str, str], wire: bytes) -> None:
    if len(wire) == _STAMP.size:
        rospy.rostime._set_rostime(rospy.Time(*_STAMP.unpack(wire)))
