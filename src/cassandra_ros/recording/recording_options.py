# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is to be recorded, and how: the options of a recorder."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, field
from typing import Callable, Mapping, Optional, Sequence, Tuple

from cassandra_ros.recording.recording import BLOCK_SEC, DEFAULT_BUFFER_BYTES
from cassandra_ros.recording.snapshot import Bound
from cassandra_ros.recording.topic_settings import Rule, Settings, TopicSettings


@dataclass(frozen=True)
class RecorderOptions:
    """What to record, and how; the options of the program ``recorder`` have the same names."""

    topics: Sequence[str] = ()
    """Names, or regular expressions."""
    all: bool = False
    """Every topic, also one that comes later."""
    regex: bool = False
    """``topics`` are regular expressions, for whole names."""
    exclude: str = ""
    """Regular expression of topics that are left out."""
    node: str = ""
    """Also every topic that this node subscribes to, '' = none."""
    format: Optional[str] = None
    """As addTopic takes it."""
    ttl: int = 0
    """Seconds until a message of a new topic expires; 0 = never."""
    where: Sequence[Tuple[str, str]] = ()
    """Pattern of topic names, and a condition: only messages that satisfy it."""
    rate_limit: Sequence[Tuple[str, float]] = ()
    """Pattern of topic names, and most messages a second of such a topic."""
    config: Sequence[Rule] = ()
    """Settings by topic, as read_settings reads them; where and rate_limit have precedence."""
    node_id: str = ""
    """The robot or entity that is recorded."""
    output_name: str = ""
    """Name of the run; '' = by output_prefix."""
    output_prefix: str = ""
    """What stands before the date in the name of the run; '' = the date alone."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """What is kept with each run."""
    split: bool = False
    """Go on in a new run when size or duration is reached, instead of ending."""
    size: int = 0
    """Serialised bytes of a run; 0 = no bound."""
    duration: float = 0.0
    """Seconds by the wall clock; 0 = until it is stopped."""
    max_splits: int = 0
    """Keep only so many runs of this recording; 0 = all."""
    repeat_latched: bool = False
    """Begin each further run with what is latched."""
    limit: int = 0
    """Messages of each topic; 0 = all."""
    block_age: float = BLOCK_SEC
    """Seconds that a message waits for others in a block of format packed."""
    buffsize: int = DEFAULT_BUFFER_BYTES
    """Most bytes that wait for the store; 0 = no bound."""
    snapshot: Optional[Bound] = None
    """Keep the newest messages in memory until somebody asks for them; None = record."""
    publish: bool = False
    """Say the name of each run on the latched topic begin_write."""
    diagnostics: bool = True
    """Tell on /diagnostics how it goes."""
    tcpnodelay: bool = False
    """Ask publishers to send at once."""
    free_space: Optional[Callable[[], Optional[int]]] = None
    """Tells how many bytes are free where the store keeps its data; None = it is not known."""
    min_space: int = 0
    """Store nothing while fewer bytes are free there."""
    places: bool = True
    """Note where the robot is while it is recorded, so that NEAR finds that quickly."""

    @property
    def settings(self) -> Settings:
        """How each topic is recorded."""
        conditions: Sequence[Rule] = [(p, {"where": text}) for p, text in self.where]
        rates: Sequence[Rule] = [(p, {"rate_limit": rate}) for p, rate in self.rate_limit]
        default = TopicSettings(format=self.format, ttl=self.ttl)
        return Settings(default, [self.config, conditions, rates])

    @property
    def discovers(self) -> bool:
        """Whether topics are chosen while they appear."""
        return self.all or self.regex

    def excludes(self, topic: str) -> bool:
        """Say whether a topic is left out whatever else is said."""
        return bool(self.exclude and re.fullmatch(self.exclude, topic))

    def chooses(self, topic: str) -> bool:
        """Say whether a topic that appeared is to be recorded."""
        named = self.regex and any(re.fullmatch(name, topic) for name in self.topics)
        return (self.all or named) and not self.excludes(topic)

    def run_name(self, number: int, name: str = "") -> str:
        """Name a run that begins now, the first has number 0; ``name`` goes before the options'."""
        date = time.strftime("%Y-%m-%d-%H-%M-%S")
        name = name or self.output_name or "_".join(filter(None, (self.output_prefix, date)))
        return f"{name}_{number}" if self.split else name
