# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How a stream is played."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Collection, Optional

from cassandra_ros.arguments import check_integer, check_ros_name
from cassandra_ros.errors import InvalidOption
from cassandra_ros.playing.pace import check_rate

BUDGET_BYTES = 64 * 1024 * 1024
MAX_HZ = 10_000.0
MAX_QUEUE = 2**31 - 1


@dataclass(frozen=True)
class PlayerOptions:
    """How a stream is played. The defaults are those of ``rosbag play``.

    Attributes:
        rate: Factor of speed, above 0.
        immediate: Do not wait between messages; but for subscribers that take them more slowly.
        paused: Begin paused.
        loop: Begin anew at the end.
        keep_alive: Stay at the end, for late subscribers of latched topics and for seeks.
        skip_empty: Jump over stretches without a message that are longer, s; None = none.
        pause_topics: Pause before each message of these topics, by their stored names or those
            under which they go out.
        queue: How many messages may wait for each subscriber of a topic; 0 = any number.
        clock_hz: Publish the time of the replay on /clock so often, Hz of wall time; 0 = never.
        delay: How long subscribers may take to connect before the first message, s.
        wait_for_subscribers: Begin when every topic has a subscriber.
        rate_control_topic: Wait while the last stamp on this topic lags behind; '' = none.
        rate_control_max_delay: By more than this, s of the replay.
        read_ahead: How many bytes are read ahead.

    Raises:
        InvalidOption: A number lies outside of its range.
        InvalidName: rate_control_topic cannot be a topic.
    """

    rate: float = 1.0
    immediate: bool = False
    paused: bool = False
    loop: bool = False
    keep_alive: bool = False
    skip_empty: Optional[float] = None
    pause_topics: Collection[str] = ()
    queue: int = 100
    clock_hz: float = 0.0
    delay: float = 0.2
    wait_for_subscribers: bool = False
    rate_control_topic: str = ""
    rate_control_max_delay: float = 1.0
    read_ahead: int = BUDGET_BYTES

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
