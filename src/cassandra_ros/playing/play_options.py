# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Options of a replay."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Collection

from cassandra_ros.arguments import check_integer, check_ros_name
from cassandra_ros.errors import InvalidOption
from cassandra_ros.playing.pace import check_rate

BUDGET_BYTES = 64 * 1024 * 1024
"""Default size of the messages read ahead, bytes."""
MAX_HZ = 10_000.0
"""Maximum rate of /clock messages, Hz."""
MAX_QUEUE = 2**31 - 1
"""Maximum number of messages queued for a subscriber."""


@dataclass(frozen=True)
class PlayerOptions:
    """The options of a replay. The defaults are those of ``rosbag play``.

    Attributes:
        rate: Factor of speed, above 0.
        immediate: Do not wait between messages, except for slow subscribers.
        paused: Begin paused.
        loop: Begin again after the end.
        keep_alive: Stay at the end, for late subscribers of latched topics and for seeks.
        skip_empty: Skip time ranges without a message that are longer than this, s; None = never.
        pause_topics: Topics, by stored or published name, before each of whose messages the replay
            pauses.
        queue: Maximum number of messages queued for each subscriber of a topic; 0 = no limit.
        clock_hz: Rate at which the time is published on /clock, Hz of wall time; 0 = never.
        delay: Time for subscribers to connect before the first message, s.
        wait_for_subscribers: Begin when every topic has a subscriber.
        rate_control_topic: Topic for whose stamps the replay waits; '' = none.
        rate_control_max_delay: Maximum difference between the time of the replay and the last
            stamp on that topic, s of the replay.
        read_ahead: Size of the messages that are read ahead, bytes.
        no_services: Offer no services, so that no other program controls the player.

    Raises:
        InvalidOption: A number lies outside its range.
        InvalidName: rate_control_topic is not a valid name.
    """

    rate: float = 1.0
    immediate: bool = False
    paused: bool = False
    loop: bool = False
    keep_alive: bool = False
    skip_empty: float | None = None
    pause_topics: Collection[str] = ()
    queue: int = 100
    clock_hz: float = 0.0
    delay: float = 0.2
    wait_for_subscribers: bool = False
    rate_control_topic: str = ""
    rate_control_max_delay: float = 1.0
    read_ahead: int = BUDGET_BYTES
    no_services: bool = False

    def __post_init__(self) -> None:
        check_rate(self.rate)
        check_integer("queue", self.queue, 0, MAX_QUEUE)
        check_integer("read_ahead", self.read_ahead, 1, 2**62)
        for name in ("delay", "rate_control_max_delay"):
            _check_range(name, getattr(self, name), 1e9, "seconds")
        if self.skip_empty is not None:
            _check_range("skip_empty", self.skip_empty, 1e9, "seconds")
        _check_range("clock_hz", self.clock_hz, MAX_HZ, "Hz")
        if self.rate_control_topic:
            check_ros_name(self.rate_control_topic, "rate_control_topic")


def _check_range(name: str, value: float, most: float, unit: str) -> None:
    if not (math.isfinite(value) and 0 <= value <= most):
        raise InvalidOption(f"{name}={value!r:.80} cannot be used: give 0 to {most:.0f} {unit}")
