# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The transform between two frames at any past time, from what was recorded for tf."""

from __future__ import annotations

from typing import Any, Callable, Optional, Sequence

from cassandra_ros.arguments import check_nodes
from cassandra_ros.errors import InvalidName, TopicNotFound
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.stamps import Stamp, toNs
from cassandra_ros.query.protocols import Row, Source
from cassandra_ros.transforms.buffer import Buffer
from cassandra_ros.transforms.failure import Failure
from cassandra_ros.transforms.paths import Tree
from cassandra_ros.transforms.samples import Fixed, Nearest, Recorded, named, stripped
from cassandra_ros.transforms.search import Search


class TransformFinder:
    """Finds transforms in the stored messages of tf's topics.

    Args:
        find: Returns a topic by its name, or raises TopicNotFound.
        nodeID: Only transforms of this node; None = of all.
    """

    def __init__(self, find: Callable[[str], Source[Row]], nodeID: Optional[str] = None) -> None:
        self._find = find
        self._node = nodeID

    def lookup(self, target: str, source: str, time: Any, tf: str, tf_static: str) -> Any:
        """Return the transform that takes points of one frame to another; see RosCassandra."""
        frames = (_frame(target), _frame(source))
        check_nodes(self._node)
        asked = toNs(time)
        moving, fixed = (self._recorded(name) for name in (tf, tf_static))
        if moving is None and fixed is None:
            self._find(tf)  # raises with the nearest names
        topics = [
            f"topic {name}{'' if found else ' (which is not stored)'}"
            for name, found in ((tf, moving), (tf_static, fixed))
        ]
        lookup = _Lookup(moving, fixed, Failure(frames, topics, self._node, time))
        return lookup.at(asked) if asked else lookup.newest()

    def _recorded(self, topic: str) -> Optional[Recorded]:
        try:
            found = self._find(topic)
        except TopicNotFound:
            return None
        return Recorded(found, self._node)


def _frame(name: Any) -> str:
    """Return a frame's name as tf2 wants it."""
    frame = stripped(name) if isinstance(name, str) else ""
    try:
        if frame and "\0" not in frame and frame.encode("utf-8"):
            return frame
    except UnicodeEncodeError:
        pass
    raise InvalidName(f"{name!r:.80} is no name of a frame: give a text like 'base_link'")


class _Lookup:
    """Answers one question."""

    def __init__(
        self, moving: Optional[Recorded], fixed: Optional[Recorded], failure: Failure
    ) -> None:
        self._moving = moving
        self._fixed = Fixed()
        if fixed is not None:
            # Newest first: those that repeat it then need no look.
            fixed.read(self._fixed, 0, MAX_NS, reverse=True)
        self._failure = failure

    def at(self, time: int, centre: Optional[int] = None) -> Any:
        """Return the transform at a time, ns; ``centre`` is a row key near which it lies."""
        search = self._search(time)
        path = search.run(time if centre is None else centre)
        return self._computed(search.tree, path, time)

    def newest(self) -> Any:
        """Return the transform at the newest time that all frames on the path have, as in tf2."""
        search = self._search(None)
        path = search.run(search.last)
        moving = search.tree.moving(path or [])
        if not moving and path == []:
            moving = search.tree.moving([self._failure.frames[0]])
        if not moving:
            return self._computed(search.tree, path, None)
        oldest = min(moving)
        return self.at(oldest.stamp, oldest.key)

    def _search(self, time: Optional[int]) -> Search:
        return Search(self._moving, Tree(Nearest(time), self._fixed), self._failure.frames)

    def _computed(self, tree: Tree, path: Optional[Sequence[str]], time: Optional[int]) -> Any:
        fixed = tree.fixed.all()
        moving = [s for s in tree.nearest.all() if s.child not in tree.fixed.before]
        if path:
            # tf2 goes up to the root and down again, which only adds the rounding of both.
            moving, fixed = ([s for s in part if s.child in path] for part in (moving, fixed))
        else:
            # It remembers every frame that it has heard of, and its errors depend on it.
            known = tree.frames().intersection(self._failure.frames)
            fixed.extend(named(frame) for frame in known)
        buffer = Buffer(time, moving, fixed)
        found = buffer.lookup(*self._failure.frames, lambda kind: self._failure.text(kind, tree))
        found.header.stamp = Stamp.fromNs(time or 0)
        return found
