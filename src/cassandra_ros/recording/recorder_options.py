# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The options of a recorder, each declared once: its parser, pages and launch file follow them."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Mapping, NamedTuple, Sequence

from cassandra_ros import quantities
from cassandra_ros.files.spool.spool_folder import DEFAULT_BYTES, SpoolFolder
from cassandra_ros.option import OptionGroup, option
from cassandra_ros.recording.option_values import (
    BLOCK_SEC,
    DEFAULT_BUFFER_BYTES,
    DEFAULT_SPACE_BYTES,
    SettingsFile,
    SnapshotBound,
    read_bound,
    read_config,
    read_label,
    read_rate_limit,
    read_ttl,
    read_where,
)
from cassandra_ros.shared_options import DROP_UNCOPIED, EXCLUDE, FORMAT, MAX_SIZE

_RUNS = OptionGroup("runs")
_TOPICS = OptionGroup(
    "storage of topics", "TOPIC is a name or a regular expression; the first match counts"
)
_LIMITS = OptionGroup("limits")
_NODE = OptionGroup("the node")
_SPOOL = OptionGroup(
    "spool",
    "while the store does not answer or does not keep up, messages wait in files; what a recorder "
    "has left there, the next one stores",
)


class SpoolPlan(NamedTuple):
    """How a recording uses the spool."""

    folder: SpoolFolder
    keyspace: str = ""
    """Keyspace of the store; '' = not known."""
    address: str = ""
    """Hosts and port of the store; '' = not known."""
    journal: bool = False
    """Whether each message is written into the spool before it is stored."""
    drops_newest: bool = False
    """Whether a full spool drops new messages, not the oldest ones."""


@dataclass(frozen=True)
class RecorderOptions:
    """The options of a recorder; those of the program ``recorder`` have the same names.

    Sizes are bytes, times are seconds. Fields without a text are described by their help text.
    """

    topics: Sequence[str] = option([], help="record these topics (default: none)", metavar="TOPIC")
    all: bool = option(
        False,
        "-a",
        "--all",
        help="record all topics, except the recorder's own messages on /rosout and /diagnostics",
    )
    regex: bool = option(
        False,
        "-e",
        "--regex",
        help="match topics using regular expressions",
    )
    exclude: str | Sequence[str] = EXCLUDE.with_default([])
    """A text is one regular expression, '' = none."""
    node: str = option(
        "",
        "--node",
        help="record all topics subscribed to by a node (default: none)",
        metavar="NODE",
        rare=True,
    )

    output_prefix: str = option(
        "",
        "-o",
        "--output-prefix",
        help="prepend PREFIX to the name of the run, which is the date (default: only the date)",
        metavar="PREFIX",
        group=_RUNS,
        rare=True,
    )
    output_name: str = option(
        "",
        "-O",
        "--output-name",
        "--name",
        help="name of the run; several runs may have one name, which then means all of them "
        "(default: the date)",
        metavar="NAME",
        group=_RUNS,
    )
    labels: Mapping[str, str] = option(
        {},
        "--label",
        help="store a label with the run; may be repeated",
        metavar="K=V",
        read=read_label,
        group=_RUNS,
    )
    split: bool = option(
        False,
        "--split",
        help="begin a new run when the size or duration is reached: NAME_0, NAME_1, ...",
        group=_RUNS,
    )
    size: int = option(
        0,
        "--size",
        help="record this many MB of messages; with --split: into each run (default: no limit)",
        metavar="SIZE",
        read=quantities.megabytes,
        group=_RUNS,
    )
    duration: float = option(
        0.0,
        "--duration",
        help="record this long by the wall clock, in seconds, or 5m, 2h; with --split: each run "
        "(default: until it is stopped)",
        metavar="DURATION",
        read=quantities.duration,
        group=_RUNS,
    )
    max_splits: int = option(
        0,
        "--max-splits",
        help="keep at most MAX_SPLITS runs of this recording; the messages of older ones are "
        "deleted (default: keep all)",
        metavar="MAX_SPLITS",
        read=quantities.whole_number,
        group=_RUNS,
        rare=True,
    )
    repeat_latched: bool = option(
        False,
        "--repeat-latched",
        help="begin each run of a split recording with the latched messages",
        group=_RUNS,
        rare=True,
    )
    publish: bool = option(
        False,
        "-p",
        "--publish",
        help="publish a latched message with the name of each run on begin_write",
        group=_RUNS,
        rare=True,
    )
    snapshot: SnapshotBound | None = option(
        None,
        "-s",
        "--snapshot",
        help="keep only the newest messages, in memory, up to this duration or size; the service "
        "~snapshot stores them as a run (default: store all)",
        metavar="30s|200MB",
        read=read_bound,
        group=_RUNS,
    )

    format: str | None = FORMAT.with_default(None, _TOPICS)
    ttl: int = option(
        0,
        "--ttl",
        help="delete messages of new topics after this time, as 3600, 90m or 7d (default: never)",
        metavar="SEC",
        read=read_ttl,
        group=_TOPICS,
    )
    where: Sequence[tuple[str, str]] = option(
        [],
        "--where",
        help="record only messages of a topic that satisfy a condition as in CQL, for example "
        "'/cmd_vel: linear.x > 0.5'; other messages count as left out; may be repeated",
        metavar="'TOPIC: CONDITION'",
        read=read_where,
        group=_TOPICS,
    )
    rate_limit: Sequence[tuple[str, float]] = option(
        [],
        "--rate-limit",
        help="record at most HZ messages a second of a topic, or of each topic; may be repeated",
        metavar="[TOPIC:]HZ",
        read=read_rate_limit,
        group=_TOPICS,
    )
    config: SettingsFile = option(
        SettingsFile(),
        "--config",
        help="YAML file with settings for patterns of topics, and with events, as "
        "config/recorder.yaml. --where and --rate-limit override it, it overrides --format "
        "(default: no file)",
        metavar="FILE",
        read=read_config,
        group=_TOPICS,
    )
    """Settings and events, as read_settings reads them."""
    block_age: float = option(
        BLOCK_SEC,
        "--block-age",
        help="format packed: maximum time that a message waits until its block is stored (default: "
        f"{BLOCK_SEC} s)",
        metavar="SEC",
        read=quantities.duration,
        group=_TOPICS,
        rare=True,
    )
    node_id: str = option(
        "",
        "--node-id",
        help="name of the robot that is recorded (default: no name)",
        metavar="N",
        group=_TOPICS,
    )

    limit: int = option(
        0,
        "-l",
        "--limit",
        help="only record NUM messages on each topic (default: all)",
        metavar="NUM",
        read=quantities.whole_number,
        group=_LIMITS,
    )
    buffsize: int = option(
        DEFAULT_BUFFER_BYTES,
        "-b",
        "--buffsize",
        help="let SIZE MB of messages wait for the store in memory; what exceeds them is counted "
        "and told as lost (default: 256, 0 = infinite)",
        metavar="SIZE",
        read=quantities.megabytes,
        group=_LIMITS,
        rare=True,
    )
    min_space: int = option(
        DEFAULT_SPACE_BYTES,
        "-L",
        "--min-space",
        help="stop storing while the disk of the local Cassandra has less free space (default: 1G; "
        "0 = off). The free space of a Cassandra on another machine is unknown: watch it there",
        metavar="1G",
        read=quantities.byte_size,
        group=_LIMITS,
        rare=True,
    )
    max_size: int = MAX_SIZE.with_default(0, _LIMITS)
    drop_uncopied: bool = DROP_UNCOPIED.with_default(False, _LIMITS)
    diagnostics: bool = option(
        True, "--no-diagnostics", help="do not publish on /diagnostics", group=_NODE, rare=True
    )
    no_services: bool = option(
        False,
        "--no-services",
        help="offer no services, so that no other program of the ROS network starts, stops or "
        "pauses the recording",
        group=_NODE,
        rare=True,
    )
    places: bool = option(
        True,
        "--no-places",
        help="do not index the places where the robot is while its poses are recorded: NEAR then "
        "reads all poses, until 'cassandra_bag index --places' makes the index",
        group=_NODE,
        rare=True,
    )
    tcpnodelay: bool = option(
        False,
        "--tcpnodelay",
        help="use the TCP_NODELAY transport hint when subscribing to topics",
        group=_NODE,
        rare=True,
    )

    spool: bool = option(
        True,
        "--no-spool",
        help="let messages wait in memory only (--buffsize)",
        group=_SPOOL,
        rare=True,
    )
    journal: bool = option(
        False,
        "--journal",
        help="write every message into the spool first: a recorder that is killed loses at most "
        "its last second, and the next one says so",
        group=_SPOOL,
    )
    spool_size: int = option(
        DEFAULT_BYTES,
        "--spool-size",
        help="maximum size of the spool (default: 2G)",
        metavar="SIZE",
        read=quantities.byte_size,
        group=_SPOOL,
        rare=True,
    )
    spool_drop: str = option(
        "oldest",
        "--spool-drop",
        help="which messages a full spool drops; they are told as lost (default: oldest, as the "
        "buffer)",
        metavar="oldest|newest",
        choices=("oldest", "newest"),
        group=_SPOOL,
        rare=True,
    )
    spool_dir: str = option(
        "",
        "--spool-dir",
        help="folder of the spool (default: $ROS_HOME/cassandra_ros/spool, or in ~/.ros)",
        metavar="DIR",
        group=_SPOOL,
        rare=True,
    )

    keyspace: str = ""
    """Keyspace of the store, for files of the spool; '' = that of the store that the Recorder gets,
    if it is connected already."""
    address: str = ""
    """Hosts and port of the store, as 'HOST[,HOST]:PORT', for files of the spool."""
    free_space: Callable[[], int | None] | None = None
    """Returns the free space where the store keeps its data; None = it is not known."""

    @property
    def spool_plan(self) -> SpoolPlan | None:
        """How recordings use the spool; None = not."""
        if not self.spool:
            return None
        folder = SpoolFolder(Path(self.spool_dir) if self.spool_dir else None, self.spool_size)
        newest = self.spool_drop == "newest"
        return SpoolPlan(folder, self.keyspace, self.address, self.journal, newest)

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
            number: Number of the run in the recording, from 0; it is in the name with the option
                split.
            name: Name to use instead of that in the options; '' = that of the options.
        """
        date = time.strftime("%Y-%m-%d-%H-%M-%S")
        name = name or self.output_name or "_".join(filter(None, (self.output_prefix, date)))
        return f"{name}_{number}" if self.split else name
