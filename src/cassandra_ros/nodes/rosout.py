# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the library logs, told to ROS: on the console and on /rosout."""

from __future__ import annotations

import logging

_OURS = "cassandra_ros"
_ROSPY = "rosout"
"""The logger behind rospy.logwarn and its like."""


class _Forwarder(logging.Handler):
    """Hands records to rospy's logger, with the place in the code that they come from."""

    def emit(self, record: logging.LogRecord) -> None:
        """Forward one record."""
        target = logging.getLogger(_ROSPY)
        if target.isEnabledFor(record.levelno):
            target.handle(record)


def forwardLogging() -> None:
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
