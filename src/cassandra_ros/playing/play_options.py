# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Options of a replay."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Collection

from cassandra_ros import quantities
from cassandra_ros.arguments import check_integer, check_ros_name
from cassandra_ros.errors import InvalidOption
from cassandra_ros.option import OptionGroup, option
from cassandra_ros.playing.pace import check_rate

BUDGET_BYTES = 64 * 1024 * 1024
"""Default size of the messages read ahead, bytes."""
MAX_HZ = 10_000.0
"""Maximum rate of /clock messages, Hz."""
MAX_QUEUE = 2**31 - 1
"""Maximum number of messages queued for a subscriber."""


_PACE = OptionGroup("how")


@dataclass(frozen=True)
class PlayerOptions:
    """The options of a replay. The defaults are those of ``rosbag play``.

    Sizes are bytes, times are seconds. Fields without a text are described by their help text.

    Raises:
        InvalidOption: A number lies outside its range.
        InvalidName: rate_control_topic is not a valid name.
    """

    rate: float = option(
        1.0,
        "-r",
        "--rate",
        help="multiply the publish rate by FACTOR (default: 1)",
        metavar="FACTOR",
        read=quantities.factor,
        group=_PACE,
    )
    immediate: bool = option(
        False,
        "-i",
        "--immediate",
        help="play back all messages without waiting, except for slow subscribers",
        group=_PACE,
    )
    paused: bool = option(False, "--pause", help="start in paused mode", group=_PACE)
    pause_topics: Collection[str] = option(
        [],
        "--pause-topics",
        help="pause before each message of these topics, by stored or published name; may be "
        "repeated (default: do not pause)",
        metavar="TOPIC",
        group=_PACE,
        rare=True,
        many=True,
    )
    skip_empty: float | None = option(
        None,
        "--skip-empty",
        help="skip pauses without messages that are longer than SEC seconds (default: skip "
        "nothing)",
        metavar="SEC",
        read=quantities.seconds,
        group=_PACE,
    )
    loop: bool = option(False, "-l", "--loop", help="loop playback", group=_PACE)
    keep_alive: bool = option(
        False,
        "-k",
        "--keep-alive",
        help="keep running at the end, for late subscribers of latched topics and for ~seek",
        group=_PACE,
        rare=True,
    )
    delay: float = option(
        0.2,
        "-d",
        "--delay",
        help="wait SEC seconds after advertising, to allow subscribers to connect (default: 0.2)",
        metavar="SEC",
        read=quantities.seconds,
        group=_PACE,
        rare=True,
    )
    wait_for_subscribers: bool = option(
        False,
        "--wait-for-subscribers",
        help="wait for at least one subscriber on each topic before publishing",
        group=_PACE,
        rare=True,
    )
    rate_control_topic: str = option(
        "",
        "--rate-control-topic",
        help="wait while the last stamp on this topic is too old (default: do not wait)",
        metavar="TOPIC",
        group=_PACE,
        rare=True,
    )
    rate_control_max_delay: float = option(
        1.0,
        "--rate-control-max-delay",
        help="maximum age of that stamp, seconds of the replay (default: 1)",
        metavar="SEC",
        read=quantities.seconds,
        group=_PACE,
        rare=True,
    )
    read_ahead: int = option(
        BUDGET_BYTES,
        "--read-ahead",
        help="maximum size of the messages read in advance, MB (default: 64)",
        metavar="MB",
        read=quantities.megabytes,
        group=_PACE,
        rare=True,
    )
    no_services: bool = option(
        False,
        "--no-services",
        help="offer no services, so that no other program of the ROS network controls the player",
        group=_PACE,
        rare=True,
    )
    queue: int = option(
        100,
        "--queue",
        help="use an outgoing queue of size SIZE for each subscriber (default: 100, 0 = infinite)",
        metavar="SIZE",
        read=quantities.whole_number,
        group=_PACE,
        rare=True,
    )
    clock_hz: float = 0.0
    """Rate at which the time is published on /clock, Hz of wall time; 0 = never."""

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
