# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The topics on which a replay publishes its messages, and its /clock."""

from __future__ import annotations

import logging
import math
import struct
import threading
import time
from collections import Counter
from typing import Callable, Hashable, NamedTuple, Sequence

import rospy
from rosgraph_msgs.msg import Clock

from cassandra_ros.arguments import check_ros_name
from cassandra_ros.errors import CassandraRosError, CorruptMessage, InvalidName, TypeMismatch
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.metadata import Kind, type_text
from cassandra_ros.nodes.publication import AnyPublication, MessageKind, advertise
from cassandra_ros.playing.play_stream import Channel, PlayedMessage

_log = logging.getLogger(__name__)

CLOCK = "/clock"
"""Topic of the time of the replay."""
STALLED_SEC = 2.0
"""Time without progress after which it is told that a subscriber is waited for, s."""
LAST_SEC = 10.0
"""Time without progress after which a subscriber gets no rest of its queue at the end, s."""

_stamp = struct.Struct("<II").pack


class PlayedTopic(NamedTuple):
    """A topic of a replay, with counts."""

    topic: str
    """Name under which it is published."""
    type: str
    latched: bool
    subscribers: int
    """Number of present subscribers."""
    published: int
    """Number of published messages."""
    missed: int
    """Number of messages that slow subscribers missed, summed over all of them."""
    left_out: int
    """Number of messages of another type than the topic, or not readable."""


class Outlets:
    """The publishers of a replay.

    Args:
        channels: Topics to advertise.
        queue: Maximum number of messages queued for each subscriber; 0 = no maximum.
        waits: Whether to wait for subscribers whose queue is full, instead of dropping the oldest
            message.
        clock: Whether /clock is published; a stored /clock is left out then.
    """

    def __init__(self, channels: Sequence[Channel], queue: int, waits: bool, clock: bool) -> None:
        self._waits = waits
        self._stopping = threading.Event()
        """Set when no subscriber is waited for any more while messages are published."""
        self._closed = threading.Event()
        """Set when /clock is to end, after the last messages were sent."""
        self._publications: dict[str, AnyPublication] = {}
        """Publishers by ``Channel.topic``; several topics may have the same publisher."""
        self._kinds: dict[str, Kind] = {}
        """Name on the ROS graph → kind of the messages that are played there."""
        self._left_out: Counter[str] = Counter()
        """Number of messages that were not published, by topic."""
        self._warned: set[Hashable] = set()
        """Keys of the warnings that were logged."""
        self._routes: dict[Hashable, tuple[AnyPublication | None, Hashable | None]] = {}
        """What ``_route`` returned for the messages of a connection."""
        self._clock: AnyPublication | None = None
        self._clock_lock = threading.Lock()
        """Held while the time is published, by the playing thread and that of ``run_clock``."""
        if clock:
            kind = MessageKind.of(Clock._type, Clock._md5sum, Clock._full_text)
            self._clock = advertise(CLOCK, kind, latched=False, queue_size=1)
        latched = {rospy.resolve_name(channel.topic) for channel in channels if channel.latched}
        for channel in channels:
            name = rospy.resolve_name(channel.topic)
            self._advertise(channel, name, name in latched, queue)

    def _advertise(self, channel: Channel, name: str, latched: bool, queue: int) -> None:
        """Advertise a channel, or log why its messages are left out.

        Args:
            name: Its name on the ROS graph, resolved by rospy.
        """
        topic = channel.topic
        if self._clock is not None and name == self._clock.topic:
            self._warn_once(topic, "%s is not played as stored: --clock publishes it", topic)
            return
        kind = MessageKind.of(channel.type, channel.kind.md5sum, channel.definition)
        # Two stored topics may be remapped to one.
        publication = next((p for p in self._publications.values() if p.topic == name), None)
        if publication is not None:
            published = self._kinds[name]
            if published.fits(channel.kind):
                self._publications[topic] = publication
                if published.arrays is None:  # from now on only messages of this layout fit
                    self._kinds[name] = channel.kind
                return
            self._warn_once(
                (topic, channel.type, channel.kind),
                "topic %s was stored with several types; only %s is played, %s is left out",
                name,
                type_text(publication.kind._type, published, channel.kind),
                type_text(channel.type, channel.kind, published),
            )
            return
        try:
            self._publications[topic] = advertise(check_ros_name(topic), kind, latched, queue)
            self._kinds[name] = channel.kind
        except InvalidName as exc:
            hint = f"it can be played under another name: '{topic}:=/NAME'"
            self._warn_once(topic, "topic %s is not played: %s; %s", topic, exc, hint)
            return
        except TypeMismatch as exc:
            self._warn_once(topic, "topic %s is not played: %s", topic, exc)
            return
        if not channel.definition:
            _log.warning("topic %s is played without its definition: none is stored", topic)

    def _warn_once(self, key: Hashable, text: str, *values: object) -> None:
        """Warn once for each key."""
        if key not in self._warned:
            self._warned.add(key)
            _log.warning(text, *values)

    def begin(self, t: int) -> None:
        """Forget the latched messages: playing begins at ``t``, or jumps there."""
        for publication in self._publications.values():
            publication.forget_latched()

    def publish(self, played: PlayedMessage) -> None:
        """Publish a message on its topic."""
        row = played.row
        key = (played.topic, row.table.name, row.conn, row.node)
        route = self._routes.get(key)
        if route is None:
            route = self._routes[key] = self._route(played, key)
        publication, source = route
        if publication is None:
            self._left_out[played.topic] += 1
            return
        publication.publish_wire(row.wire, source)
        if self._waits and not publication.await_room(self._stopping.is_set, STALLED_SEC):
            self._warn_once(
                (played.topic, "waits"),
                "a subscriber of topic %s has read nothing for %.0f s: the replay waits for it, so "
                "that nothing is dropped",
                publication.topic,
                STALLED_SEC,
            )
            publication.await_room(self._stopping.is_set, math.inf)

    def _route(
        self, played: PlayedMessage, key: Hashable
    ) -> tuple[AnyPublication | None, Hashable | None]:
        """Return the publisher for the messages of a connection, and ``key`` if it was latching.

        The publisher is None if they are left out. ``key`` is the source of the latched messages.
        """
        publication, row = self._publications.get(played.topic), played.row
        if publication is None:
            return None, None
        if not self._kinds[publication.topic].fits(row.table.kind):
            return None, None
        try:
            return publication, key if row.connection.latching else None
        except CorruptMessage as exc:
            _log.warning("messages of topic %s are not latched again: %s", played.topic, exc)
            return publication, None

    def skipped(self, played: PlayedMessage, error: CassandraRosError) -> None:
        """Count a message that cannot be read; called on the reading or the playing thread."""
        self._left_out[played.topic] += 1
        self._warn_once((played.topic, "unreadable"), "a message is left out: %s", error)

    def clock(self, t: int) -> None:
        """Publish the time ``t``, ns, because the clock jumped to it."""
        if self._clock is not None:
            with self._clock_lock:
                self._clock.publish_wire(_stamp(*divmod(t, SECOND_NS)))

    def run_clock(self, now: Callable[[], int | None], hz: float) -> None:
        """Publish the time on /clock at a rate until ``close``.

        Args:
            now: Returns the time of the replay, ns; None = not known yet.
            hz: Rate, Hz.
        """
        due = time.monotonic()
        while self._clock is not None:
            with self._clock_lock:  # ``clock`` publishes, too: time must not go backwards
                t = now()
                if t is not None:
                    self._clock.publish_wire(_stamp(*divmod(t, SECOND_NS)))
            due = max(due + 1 / hz, time.monotonic())
            if self._closed.wait(due - time.monotonic()):
                return

    def without_subscriber(self) -> list[str]:
        """Return the topics without a subscriber, sorted."""
        return sorted(topic for topic, p in self._publications.items() if not p.subscribers)

    def topics(self) -> list[PlayedTopic]:
        """Return the counts of each topic, sorted by name."""
        left_out: Counter[str] = Counter()
        for topic, count in list(self._left_out.items()):
            p = self._publications.get(topic)
            left_out[topic if p is None else p.topic] += count
        topics = [
            PlayedTopic(
                p.topic,
                p.kind._type,
                p.is_latch,
                p.subscribers,
                p.published,
                p.missed,
                left_out.pop(p.topic, 0),
            )
            for p in self._distinct()
        ]
        topics += [
            PlayedTopic(topic, "", False, 0, 0, 0, count) for topic, count in left_out.items()
        ]
        return sorted(topics)

    def _distinct(self) -> list[AnyPublication]:
        """Return each publisher once."""
        return list(dict.fromkeys(self._publications.values()))

    def stop(self) -> None:
        """Stop waiting for subscribers when messages are published."""
        self._stopping.set()

    def close(self, stop: Callable[[], bool]) -> None:
        """Send the queued messages, then unregister the topics.

        Args:
            stop: Returns whether to stop waiting for subscribers.
        """
        for publication in self._distinct():
            publication.drain(stop, LAST_SEC)
        self._stopping.set()
        self._closed.set()
        clock = [] if self._clock is None else [self._clock]
        for publication in [*self._distinct(), *clock]:
            publication.unregister()
