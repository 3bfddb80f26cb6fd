# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The selection of messages to be played, and the names under which they are published."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import Mapping, Sequence, Union

from cassandra_ros.arguments import (
    check_list,
    check_ros_name,
    check_topics,
    compile_pattern,
    matching,
)
from cassandra_ros.errors import DefinitionError, TopicNotFound
from cassandra_ros.messages.stamps import Length
from cassandra_ros.playing.play_times import PlayTime
from cassandra_ros.playing.played_store import PlayedStore
from cassandra_ros.topics.catalog import Conditions
from cassandra_ros.topics.event_finder import EventRule
from cassandra_ros.topics.row_finder import Where

_log = logging.getLogger(__name__)

AlignStart = Union[bool, str]
"""Alignment of runs: True or 'run', 'node'; False = not aligned."""


@dataclass(frozen=True)
class PlaySelection:
    """The selection of messages to be played.

    Times are times of reception. A number below 10**9 is seconds from the first selected message
    (in rosbag from the first message of the bag); everything else is a date, see
    playing/play_times.py.

    Attributes:
        topics: Names of the topics; None = all.
        regex: Whether the names are regular expressions, which must match whole names.
        exclude: Regular expressions; topics whose whole name one of them matches are left out. A
            text is one expression, '' none.
        start, end: First and last time, both included; None = not limited.
        duration: Length from the start on, s, instead of end; None = to the end.
        nodeID: nodeID of the robot whose messages are played; None = all robots.
        run: Name or writer id of the run whose messages are played; None = all runs.
        where: Condition by topic: only messages that satisfy the condition of their topic are
            played.
        prefix: Text before the names under which topics are published.
        remap: New name by stored topic, or by stored topic with the prefix.
        around: 'TOPIC: condition', or (topic, condition): only messages near those of that topic
            that satisfy the condition are played.
        before, after: Time range around such a message, s, minimum 0.
        align_start: Play runs of different days at the same time: the first selected message of
            each is moved to the time of the earliest one. True or 'run' moves each run; 'node'
            each nodeID, and each run without one. Dates select messages by their time of
            reception; other times, and around, are on the common time line.
        node_prefix: Publish as /<node>/topic, with the nodeID, or the run's name if there is no
            nodeID.
        event: Name of events, or (name, seconds before, seconds after): only messages of a robot
            during its events are played, without the time between; not together with around.
    """

    topics: Sequence[str] | None = None
    regex: bool = False
    exclude: str | Sequence[str] = ()
    start: PlayTime = None
    end: PlayTime = None
    duration: Length | None = None
    nodeID: str | None = None
    run: None | str | int = None
    where: Conditions = None
    prefix: str = ""
    remap: Mapping[str, str] = field(default_factory=dict)
    around: None | str | tuple[str, Where] = None
    before: Length = 5.0
    after: Length = 10.0
    align_start: AlignStart = False
    node_prefix: bool = False
    event: EventRule = None


def chosen_topics(store: PlayedStore, selection: PlaySelection) -> list[str]:
    """Return the names of the topics that are played, sorted.

    Raises:
        TopicNotFound: A topic is not stored, or no topic is left.
        InvalidOption: A regular expression cannot be read.
    """
    given, names = check_topics(selection.topics), set()
    if selection.regex and given is not None:
        names = matching("topic", given, set(store.names()), store.called)
    elif given is not None:
        names = {store.name_of(name) for name in given}
    else:
        names = set(store.names())
    excluded = [text for text in check_list("exclude", selection.exclude, "['/a.*']") if text]
    for pattern in [compile_pattern("exclude", text) for text in excluded]:
        names = {name for name in names if not pattern.fullmatch(name)}
    if selection.regex or given is None:  # a topic given by name raises its error later
        names = {name for name in names if _is_readable(store, name)}
    if not names:
        raise TopicNotFound(
            f"there is no topic to play in {store.called}"
            + (f": exclude {', '.join(excluded)!r:.80} leaves none" if excluded else "")
        )
    return sorted(names)


def _is_readable(store: PlayedStore, topic: str) -> bool:
    """Return whether the messages of a topic can be read here; log why not."""
    try:
        store.check_readable(topic)
    except DefinitionError as exc:
        _log.error("topic %s is left out, it cannot be read here: %s", topic, exc)
        return False
    return True


class PublishedNames:
    """The names under which stored topics are published.

    A topic that is remapped gets the new name without the prefix. A robot's name stands before the
    new name, too, unless the whole published name is remapped.

    Raises:
        InvalidName: The prefix or a new name is not a valid name in ROS.
    """

    def __init__(self, prefix: str = "", remap: Mapping[str, str] | None = None) -> None:
        self._prefix = prefix.rstrip("/")
        self._remap = {_with_slash(old): _with_slash(new) for old, new in (remap or {}).items()}
        for name in self._remap.values():
            check_ros_name(name, "a remapped topic")
        if prefix:
            check_ros_name(_with_slash(self._prefix), "the prefix")
        self._names: dict[tuple[str, str], str] = {}

    def of(self, topic: str, source: str = "") -> str:
        """Return the published name of a stored topic.

        Args:
            source: Robot's name that stands before it; '' = none.
        """
        key = (topic, source)
        name = self._names.get(key)
        if name is None:
            name = self._names[key] = self._published_name(_with_slash(topic), source)
        return name

    def _published_name(self, topic: str, source: str) -> str:
        """Return the published name of a topic, with leading slash, see ``of``."""
        robot = f"/{source}" if source else ""
        full = _with_slash(self._prefix + robot + topic)
        if full in self._remap:
            return self._remap[full]
        if topic in self._remap:
            return robot + self._remap[topic]
        return full


def _with_slash(name: str) -> str:
    return name if name.startswith("/") else "/" + name
