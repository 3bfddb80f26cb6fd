# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class CassandraTopic: the messages of one topic (paper section 3, figure 1)."""

from __future__ import annotations

from functools import partial
from itertools import islice
from typing import Any, Iterator, Optional, Sequence, Union

from cassandra_ros.arguments import (
    check_field,
    check_limit,
    check_message_name,
    check_new_node,
    check_nodes,
    check_text,
    check_user_keys,
)
from cassandra_ros.arrays.data_frame import read_frame
from cassandra_ros.arrays.gather import read_arrays
from cassandra_ros.errors import InvalidKey, MessageNotFound, TopicNotFound, TypeMismatch
from cassandra_ros.formats.cassandra_topic_ import CassandraTopic_, EncodedMessage
from cassandra_ros.keys import Position
from cassandra_ros.messages.stamps import Time
from cassandra_ros.metadata import MetaView
from cassandra_ros.printable import public_names
from cassandra_ros.read import Chooser, Columns, Named, Read, Whose
from cassandra_ros.topics.adder import Adder
from cassandra_ros.topics.descriptions import topic_html, topic_line
from cassandra_ros.topics.indexes import Progress, create_index, has_index, remove_index
from cassandra_ros.topics.key_selection import AnyKey, range_between
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_objects import with_messages
from cassandra_ros.topics.row_finder import Filter, Finder, Where
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import Key, StoredRow
from cassandra_ros.topics.stored_totals import count_buckets, count_rows
from cassandra_ros.topics.topic_table import TopicTable, WholeTopic
from cassandra_ros.topics.topic_wish import Wish

Fields = Union[None, str, Sequence[str]]
"""Names of fields; None = all."""
_REQUIRED = object()


class CassandraTopic:
    """The stored messages of one topic. Got from RosCassandra, safe to share between threads.

    What a key is follows from the ``key_format`` that addTopic was given:

    * ``time``: the time at which a message was received.
    * ``msg_part``: the value of a field. Of a time field it is a time as well; of any other
      field ``getData(value)`` gives the first message that has it, ``items(value)`` all, and a
      genpy.Time means the receive time. A number asked of a float32 field is rounded to one.
    * ``hash``: the md5 of type name, NUL and serialised bytes, as 32 hex digits: equal messages
      are kept once, as they came last.
    * ``manual``: a name that you give; ``getData(name)`` is the newest message under it,
      ``items(name)`` all.

    ``len(topic)`` counts, ``for key, msg in topic`` walks through all, ``key in topic`` looks.

    Fields are named as in a SELECT statement: ``linear.x``, ``ranges[0]``, ``header.stamp.secs``, a
    message (all of its fields), ``KEY``, ``NODE``, ``RUN``, each with ``AS name``. Naming a field
    inside of an array of messages unnests it: a row for each element, or with ``where`` for each
    that satisfies the condition, the other fields repeated; an array named whole is not unnested.

    Attributes:
        name: The topic's name as it is stored.
    """

    def __init__(self, keyspace: Keyspace, adder: Adder, wish: Wish) -> None:
        self.name = wish.metadata.topic
        self._keyspace = keyspace
        self._adder = adder
        self._wish = wish

    @property
    def tables(self) -> WholeTopic:
        """The tables of the topic, one for each md5 and format; none before the first message."""
        return self._keyspace.tables.of_topic(self.name)

    @property
    def getMeta(self) -> MetaView:
        """The metadata: ``getMeta['msg_type']`` or ``getMeta('msg_type')``."""
        tables = self.tables
        metadata = tables[0].metadata if tables else self._wish.metadata
        indexes = {field: "" for t in tables for field in t.metadata.indexes} or metadata.indexes
        key_format = metadata.key_format or "time"
        metadata = metadata.with_(indexes=indexes, key_format=key_format)
        return MetaView(metadata, self._keyspace.nodes(tables))

    def countBuckets(self) -> int:
        """Count the partitions: time ranges of a node in a table; 0 for named messages."""
        return count_buckets(self._keyspace.directory, self.tables)

    def setMeta(self, **keys: Any) -> None:
        """Set keys of your own in the topic's metadata: ``setMeta(site='lab')``.

        Args:
            keys: Values that JSON gives back as they are (texts, finite numbers, bools, lists,
                dicts whose keys are texts); None removes a key. ``comment`` sets the topic's
                comment; the other keys of getMeta are facts and cannot be set.

        Raises:
            InvalidName, InvalidOption: A key cannot be set, or not to this value.
            TopicNotFound: The topic has no type yet, so there is no table to note it in.
        """
        comment = keys.pop("comment", None)
        if comment is not None:
            check_text("comment", comment)
        check_user_keys(keys)
        self._typed("; give metadata= to addTopic")
        self._keyspace.schema.change_topic(self.name, lambda m: m.with_user(keys, comment))

    @property
    def format(self) -> CassandraTopic_:
        """The format object of the first table; TopicNotFound before the first message."""
        return self._typed()[0].format

    def _typed(self, remedy: str = "") -> list[TopicTable]:
        tables = self.tables
        if not tables:
            none = f"topic {self.name} has no type yet: its first message fixes it"
            raise TopicNotFound(none + remedy)
        return tables

    def getColValidationClasses(self) -> dict[str, str]:
        """Return the format's columns: name → CQL type (paper listing 3)."""
        return self.format.getColValidationClasses()

    def encode(self, msg: Any) -> EncodedMessage:
        """Translate a message into columns (paper 3.1)."""
        return self.format.encode(msg)

    def decode(self, data: EncodedMessage) -> Any:
        """Translate columns, as encode returns them, back into a message (paper 3.1)."""
        if not isinstance(data, EncodedMessage):
            raise TypeMismatch(f"{data!r:.80} is no encoded message: give what encode returned")
        return self.format.decode(data)

    def addData(self, msg: Any, key: Optional[AnyKey] = None, nodeID: Optional[str] = None) -> Key:
        """Store one message; return when it is acknowledged.

        Args:
            msg: A message object of the topic's type.
            key: With key_format ``time`` its time, None = now, by the node's clock where one runs
                in this process. With ``manual`` its name. With ``msg_part`` and ``hash`` the
                message itself says it.
            nodeID: Who produced it; None = the nodeID of addTopic.

        Returns:
            The row key, which also knows the row: an exact time (Stamp), or a name (RowName).

        Raises:
            TypeMismatch: The message is of another type; nothing is stored.
            InvalidKey, InvalidName, ClockNotSet, WriteFailed.
        """
        node = self._wish.metadata.nodeID if nodeID is None else check_new_node(nodeID)
        table = self._keyspace.new_tables.for_message(self._wish, msg)
        kind = table.metadata.key_format
        if kind == "manual":
            return self._adder.add(table, msg, None, node, check_message_name(self.name, key))
        if key is not None and kind != "time":
            raise InvalidKey(
                f"the key of a message of topic {self.name} comes from the message itself "
                f"(key_format {kind}): leave key out"
            )
        return self._adder.add(table, msg, key, node)

    def getData(
        self,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nearest: Optional[str] = None,
        default: Any = _REQUIRED,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        where: Optional[Where] = None,
        run: RunName = None,
    ) -> Any:
        """Return one message, or those of a time range.

        Args:
            key: A time (genpy.Time, datetime, numpy.datetime64, pandas.Timestamp, int ns, float s,
                ISO 8601 text), or what else is the topic's key; with to_key the lower end.
            to_key: The upper end, where keys are times. Both ends are included.
            nearest: 'before' (at or before key), 'after' (at or after) or 'either'.
            default: Returned instead of raising when there is no message at key.
            nodeID: Only messages of this node; None = of all.
            run: Only messages of the recordings or imports of this name, or of a writer id.
            limit: At most so many messages of a stretch.
            where: Only messages that satisfy this condition: what stands behind WHERE in CQL, as
                ``'linear.x > 0.5'``, or a pair of it and its parameters. One on the elements of
                an array of messages is satisfied when one element does.

        Returns:
            With to_key a list in the order of time, else one message: of several with the same
            stamp or value the first, of several with the same name the newest. Equal stamps are
            ordered by nodeID, by who wrote them, and of one writer by their arrival.

        Raises:
            MessageNotFound: No message at key (also a KeyError).
            InvalidKey: A key cannot be one, or the topic's keys have no order.
            InvalidQuery, RunNotFound: where is no condition (it is shown), or run none.
        """
        if to_key is not None:
            time_range = self._finder(nodeID, where, run).many(key, to_key, limit=limit)
            return [message for _, message in with_messages(self._keyspace.cassandra, time_range)]
        if key is None:
            raise InvalidKey(
                "getData needs a key (and to_key for a time range); items() walks "
                f"through all messages of topic {self.name}, also through those with where="
            )
        finder = self._finder(nodeID, where, run)
        row = finder.find(key, nearest)
        if row is None:
            if default is not _REQUIRED:
                return default
            raise MessageNotFound(finder.absent(key, nearest))
        return row.message()

    def items(
        self,
        key: Optional[AnyKey] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        reverse: bool = False,
        where: Optional[Where] = None,
        run: RunName = None,
    ) -> Iterator[tuple[Key, Any]]:
        """Walk lazily through (key, message) in the order of time, any number of them.

        Where keys are names a scan lists all of them first: slow with millions.

        Args:
            key: Lower end, included; None = open. Where keys are names or values: all of this one.
            to_key: Upper end, included; None = open.
            reverse: Newest first.
            nodeID, limit, where, run: As getData takes them, and raises for them.

        Raises:
            InvalidKey: ``key`` or ``to_key`` is no key of this topic.
        """
        rows = self._finder(nodeID, where, run).many(key, to_key, limit=limit, reverse=reverse)
        return ((row.key, msg) for row, msg in with_messages(self._keyspace.cassandra, rows))

    def getRow(
        self,
        key: AnyKey,
        *,
        nearest: Optional[str] = None,
        nodeID: Optional[str] = None,
        where: Optional[Where] = None,
        run: RunName = None,
    ) -> Optional[StoredRow]:
        """Find one stored row as getData does; None where there is none."""
        return self._finder(nodeID, where, run).find(key, nearest)

    def _finder(
        self, nodeID: Optional[str] = None, where: Optional[Where] = None, run: RunName = None
    ) -> Finder:
        whose, tables = self._whose(nodeID, run), self._stored()
        key_format = (tables[0] if tables else self._wish).metadata.key_format or "time"
        passing = None
        if where is not None:
            filtered = partial(Filter, self, where, whose)
            passing = self._keyspace.naming(filtered)
        return Finder(self._keyspace, self.name, key_format, tables, whose, passing)

    def _whose(self, nodeID: Optional[str], run: RunName) -> Whose:
        return Whose(check_nodes(nodeID), self._keyspace.runs.writers(run))

    def versions(
        self, name: str, *, nodeID: Optional[str] = None, reverse: bool = False, run: RunName = None
    ) -> Iterator[StoredRow]:
        """Walk through the messages under one name, by time, without making objects."""
        check_text("name", name, error=InvalidKey)
        return self._finder(nodeID, run=run).many(name, None, reverse=reverse)

    def rows(
        self,
        key: Optional[Time] = None,
        to_key: Optional[Time] = None,
        *,
        nodeID: Optional[str] = None,
        limit: Optional[int] = None,
        after: Optional[Position] = None,
        reverse: bool = False,
        columns: Optional[Columns] = None,
        chooser: Optional[Chooser] = None,
        run: RunName = None,
        wanted: Optional[int] = None,
    ) -> Iterator[StoredRow]:
        """Walk through messages by their time, as items does, without making objects.

        Args:
            key, to_key: Ends, both included, whatever the topic's keys are; None = open.
            nodeID, limit, reverse, run: As items takes them.
            after: Begin behind this row (a cursor).
            columns: Which columns of a table to read, None = all; a row fetches the others when
                its bytes are asked for.
            chooser: Tells what the server may leave out.
            wanted: How many are probably taken, None = limit: so much is asked for at first.
        """
        if not isinstance(after, (Position, type(None))):
            raise InvalidKey(f"after={after!r:.80} is no place: give the position of a row")
        limit = check_limit(limit)
        read = Read(
            range_between(key, to_key),
            self._whose(nodeID, run),
            after=after,
            reverse=reverse,
            columns=columns,
            chooser=chooser,
            wanted=limit if wanted is None else wanted,
        )
        return islice(self.read(read), limit)

    def read(self, read: Read) -> Iterator[StoredRow]:
        """Walk through the messages that a read asks for, without making objects."""
        if isinstance(read.only, Named):
            check_message_name(self.name, read.only.name)
        return self._keyspace.rows.read(self._stored(), read)

    def count(self, read: Read) -> int:
        """Count the messages in the time range of a read, of its nodes and writers."""
        return count_rows(self._keyspace.directory, self._stored(), read)

    def _stored(self) -> WholeTopic:
        wish = self._wish
        tables = self.tables or self._keyspace.tables.of_topic(self.name, fresh=True)
        known = (self.name, wish.metadata.format) in self._keyspace.schema.seen
        if not tables and (known or not wish.pending):
            raise TopicNotFound(
                f"topic {self.name} is not stored in keyspace {self._keyspace.name} any more"
            )
        return tables

    def first(self, nodeID: Optional[str] = None, *, run: RunName = None) -> Optional[Key]:
        """Return the key of the oldest message; None when there is none."""
        return self._end(nodeID, run, reverse=False)

    def last(self, nodeID: Optional[str] = None, *, run: RunName = None) -> Optional[Key]:
        """Return the key of the newest message; None when there is none."""
        return self._end(nodeID, run, reverse=True)

    def _end(self, nodeID: Optional[str], run: RunName, reverse: bool) -> Optional[Key]:
        rows = self.rows(nodeID=nodeID, limit=1, reverse=reverse, run=run)
        return next((row.key for row in rows), None)

    def keyOfText(self, text: str) -> AnyKey:
        """Read a key that a person typed.

        A name is the text itself; a time integer nanoseconds or ISO 8601; a value of a field is a
        number, true, false or text, as the field, and a time beside it ISO 8601 only.

        Raises InvalidKey.
        """
        check_text("text", text, error=InvalidKey)
        return self._finder().of_text(text)

    def countTopicData(
        self,
        key: Optional[AnyKey] = None,
        to_key: Optional[Time] = None,
        nodeID: Optional[str] = None,
        *,
        where: Optional[Where] = None,
        run: RunName = None,
    ) -> int:
        """Count the messages that items with the same arguments walks through.

        By time alone they are counted without reading them, with where= without making objects.
        """
        return self._finder(nodeID, where, run).count(key, to_key)

    def removeData(
        self,
        key: Optional[AnyKey] = None,
        to_key: Optional[Time] = None,
        nodeID: Optional[str] = None,
        *,
        where: Optional[Where] = None,
        run: RunName = None,
    ) -> int:
        """Delete the messages at key, or with key <= time <= to_key; return how many.

        A key that the store returned means its one message, a bare time, name or value all that
        have it. With where= and run= only those that satisfy the condition or are of the run are
        deleted; without key and to_key that is each one of the topic, of whatever time.

        Raises:
            MessageNotFound: There is no message at key (without to_key).
            InvalidKey, InvalidQuery: Neither key, to_key, where nor run is given; where is none.
        """
        self._keyspace.schema.tables(fresh=True)  # what another client just stored goes, too
        return self._finder(nodeID, where, run).remove(key, to_key)

    def getArrays(
        self,
        fields: Fields,
        key: Optional[AnyKey] = None,
        to_key: Optional[Time] = None,
        where: Optional[Where] = None,
        nodeID: Optional[str] = None,
        run: RunName = None,
    ) -> dict[str, Any]:
        """Return fields as numpy arrays, one each, of equal length and in the order of time.

        * Numbers and bools keep the field's type (float32 stays float32); text is str in an
          array of objects.
        * ``KEY``, times and durations are int64 nanoseconds: ``.view('datetime64[ns]')`` or
          ``.view('timedelta64[ns]')`` shows them as such. KEY is text where messages lie under
          names. ``secs`` and ``nsecs`` are int64, computed integers too where all of them fit.
        * Arrays of fixed length have two dimensions, as (rows, 9). Other arrays, too, where every
          row that is returned has one and all have the same length: scans of 360 ranges give
          (rows, 360), empty arrays (rows, 0). Else, and where there is no row, they give an array
          of objects, an array a row. ``list(found['ranges'])`` is the same in both cases, and what
          a program uses that must not depend on the lengths.
        * Arrays inside of arrays of messages give lists.

        What a message lacks (``ranges[5]`` of four, a field of another definition, bytes that are
        no message) is masked by a numpy.ma.MaskedArray, or None in an array of objects. Where
        definitions disagree on a field's type, it is the smallest that holds both exactly.

        Args:
            fields: Names of fields; None = all, and KEY.
            key, to_key, where, nodeID, run: Which messages, as items takes them.

        Raises:
            InvalidQuery: A field or the condition is not one of this topic; shows the spot.
            InvalidKey: key or to_key cannot be one.
        """
        finder = self._finder(nodeID, where, run)
        reads, whose = finder.reads(key, to_key), finder.whose
        return self._keyspace.naming(lambda: read_arrays(self, fields, where, *reads, whose=whose))

    def toDataFrame(
        self,
        fields: Fields = None,
        key: Optional[AnyKey] = None,
        to_key: Optional[Time] = None,
        where: Optional[Where] = None,
        nodeID: Optional[str] = None,
        run: RunName = None,
    ) -> Any:
        """Return messages as a pandas.DataFrame, one column a field.

        The index ``KEY`` is their time, exact to the nanosecond, in UTC and without a zone; or
        their names. Columns are as getArrays returns them, but times are datetime64[ns] without a
        zone, durations timedelta64[ns], and arrays lie in cells, whatever their lengths. What is
        missing is NaN, NaT, None, or NA in a nullable type (Int32, UInt64, boolean), so that
        integers stay integers.

        Args:
            fields, key, to_key, where, nodeID, run: As getArrays takes them, and raises for them.

        Raises:
            MissingDependency: pandas is not installed; the text says how.
        """
        finder = self._finder(nodeID, where, run)
        reads, whose = finder.reads(key, to_key), finder.whose
        return self._keyspace.naming(lambda: read_frame(self, fields, where, *reads, whose=whose))

    def createIndex(self, field: str, progress: Optional[Progress] = None) -> int:
        """Make an index on a field, so that conditions on it read only the rows that they find.

        Others may record the topic meanwhile, and their rows are found in any case: a bucket that
        a writer has open is read without the index. Calling again for an index that is there
        goes on where it was interrupted, and takes in what was being written the last time.

        Args:
            field: Dotted path, as 'linear.x'; in an array of messages, or an array itself, it
                finds the messages that contain a value. Texts over 1 KiB, arrays over 256 elements
                and NaN are not indexed; their messages are read besides.
            progress: Called with (rows done, rows in all).

        Returns:
            How many stored messages were indexed.

        Raises:
            InvalidName, InvalidOption: The field is none, or cannot be indexed here.
            StoreUnavailable: Cassandra is rewriting the files of the topic (an index made
                meanwhile could miss rows), or is busy with other indexes; ask again later.
            TopicNotFound: The topic is gone, or has no type yet.
        """
        check_field(field)
        return create_index(self._keyspace, self._adder, self.name, field, progress)

    def hasIndex(self, field: str) -> bool:
        """Say whether every table whose type has the field has an index on it."""
        return has_index(self.tables, check_field(field))

    def removeIndex(self, field: str) -> None:
        """Remove an index. The messages stay as they are.

        Raises:
            InvalidName, InvalidOption: There is no such index; the key of the messages needs it.
            TopicNotFound: The topic is gone.
        """
        remove_index(self._keyspace, self.name, check_field(field))

    def __len__(self) -> int:
        return self.countTopicData()

    def __bool__(self) -> bool:
        return True  # a topic without messages is one, too

    def __iter__(self) -> Iterator[tuple[Key, Any]]:
        return self.items()

    def __contains__(self, key: object) -> bool:
        return self.getRow(key) is not None

    def __dir__(self) -> list[str]:
        return public_names(self, ("count", "countBuckets", "getRow", "read", "rows", "tables"))

    def __repr__(self) -> str:
        space = self._keyspace
        return topic_line(self.name, space.directory, lambda: space.tables.of_topic(self.name))

    def _repr_html_(self) -> str:
        return topic_html(self.name, self._keyspace.directory, self.tables)
