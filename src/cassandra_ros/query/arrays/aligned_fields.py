# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The fields of several topics at the same times: for each time one message of each topic.

Times are int64 ns, in order. A place is the index of a message of a topic, -1 = no message.
"""

from __future__ import annotations

from typing import Mapping

import numpy as np

from cassandra_ros.query.arrays.array_types import AnyArray, ArrayType
from cassandra_ros.query.arrays.column_values import empty_values, none_missing
from cassandra_ros.query.arrays.field_arrays import FieldArray


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
