# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The messages of a topic as tables and arrays of numbers."""

from __future__ import annotations

from functools import partial
from typing import Any, Callable, Iterator, Optional, Sequence, Union

from cassandra_ros.arguments import check_nodes
from cassandra_ros.arrays.frames import readFrame
from cassandra_ros.arrays.gather import readArrays
from cassandra_ros.query.protocols import Table
from cassandra_ros.topics.filtering import Where
from cassandra_ros.topics.selection import Stretch, selectMany
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.topic_rows import AnyKey, Time, TopicRows

Fields = Union[None, str, Sequence[str]]


class TopicArrays(TopicRows):
    """Many messages at once, without an object for each; see CassandraTopic.

    Fields are named as in a SELECT statement: ``linear.x``, ``ranges``, ``ranges[0]``,
    ``header.stamp.secs``, a message (all of its fields), ``KEY``, ``NODE``, each also with
    ``AS name``. Naming a field inside of an array of messages unnests the array: a row for each
    of its elements, or with ``where`` for each element that satisfies the condition, the other
    fields repeated. An array of messages that is named whole is not unnested.
    """

    def getArrays(
        self,
        fields: Fields,
        key: Optional[AnyKey] = None,
        to_key: Optional[Time] = None,
        where: Optional[Where] = None,
        nodeID: Optional[str] = None,
    ) -> dict[str, Any]:
        """Return fields as numpy arrays, one each, of equal length and in the order of time.

        * Numbers and bools have the field's own type (float32 stays float32).
        * ``KEY``, times and durations are int64 nanoseconds: ``.view('datetime64[ns]')`` or
          ``.view('timedelta64[ns]')`` shows them as such. Where messages lie under names KEY is
          text. ``secs`` and ``nsecs`` are int64.
        * Arrays of fixed length, as ``float64[9]``, are arrays of two dimensions (rows, 9);
          those of any length an array of objects: an array for each row. Of arrays inside of
          arrays of messages a row holds lists, as executeCQL returns them.
        * Text is str, in an array of objects.

        Where a message has no such value (``ranges[5]`` of four, a field that another definition
        of the topic lacks, bytes that are no message) the array is a numpy.ma.MaskedArray that
        masks it; arrays of objects hold None. Where definitions disagree on the type of a field,
        it is the smallest that holds both exactly, else Python objects.

        Memory is that of the result: the rows are read by pages, and no Python object is kept
        for a number.

        Args:
            fields: Names of fields; None = all, and KEY.
            key, to_key: Which messages, as items takes them.
            where: A condition, or a condition and a list of values for its ``?``.
            nodeID: Only messages of this node; None = of all.

        Raises:
            InvalidQuery: A field or the condition is not one of this topic; shows the spot.
            InvalidKey: key or to_key cannot be one.
        """
        read = partial(self._read, key, to_key, where, nodeID)
        return readArrays(self, fields, where, read)

    def toDataFrame(
        self,
        fields: Fields = None,
        key: Optional[AnyKey] = None,
        to_key: Optional[Time] = None,
        where: Optional[Where] = None,
        nodeID: Optional[str] = None,
    ) -> Any:
        """Return messages as a pandas.DataFrame, one column a field.

        The index, named ``KEY``, is their time, exact to the nanosecond and in UTC, without a
        zone, so that it compares with the columns; where messages lie under names it is these.
        Columns are as getArrays returns them, but for times (datetime64[ns], also without a
        zone), durations (timedelta64[ns]) and arrays (an array in each cell). What is missing is
        NaN, NaT, None, or NA in one of pandas' nullable types (Int32, UInt64, boolean), so that
        integers stay integers.

        Args:
            fields: Names of fields; None = all of them.
            key, to_key, where, nodeID: As getArrays takes them.

        Raises:
            MissingDependency: pandas is not installed; the text says how.
            InvalidQuery, InvalidKey: As of getArrays.
        """
        read = partial(self._read, key, to_key, where, nodeID)
        return readFrame(self, fields, where, read)

    def _read(
        self,
        key: Optional[AnyKey],
        to_key: Optional[Time],
        where: Optional[Where],
        nodeID: Optional[str],
        columns: Callable[[Table], Sequence[str]],
    ) -> Iterator[StoredRow]:
        """Read the rows that are meant, and of a stretch of time only these columns."""
        tables = self._stored()
        key_format = tables[0].metadata.key_format if tables else self._wish.key_format
        wanted = selectMany(self.name, key_format, tables, key, to_key)
        if where is not None or not isinstance(wanted, Stretch):
            return self._finder(nodeID, where).many(key, to_key)
        nodes = check_nodes(nodeID)
        return self._keyspace.rows.read(tables, *wanted, nodes=nodes, columns=columns)
