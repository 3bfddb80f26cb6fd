# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Several topics as one pandas.DataFrame, on a grid of times or at the times of one topic.

Times are int64 ns, in order. A place is the index of a message of a topic, -1 = no message.
"""

from __future__ import annotations

from typing import Any, Mapping, Sequence

import numpy as np

from cassandra_ros.arguments import check_list
from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import MAX_NS
from cassandra_ros.messages.stamps import Stamp, duration_ns, iso_time
from cassandra_ros.quantities import exact_seconds
from cassandra_ros.query.arrays.array_types import AnyArray, ArrayType
from cassandra_ros.query.arrays.column_values import empty_values, none_missing
from cassandra_ros.query.arrays.field_arrays import FieldArray, Fields, as_frame
from cassandra_ros.read import TimeRange
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.run_finder import RunName

MAX_GRID_ROWS = 50_000_000
"""Maximum number of rows of a grid of times."""


class TopicsFrame:
    """Reads topics at the same times.

    Args:
        catalog: The topics.
        names: Names of the topics.
        fields: Fields by topic; None, or a topic that is missing in it = all.
        within: Maximum distance of a message from the time of its row: seconds, a text like '20ms',
            a Duration or a timedelta.
        time_range: Times of the rows. 0 and LAST_NS as its ends mean that it is open there.
        node, run: nodeID and run of the messages; None = all, which must be of one robot.

    Raises:
        TopicNotFound: A topic is not stored.
        InvalidOption: Fields are for a topic that is not read, or ``within`` is a text without a
            length of time.
        InvalidKey: ``within`` is no length of time.
    """

    def __init__(
        self,
        catalog: Catalog,
        names: Sequence[str],
        fields: Mapping[str, Fields] | None,
        within: object,
        time_range: TimeRange,
        node: str | None,
        run: RunName,
    ) -> None:
        self._catalog = catalog
        self._within = _length_ns(within)
        self._range = time_range
        self._node, self._run = node, run
        self._topics = list({topic.name: topic for topic in map(catalog.get, names)}.values())
        if fields is not None and not isinstance(fields, Mapping):
            raise InvalidOption(f"fields= is a mapping of topics to fields, not {fields!r:.80}")
        self._fields = {catalog.get(name).name: wanted for name, wanted in (fields or {}).items()}
        for name in set(self._fields).difference(topic.name for topic in self._topics):
            raise InvalidOption(f"fields= has topic {name}, which is not among the topics")

    def every(self, step: object) -> Any:
        """Return a pandas.DataFrame: a row for each step, with the last messages at or before it.

        Raises:
            InvalidOption: The step is 0, or makes more than MAX_GRID_ROWS rows; or as in nearest.
        """
        step_ns = _length_ns(step)
        if not step_ns:
            raise InvalidOption("every= is a length of time above 0, such as '20ms'")
        self._check_robots(self._topics)
        low, high = self._range
        gathered = {t.name: self._gather(t, low - self._within, high) for t in self._topics}
        keys = [fields["KEY"].values for fields in gathered.values() if len(fields["KEY"].values)]
        if not low:  # without a message there is no row
            low = min((int(times[0]) for times in keys), default=MAX_NS + 1)
        if high > MAX_NS:
            high = max((int(times[-1]) for times in keys), default=-1)
        rows = max(0, (high - low) // step_ns + 1)
        if rows > MAX_GRID_ROWS:
            reason = f"{iso_time(low)} to {iso_time(high)} has {rows} steps of {step}"
            remedy = f"more than {MAX_GRID_ROWS}: give a longer every=, or key= and to_key="
            raise InvalidOption(f"{reason}, {remedy}")
        times = low + step_ns * np.arange(rows)
        places = {
            name: latest_places(fields["KEY"].values, times, self._within)
            for name, fields in gathered.items()
        }
        return as_frame(align_fields(gathered, places, times))

    def nearest(self, topic: str) -> Any:
        """Return a pandas.DataFrame: a row for each message of a topic, and the nearest of others.

        Raises:
            InvalidOption: The messages are of several robots, or have names instead of times.
            RunNotFound: There is no such run.
            InvalidQuery: A topic does not have a field.
        """
        base, names = self._catalog.get(topic), [other.name for other in self._topics]
        self._check_robots([base, *self._topics])
        low, high = self._range
        base_fields = self._gather(base, low, high, only_times=base.name not in names)
        times = base_fields["KEY"].values
        gathered: dict[str, dict[str, FieldArray]] = {}
        places: dict[str, AnyArray] = {}
        for other in self._topics:
            if other.name == base.name:
                gathered[other.name], places[other.name] = base_fields, np.arange(len(times))
                continue
            fields = self._gather(other, low - self._within, high + self._within)
            gathered[other.name] = fields
            places[other.name] = nearest_places(fields["KEY"].values, times, self._within)
        return as_frame(align_fields(gathered, places, times))

    def _gather(
        self, topic: CassandraTopic, low: int, high: int, *, only_times: bool = False
    ) -> dict[str, FieldArray]:
        """Return KEY and the fields of the messages in a time range.

        Args:
            topic: The topic.
            low, high: First and last time, both included, ns. They may lie outside of ROS time.
            only_times: Return KEY alone.

        Raises:
            InvalidOption: The keys of the topic are names.
        """
        fields = () if only_times else self._fields.get(topic.name)
        if fields is not None:
            fields = ["KEY", *check_list("fields", fields, "['linear.x']")]
        key = Stamp.from_ns(low) if low > 0 else None
        to_key = Stamp.from_ns(high) if high <= MAX_NS else None
        gathered = topic.gather(fields, key, to_key, None, self._node, self._run)
        if gathered["KEY"].kind.kind != "time":
            raise InvalidOption(f"the keys of {topic.name} are names, not times")
        return gathered

    def _check_robots(self, topics: Sequence[CassandraTopic]) -> None:
        """Refuse messages of several robots, which one row would mix."""
        keyspace = self._catalog.keyspace
        if self._node is not None:
            return
        robots = set(keyspace.nodes([table for topic in topics for table in topic.tables]))
        writers = keyspace.runs.writers(self._run)
        run_robots = None if writers is None else keyspace.runs.nodes(writers)
        robots = robots if run_robots is None else robots & run_robots
        if len(robots) > 1:
            names = ", ".join(sorted(robots))
            raise InvalidOption(f"the messages are of several robots ({names}): choose by nodeID=")


def _length_ns(given: object) -> int:
    """Return the ns of a length of time, at least 0; of a text such as '20ms', too."""
    return duration_ns(exact_seconds(given) if isinstance(given, str) else given)


def latest_places(keys: AnyArray, times: AnyArray, within_ns: int) -> AnyArray:
    """Return for each time the place of the last message at or before it.

    Args:
        keys: Times of the messages, in order.
        times: The times that are wanted.
        within_ns: Maximum distance of a message from the time, included, ns.
    """
    places = np.searchsorted(keys, times, "right") - 1
    return _near(keys, times, places, within_ns)


def nearest_places(keys: AnyArray, times: AnyArray, within_ns: int) -> AnyArray:
    """Return for each time the place of the nearest message; of equally near ones the first.

    Args: As in latest_places.
    """
    if not len(keys):
        return np.full(len(times), -1)
    after = np.minimum(np.searchsorted(keys, times, "left"), len(keys) - 1)
    before = np.maximum(after - 1, 0)
    is_before = np.abs(times - keys[before]) <= np.abs(keys[after] - times)
    nearest = keys[np.where(is_before, before, after)]
    return _near(keys, times, np.searchsorted(keys, nearest, "left"), within_ns)


def _near(keys: AnyArray, times: AnyArray, places: AnyArray, within_ns: int) -> AnyArray:
    """Return places with -1 in place of messages farther than ``within_ns`` from their time."""
    places = places.copy()
    indices = np.flatnonzero(places >= 0)
    far = np.abs(times[indices] - keys[places[indices]]) > within_ns
    places[indices[far]] = -1
    return places


def align_fields(
    topics: Mapping[str, Mapping[str, FieldArray]], places: Mapping[str, AnyArray], times: AnyArray
) -> dict[str, FieldArray]:
    """Return the fields of several topics at given times: KEY, and columns named 'topic.field'.

    Args:
        topics: Fields of each topic, by its name.
        places: For each topic the place of its message for each time.
        times: The times.
    """
    aligned = {"KEY": FieldArray(ArrayType("time"), times, none_missing(len(times)))}
    for topic, fields in topics.items():
        for name, array in fields.items():
            aligned[f"{topic}.{name}"] = _take(array, places[topic])
    return aligned


def _take(array: FieldArray, places: AnyArray) -> FieldArray:
    """Return the values at some places; where there is no message they are missing."""
    kind, values, missing = array
    if not len(values):
        return FieldArray(kind, *empty_values(kind, len(places)))
    # Place -1 takes the last message, whose values are then marked as missing.
    taken, lacking = values[places], missing[places] | (places < 0)
    if taken.dtype.kind == "O":
        taken[lacking] = None
    return FieldArray(kind, taken, lacking)
