# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The options of a recorder."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Callable, Mapping, Sequence

from cassandra_ros.files.spool.spool_folder import DEFAULT_BYTES, SpoolFolder
from cassandra_ros.recording.backlog import SpoolPlan
from cassandra_ros.recording.event_marks import WatchedEvent
from cassandra_ros.recording.option_values import (
    BLOCK_SEC,
    DEFAULT_BUFFER_BYTES,
    SnapshotBound,
)
from cassandra_ros.recording.topic_settings import RecordingSettings, Rule, TopicSettings


@dataclass(frozen=True)
class RecorderOptions:
    """The options of a recorder; those of the program ``recorder`` have the same names."""

    topics: Sequence[str] = ()
    """Names of the topics, or regular expressions."""
    all: bool = False
    """Whether all topics are recorded, also those that appear later."""
    regex: bool = False
    """Whether ``topics`` are regular expressions, which must match whole names."""
    exclude: str | Sequence[str] = ()
    """Regular expressions of topics that are left out; a text is one, '' = none."""
    node: str = ""
    """ROS node whose subscribed topics are recorded, too; '' = none."""
    format: str | None = None
    """Format of new topics, as addTopic takes it."""
    ttl: int = 0
    """Time until a message of a new topic expires, s; 0 = never."""
    where: Sequence[tuple[str, str]] = ()
    """Patterns of topic names, each with a condition that recorded messages must satisfy."""
    rate_limit: Sequence[tuple[str, float]] = ()
    """Patterns of topic names, each with the maximum rate of such a topic, Hz."""
    config: Sequence[Rule] = ()
    """Settings by topic, as read_settings reads them; where and rate_limit have precedence."""
    node_id: str = ""
    """nodeID of the recorded robot."""
    output_name: str = ""
    """Name of the run; '' = made with output_prefix."""
    output_prefix: str = ""
    """Text before the date in the name of the run; '' = the date alone."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """Labels of each run."""
    split: bool = False
    """Whether to go on in a new run, instead of ending, when size or duration is reached."""
    size: int = 0
    """Maximum serialised size of a run, bytes; 0 = no maximum."""
    duration: float = 0.0
    """Maximum length of a run by the wall clock, s; 0 = until the recorder is stopped."""
    max_splits: int = 0
    """Maximum number of runs of this recording that are kept; 0 = all."""
    repeat_latched: bool = False
    """Whether each further run begins with the latched messages."""
    limit: int = 0
    """Maximum number of messages of each topic; 0 = all."""
    block_age: float = BLOCK_SEC
    """Maximum time that a message waits for others in a block of format packed, s."""
    buffsize: int = DEFAULT_BUFFER_BYTES
    """Maximum memory of the messages that wait for the store, bytes; 0 = no maximum."""
    snapshot: SnapshotBound | None = None
    """How many messages are kept in memory until a snapshot is requested; None = record all."""
    publish: bool = False
    """Whether the name of each run is published on the latched topic begin_write."""
    diagnostics: bool = True
    """Whether the status is published on /diagnostics."""
    no_services: bool = False
    """Whether the node offers no services, so that no other program controls it."""
    tcpnodelay: bool = False
    """Whether publishers are asked to send without delay (TCP_NODELAY)."""
    free_space: Callable[[], int | None] | None = None
    """Returns the free space where the store keeps its data, bytes; None = it is not known."""
    min_space: int = 0
    """Minimum free space there, bytes; below it no message is stored."""
    max_size: int = 0
    """Maximum size of all topics of the store, serialised bytes; 0 = no maximum. What another store
    has is deleted first, oldest first."""
    drop_uncopied: bool = False
    """Whether what no other store has is deleted, too, as a loss, to keep the maximum size."""
    places: bool = True
    """Whether the places of the robot are stored while it is recorded, to speed up NEAR."""

    spool: bool = True
    """Whether messages wait on disk while the store does not keep up."""
    spool_dir: str = ""
    """Folder of the spool; '' = spool in $ROS_HOME/cassandra_ros, ROS_HOME by default ~/.ros."""
    spool_size: int = DEFAULT_BYTES
    """Maximum size of the files in that folder, bytes."""
    spool_drop: str = "oldest"
    """Which messages a full spool drops: 'oldest' or 'newest'."""
    journal: bool = False
    """Whether every message goes to the spool before it is stored."""
    keyspace: str = ""
    """Keyspace of the store, for files of the spool; '' = that of the connected store."""
    address: str = ""
    """Hosts and port of the store, as 'HOST[,HOST]:PORT', for files of the spool."""
    events: Sequence[WatchedEvent] = ()
    """Events that last while a condition holds, as read_events reads them."""

    @property
    def spool_plan(self) -> SpoolPlan | None:
        """How recordings use the spool; None = not."""
        if not self.spool:
            return None
        folder = SpoolFolder(Path(self.spool_dir) if self.spool_dir else None, self.spool_size)
        newest = self.spool_drop == "newest"
        return SpoolPlan(folder, self.keyspace, self.address, self.journal, newest)

    @property
    def settings(self) -> RecordingSettings:
        """Settings of all topics, from these options."""
        conditions: Sequence[Rule] = [(p, {"where": text}) for p, text in self.where]
        rates: Sequence[Rule] = [(p, {"rate_limit": rate}) for p, rate in self.rate_limit]
        default = TopicSettings(format=self.format, ttl=self.ttl)
        return RecordingSettings(default, [self.config, conditions, rates], self.events)

    @property
    def discovers(self) -> bool:
        """Whether topics are selected when they appear."""
        return self.all or self.regex

    def excludes(self, topic: str) -> bool:
        """Return whether the option exclude leaves a topic out."""
        expressions = [self.exclude] if isinstance(self.exclude, str) else self.exclude
        return any(text and re.fullmatch(text, topic) for text in expressions)

    def chooses(self, topic: str) -> bool:
        """Return whether a topic that appeared is to be recorded."""
        named = self.regex and any(re.fullmatch(name, topic) for name in self.topics)
        return (self.all or named) and not self.excludes(topic)

    def run_name(self, number: int, name: str = "") -> str:
        """Return the name of a run that starts now.

        Args:
            number: Number of the run in the recording, from 0.
            name: Name to use instead of that in the options; '' = that of the options.
        """
        date = time.strftime("%Y-%m-%d-%H-%M-%S")
        name = name or self.output_name or "_".join(filter(None, (self.output_prefix, date)))
        return f"{name}_{number}" if self.split else name
