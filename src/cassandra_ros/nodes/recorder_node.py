# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Node recorder: its name, its signals; class Recorder does the work."""

from __future__ import annotations

import logging
import signal
from types import FrameType
from typing import Optional, Sequence

import rospy

from cassandra_ros.nodes.node import REMAP, follow_clock, forward_logging, own_name
from cassandra_ros.nodes.recorder import POLL_SEC, Recorder, Say
from cassandra_ros.recording.counts import TopicReport
from cassandra_ros.recording.options import RecorderOptions
from cassandra_ros.topics.ros_cassandra import RosCassandra

_log = logging.getLogger(__name__)


def record(
    ros_cas: RosCassandra, options: RecorderOptions, argv: Sequence[str], say: Say
) -> list[TopicReport]:
    """Record until a signal, the master, the duration or the limit ends it; report each topic."""
    _start_node(argv)
    recorder = Recorder(ros_cas, options, say=say)

    def signalled(number: int, frame: Optional[FrameType]) -> None:
        signals.append(number)
        recorder.interrupt()

    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signalled)
    try:
        recorder.start()
        while not (signals or rospy.is_shutdown() or recorder.wait(POLL_SEC)):
            pass
        return recorder.close()
    except BaseException:
        recorder.interrupt()
        recorder.close()
        raise
    finally:
        rospy.signal_shutdown("the recording has ended")


def _start_node(argv: Sequence[str]) -> str:
    """Become /recorder where that name is free, else a node of an anonymous name."""
    name, full_name, taken = own_name("recorder", argv)
    # A name that is given forbids an anonymous one.
    words = [word for word in argv if not (taken and word.startswith(REMAP))]
    rospy.init_node(name, argv=words, anonymous=taken, disable_signals=True, disable_rostime=True)
    forward_logging()
    follow_clock()
    if taken:
        _log.warning("a node %s runs already; this one is %s", full_name, rospy.get_name())
    return str(rospy.get_name())
