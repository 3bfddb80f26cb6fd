# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Node recorder: its name, parameters, signals and services; class Recorder does the work."""

from __future__ import annotations

import logging
import signal
import time
from concurrent.futures import Future
from types import FrameType
from typing import Callable, Mapping, Sequence

import rospy

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.nodes.diagnostics import Diagnostics, KeyspaceAddress
from cassandra_ros.nodes.recorder import POLL_SEC, Recorder, Say
from cassandra_ros.nodes.recorder_services import services_of
from cassandra_ros.nodes.ros_node import follow_clock, offer_services, start_named_node
from cassandra_ros.recording.recorder_options import RecorderOptions
from cassandra_ros.recording.recording_status import Rates, RecordingStatus
from cassandra_ros.recording.topic_counts import TopicReport

_log = logging.getLogger(__name__)

TICK_SEC = 1.0
"""Interval at which the status is published and shown, s."""
Show = Callable[[RecordingStatus, Rates], None]
"""Function that shows the status."""


def start_node(argv: Sequence[str]) -> Mapping[str, object]:
    """Start the node /recorder, or an anonymous one if the name is taken; return its parameters."""
    given = start_named_node("recorder", argv)
    follow_clock()
    return given


def record(
    store: Future[RosCassandra],
    options: RecorderOptions,
    place: KeyspaceAddress,
    say: Say,
    show: Show | None = None,
) -> tuple[list[TopicReport], str]:
    """Record until a signal, the master, the options or a problem ends it; then end the node.

    Args:
        store: A future of a RosCassandra connected to a keyspace.
        place: Address of the store, for /diagnostics.
        say: Prints a line for the user.
        show: Shows the status; called every TICK_SEC.

    Returns:
        A report on each topic, and the reason why no message could be stored ('' = none).
    """
    recorder = Recorder(store, options, say=say)

    def signalled(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        recorder.interrupt()
        if not began:  # a started recording stores its messages with more patience
            store.result().cassandra.outage.hurry()

    # A connected store is waited for here, until the run has started in it: a signal ends that.
    # Messages for one that is not connected wait in memory.
    began = not store.done()
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        # nohup ignores that the terminal is closed; with & a shell ignores SIGINT, which counts.
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signalled)
    try:
        offer_services(services_of(recorder), say, none=options.no_services)
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
    recorder: Recorder, diagnostics: Diagnostics | None, show: Show | None
) -> Callable[[], None]:
    """Return a function that publishes and shows the status at most every TICK_SEC."""
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
