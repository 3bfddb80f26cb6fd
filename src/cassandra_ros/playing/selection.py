# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is to be played, and under which names it goes out."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import List, Mapping, Optional, Sequence, Tuple, Union

from cassandra_ros.arguments import check_ros_name, check_topics
from cassandra_ros.errors import DefinitionError, TopicNotFound
from cassandra_ros.playing.times import PlayTime
from cassandra_ros.topics.catalog import Catalog, Conditions
from cassandra_ros.topics.patterns import compiled, matching
from cassandra_ros.topics.row_finder import Where

_log = logging.getLogger(__name__)

AlignStart = Union[bool, str]
"""True or 'run', 'node', False = not aligned."""


@dataclass(frozen=True)
class PlaySelection:
    """What is to be played.

    Times are by reception. A number below 10**9 is seconds from the first message of what is
    chosen (rosbag: of the bag, whatever topics are chosen); everything else is a time of the
    calendar, see playing/times.py.

    Attributes:
        topics: Their names; None = all.
        regex: The names are regular expressions, which match whole names.
        exclude: Topics whose whole name matches this regular expression are left out; '' = none.
        start, end: First and last time, both included; None = open.
        duration: Seconds from the start on, instead of end; None = to the end.
        nodeID: Only messages of this node; None = of all.
        run: Only messages of this run: its name, or its writer id; None = of all.
        where: Topic -> condition: of these topics only the messages that satisfy it.
        prefix: What stands before the names under which topics go out.
        remap: Stored topic, or it with the prefix -> the name under which it goes out instead.
        around: 'TOPIC: condition', or (topic, condition): only what lies around the messages of
            that topic that satisfy it.
        before, after: How far around, seconds, at least 0.
        align_start: Play runs of different days as if at once: the first chosen message of each
            lies where the earliest one does. True or 'run': each run; 'node': each nodeID, and
            each run without one. Times of the calendar choose messages by their reception;
            others, and around, mean the common time line.
        node_prefix: Put nodeID, or the run where nobody said one, before the name: /<node>/topic.
    """

    topics: Optional[Sequence[str]] = None
    regex: bool = False
    exclude: str = ""
    start: PlayTime = None
    end: PlayTime = None
    duration: Optional[float] = None
    nodeID: Optional[str] = None
    run: Union[None, str, int] = None
    where: Conditions = None
    prefix: str = ""
    remap: Mapping[str, str] = field(default_factory=dict)
    around: Union[None, str, Tuple[str, Where]] = None
    before: float = 5.0
    after: float = 10.0
    align_start: AlignStart = False
    node_prefix: bool = False


def chosen_topics(catalog: Catalog, selection: PlaySelection) -> List[str]:
    """List the names of the topics that are played, sorted.

    Raises:
        TopicNotFound: A topic is not stored, or nothing is left of what is.
        InvalidOption: An expression is none.
    """
    wanted, names = check_topics(selection.topics), set()
    if selection.regex and wanted is not None:
        every = {topic.name for topic in catalog.all(None)}
        names = matching("topic", wanted, every, f"keyspace {catalog.keyspace.name}")
    elif wanted is not None:
        names = {catalog.get(name).name for name in wanted}
    else:
        names = {topic.name for topic in catalog.all(None)}
    if selection.exclude:
        pattern = compiled("exclude", selection.exclude)
        names = {name for name in names if not pattern.fullmatch(name)}
    if selection.regex or wanted is None:  # others were asked for by name
        names = {name for name in names if _is_readable(catalog, name)}
    if not names:
        raise TopicNotFound(
            f"there is no topic to play in keyspace {catalog.keyspace.name}"
            + (f": exclude {selection.exclude!r:.80} leaves none" if selection.exclude else "")
        )
    return sorted(names)


def _is_readable(catalog: Catalog, topic: str) -> bool:
    try:
        _ = catalog.get(topic).tables
    except DefinitionError as exc:
        _log.error("topic %s is left out, it cannot be read here: %s", topic, exc)
        return False
    return True


class Names:
    """Gives stored topics the names under which they go out.

    A name that is remapped is taken as it stands, without the prefix.

    Raises:
        InvalidName: Prefix or a new name cannot be one in ROS.
    """

    def __init__(self, prefix: str = "", remap: Optional[Mapping[str, str]] = None) -> None:
        self._prefix = prefix.rstrip("/")
        self._remap = {_rooted(old): _rooted(new) for old, new in (remap or {}).items()}
        for name in self._remap.values():
            check_ros_name(name, "a remapped topic")
        if prefix:
            check_ros_name(_rooted(self._prefix), "the prefix")
        self._known: dict[Tuple[str, str], str] = {}

    def of(self, topic: str, source: str = "") -> str:
        """Return the name of a stored topic; source: the name of a robot to stand before it."""
        key = (topic, source)
        name = self._known.get(key)
        if name is None:
            name = self._known[key] = self._named(_rooted(topic), source)
        return name

    def _named(self, topic: str, source: str) -> str:
        robot = f"/{source}" if source else ""
        full = _rooted(self._prefix + robot + topic)
        if full in self._remap:
            return self._remap[full]
        if topic in self._remap:
            return robot + self._remap[topic]
        return full


def _rooted(name: str) -> str:
    return name if name.startswith("/") else "/" + name
