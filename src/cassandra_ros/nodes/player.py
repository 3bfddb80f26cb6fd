# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class Player: plays stored messages in a process that is a ROS node already."""

from __future__ import annotations

import logging
import struct
import threading
import time
from dataclasses import dataclass
from typing import Mapping

import rospy

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import CassandraRosError, InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.nodes.outlets import Outlets, PlayedTopic
from cassandra_ros.nodes.registration import Registration
from cassandra_ros.nodes.subscription import subscribe
from cassandra_ros.playing.play_options import PlayerOptions
from cassandra_ros.playing.play_selection import PlaySelection
from cassandra_ros.playing.play_stream import PlayedMessage, PlayStream
from cassandra_ros.playing.play_times import PlayTime, read_when
from cassandra_ros.playing.playback import ENDED, Playback
from cassandra_ros.playing.played_fleet import PlayedFleet
from cassandra_ros.playing.played_store import PlayedKeyspace, PlayedStore
from cassandra_ros.recording.message_buffer import starts_with_header
from cassandra_ros.stores.fleet.fleet import Fleet

_log = logging.getLogger(__name__)

MAX_LOSSES = 10
"""Maximum number of losses that are logged one by one."""
SAY_SEC = 5.0
"""Interval at which the topics without a subscriber are logged, s."""
_SEQ_AND_STAMP = struct.Struct("<III")


@dataclass(frozen=True)
class PlayerState:
    """The state of a player. Times are on the replay's time line, ns."""

    state: str
    """'waiting', 'running', 'paused', 'delayed' or 'ended'."""
    time: int
    start: int
    end: int
    rate: float
    played: int
    """Time that is played before ``time``, ns: without the time between windows."""
    length: int
    """Time that is played from start to end, ns."""
    read_ahead: int
    """Size of the messages that are read and not yet played, bytes."""
    topics: list[PlayedTopic]
    missing: Mapping[str, str]
    """The stores of a fleet that did not answer so far, or not to the end → why."""


class Player:
    """A replay of stored messages on their topics, with the stored bytes.

    The process must be a ROS node already: call rospy.init_node first. The node's remappings apply.
    The caller handles signals and the end of the node; ``stop`` ends a player. In a process with
    other busy threads ``sys.setswitchinterval(0.0002)`` makes publishing more punctual.

    Args:
        rosCas: The open keyspace, or a fleet, whose stores are played as one; the caller closes it
            after the player.
        selection: Messages to be played; default: all.
        options: Options of the replay.

    Raises:
        TopicNotFound, RunNotFound, EventNotFound, MessageNotFound: The selection has no stored
            message.
        InvalidOption, InvalidName, InvalidQuery, InvalidKey: The selection is not valid.
    """

    def __init__(
        self,
        rosCas: RosCassandra | Fleet,
        selection: PlaySelection | None = None,
        options: PlayerOptions | None = None,
    ) -> None:
        self.options = options = options or PlayerOptions()
        """Options of the replay."""
        self._stream = PlayStream(_played_store(rosCas), selection or PlaySelection())
        self._outlets: Outlets | None = None
        self._registration = Registration()
        self._control: rospy.Subscriber | None = None
        """Subscriber of the option rate_control_topic; None = without this option."""
        self._control_ns = self._stream.start_ns
        """Last stamp on that topic, or the time at which playing began after it, ns."""
        self._is_controlled = True
        """Whether the messages of that topic have a stamp, as far as known."""
        self._playback = Playback(self._stream, self, options, self._lags, self._note_skip)
        self._stopping = threading.Event()
        self._abandoned = threading.Event()
        """Set by ``stop``: the last messages are not waited for."""
        self._done = threading.Event()
        """Set when the thread of the player has ended."""
        self._error: Exception | None = None
        """Error that ended the player; set before ``_done``."""

    @property
    def stream(self) -> PlayStream:
        """Stream of the messages that are played."""
        return self._stream

    def start(self) -> None:
        """Advertise the topics and begin to play on another thread.

        Raises:
            InvalidOption: The player was started before.
            CassandraRosError: The store does not answer.
        """
        if self._outlets is not None:
            raise InvalidOption("this player was started already: make another one")
        options = self.options
        self._warn_of_losses()
        channels = self._stream.channels()
        names = {channel.topic for channel in channels}.union(self._stream.topics)
        for topic in sorted(set(options.pause_topics) - names):
            _log.warning("no topic %s is played, so the replay never pauses for it", topic)
        clock = options.clock_hz > 0
        outlets = self._outlets = Outlets(channels, options.queue, options.immediate, clock)
        if options.rate_control_topic:
            topic = rospy.resolve_name(options.rate_control_topic)
            self._control = subscribe(topic, self._take_control)
        self._registration.start()
        self._playback.prepare()
        threading.Thread(target=self._run, args=(outlets,), daemon=True, name="player").start()

    def pause(self) -> bool:
        """Pause; return whether it was not paused before."""
        return self._playback.pause()

    def resume(self) -> bool:
        """End the pause; return whether it was paused."""
        return self._playback.resume()

    def step(self, count: int = 1) -> int:
        """Publish the next messages of a paused player; return the time of the last one, ns.

        Raises:
            InvalidOption: The player is not paused, or fewer messages follow.
        """
        self._playback.step(count)
        return self._playback.now()

    def seek(self, time: PlayTime) -> int:
        """Go on at another time; the last latched messages before it are published first.

        Args:
            time: As for PlaySelection: below 10**9 seconds from the start of the replay, otherwise
                a date. A time outside the replay is moved to its start or end.

        Returns:
            The time at which it goes on, ns.

        Raises:
            InvalidOption: The time cannot be read, or the player has ended.
        """
        when = read_when("time", time)
        if when is None:
            raise InvalidOption("seek needs a time; 0.0 is the start")
        return self._playback.seek(when.ns + self._stream.start_ns if when.relative else when.ns)

    def setRate(self, rate: float) -> None:
        """Change the factor of speed from now on; raises InvalidOption if it is not above 0."""
        self._playback.set_rate(rate)

    def togglePauseTopics(self) -> bool:
        """Switch pausing before messages of the pause topics on or off; return whether it is on."""
        return self._playback.toggle_pause_topics()

    def stop(self, abandon: bool = False) -> None:
        """End the replay.

        Args:
            abandon: Do not wait until published messages have reached the subscribers.
        """
        self._stopping.set()
        if abandon:
            self._abandoned.set()
        if self._outlets is not None:
            self._outlets.stop()
        self._playback.stop()

    def wait(self, timeout_sec: float | None = None) -> bool:
        """Wait until the player has ended; return whether it has.

        Raises:
            CassandraRosError: The error that ended the player.
        """
        ended = self._done.wait(timeout_sec)
        if ended and self._error is not None:
            raise self._error
        return ended

    def status(self) -> PlayerState:
        """Return the present state."""
        playback, stream = self._playback, self._stream
        now = playback.now()
        return PlayerState(
            ENDED if self._done.is_set() else playback.state,
            now,
            stream.start_ns,
            stream.end_ns,
            playback.pace.rate,
            stream.played_ns(now),
            stream.played_ns(stream.end_ns),
            playback.read_ahead_bytes,
            [] if self._outlets is None else self._outlets.topics(),
            dict(stream.missing),
        )

    def __enter__(self) -> Player:
        self.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.stop()
        self._done.wait()

    def _warn_of_losses(self) -> None:
        """Log the losses in the time range that is played."""
        losses = self._stream.losses()
        for loss in losses[:MAX_LOSSES]:
            _log.warning(
                "%s messages of topic %s from %s to %s were not recorded: %s",
                loss.count or "an unknown number of",
                loss.topic,
                iso_time(loss.first_ns),
                iso_time(loss.last_ns),
                loss.kind.value,
            )
        if len(losses) > MAX_LOSSES:
            _log.warning(
                "and %d more losses; cassandra_bag info lists them", len(losses) - MAX_LOSSES
            )

    def _run(self, outlets: Outlets) -> None:
        """Play until the end, on the thread of the player."""
        try:
            if self._stopping.wait(self.options.delay) or not self._await_subscribers(outlets):
                return
            if self.options.clock_hz > 0:
                ticks = (self._playback.clock_time, self.options.clock_hz)
                threading.Thread(target=outlets.run_clock, args=ticks, daemon=True).start()
            self._playback.run()
        except Exception as exc:  # noqa: BLE001 - raised by wait
            self._error = exc
        finally:
            self._close(outlets)

    def _close(self, outlets: Outlets) -> None:
        """Send the last messages, unregister all topics, log what was missed; set ``_done``."""
        try:
            self._registration.stop()
            if self._control is not None:
                self._control.unregister()
            outlets.close(self._abandoned.is_set)
            for topic in outlets.topics():
                if topic.missed:
                    _log.warning(
                        "subscribers of %s missed %d messages: they were slower than the replay; "
                        "--queue N queues more messages, a lower --rate gives them time",
                        topic.topic,
                        topic.missed,
                    )
                if topic.left_out:
                    _log.warning(
                        "%d messages of %s were left out: of another type, or not readable",
                        topic.left_out,
                        topic.topic,
                    )
        finally:
            self._done.set()

    def _await_subscribers(self, outlets: Outlets) -> bool:
        """Wait with the option wait_for_subscribers; return False if the player was stopped."""
        say_at = time.monotonic() + SAY_SEC
        while self.options.wait_for_subscribers and not self._stopping.is_set():
            missing = outlets.without_subscriber()
            if not missing:
                break
            if time.monotonic() >= say_at:
                say_at += SAY_SEC
                _log.info("waiting for subscribers of %s", ", ".join(missing))
            self._stopping.wait(0.05)
        return not self._stopping.is_set()

    def begin(self, t: int) -> None:
        """Begin at the time ``t``, ns; called by the playback."""
        self._control_ns = t
        if self._outlets is not None:
            self._outlets.begin(t)

    def clock(self, t: int) -> None:
        """Publish the time ``t``, ns; called by the playback."""
        if self._outlets is not None:
            self._outlets.clock(t)

    def publish(self, played: PlayedMessage) -> None:
        """Publish a message; called by the playback."""
        if self._outlets is not None:
            self._outlets.publish(played)

    def _note_skip(self, played: PlayedMessage, error: CassandraRosError) -> None:
        if self._outlets is not None:
            self._outlets.skipped(played, error)

    def _lags(self, t: int) -> bool:
        """Return whether the last stamp on the rate control topic is too old for the time ``t``."""
        if self._control is None or not self._is_controlled:
            return False
        return t - self._control_ns > self.options.rate_control_max_delay * SECOND_NS

    def _take_control(self, topic: str, header: Mapping[str, str], wire: bytes) -> None:
        """Note the stamp of a message of the rate control topic; one without stamp ends control."""
        definition = header.get("message_definition", "")
        if not starts_with_header(definition) or len(wire) < _SEQ_AND_STAMP.size:
            if self._is_controlled:
                self._is_controlled = False
                _log.warning(
                    "the rate control topic %s has no Header as its first field and is ignored",
                    topic,
                )
                self._playback.wake()
            return
        _, secs, nsecs = _SEQ_AND_STAMP.unpack_from(wire)
        self._control_ns = secs * SECOND_NS + nsecs
        self._playback.wake()


def _played_store(store: RosCassandra | Fleet) -> PlayedStore:
    return PlayedFleet(store) if isinstance(store, Fleet) else PlayedKeyspace(store.catalog)
