# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Node recorder: its name, parameters, signals and services; class Recorder does the work."""

from __future__ import annotations

import logging
import signal
import time
from concurrent.futures import Future
from types import FrameType
from typing import Callable, Mapping, Optional, Sequence

import rospy

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.nodes.diagnostics import Diagnostics, StorePlace
from cassandra_ros.nodes.node import (
    REMAP,
    bound_master_calls,
    follow_clock,
    forward_logging,
    own_name,
)
from cassandra_ros.nodes.recorder import POLL_SEC, Recorder, Say
from cassandra_ros.nodes.recorder_services import serve
from cassandra_ros.recording.recording_options import RecorderOptions
from cassandra_ros.recording.recording_status import Rates, RecordingStatus
from cassandra_ros.recording.topic_counts import TopicReport

_log = logging.getLogger(__name__)

TICK_SEC = 1.0
Show = Callable[[RecordingStatus, Rates], None]


def start_node(argv: Sequence[str]) -> Mapping[str, object]:
    """Become /recorder where that name is free, else an anonymous one; return its parameters."""
    name, full_name, taken = own_name("recorder", argv)
    # A name that is given forbids an anonymous one.
    words = [word for word in argv if not (taken and word.startswith(REMAP))]
    rospy.init_node(name, argv=words, anonymous=taken, disable_signals=True, disable_rostime=True)
    forward_logging()
    bound_master_calls()
    follow_clock()
    if taken:
        _log.warning("a node %s runs already; this one is %s", full_name, rospy.get_name())
    given = rospy.get_param("~", {})
    return given if isinstance(given, dict) else {}


def record(
    store: Future[RosCassandra],
    options: RecorderOptions,
    place: StorePlace,
    say: Say,
    show: Optional[Show] = None,
) -> tuple[list[TopicReport], str]:
    """Record until a signal, the master, the options or a problem end it.

    Args:
        store: A future of a RosCassandra connected to a keyspace.
        place: Where the store is, for /diagnostics.
        say: Called with each line for people who watch.
        show: Called each second with how it goes.

    Returns:
        A report on each topic, and why nothing could be stored ('' = it could).
    """
    recorder = Recorder(store, options, say=say)

    def signalled(number: int, frame: Optional[FrameType]) -> None:
        signals.append(number)
        recorder.interrupt()
        if not began:  # what has come is stored with more patience
            store.result().cassandra.outage.hurry()

    # The start waits for a store that is there; for one that is not the recording waits.
    began = not store.done()
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signalled)
    try:
        serve(recorder)
        say(f"services under {rospy.get_name()}")
        recorder.start()
        began = True
        tick = _ticker(recorder, Diagnostics(place) if options.diagnostics else None, show)
        while not (signals or rospy.is_shutdown() or recorder.wait(POLL_SEC)):
            tick()
        return recorder.close(), recorder.problem
    except BaseException:
        recorder.interrupt()
        recorder.close()
        raise
    finally:
        rospy.signal_shutdown("the recording has ended")


def _ticker(
    recorder: Recorder, diagnostics: Optional[Diagnostics], show: Optional[Show]
) -> Callable[[], None]:
    """Return what tells once a second how it goes, however often it is called."""
    rates, due = Rates(), time.monotonic()

    def tick() -> None:
        nonlocal due
        if time.monotonic() < due or (diagnostics is None and show is None):
            return
        due = time.monotonic() + TICK_SEC
        status = recorder.status()
        rates.update(status)
        if diagnostics is not None:
            diagnostics.publish(status, rates)
        if show is not None:
            show(status, rates)

    return tick
