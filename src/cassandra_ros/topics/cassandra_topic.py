# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class CassandraTopic: the messages of one topic (paper section 3, figure 1)."""

from __future__ import annotations

from functools import partial
from itertools import islice
from typing import Any, Iterator, Sequence, Union

from cassandra_ros.arguments import (
    check_field,
    check_limit,
    check_list,
    check_message_name,
    check_new_node,
    check_nodes,
    check_text,
    check_user_keys,
)
from cassandra_ros.errors import InvalidKey, MessageNotFound, TopicNotFound, TypeMismatch
from cassandra_ros.installation import optional_module
from cassandra_ros.keys import Position
from cassandra_ros.messages.formats.cassandra_topic_ import CassandraTopic_, EncodedMessage
from cassandra_ros.messages.stamps import Time
from cassandra_ros.metadata import MetaView
from cassandra_ros.printable import public_names
from cassandra_ros.query.arrays.arrow_batches import ArrowSchema, read_record_batches
from cassandra_ros.query.arrays.arrow_types import wanted_columns
from cassandra_ros.query.arrays.batch import LeastOf, Window
from cassandra_ros.query.arrays.field_arrays import FieldArray, as_arrays, as_frame, gather_fields
from cassandra_ros.read import Chooser, Columns, Named, Read, Whose
from cassandra_ros.topics.descriptions import topic_html, topic_line
from cassandra_ros.topics.indexes import Progress, create_index, has_index, remove_index
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.message_adder import MessageAdder
from cassandra_ros.topics.new_tables import Wish
from cassandra_ros.topics.row_finder import (
    AnyKey,
    Filter,
    Finder,
    Where,
    range_between,
    refuse_units,
)
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.stored_row import Key, StoredRow, with_messages
from cassandra_ros.topics.stored_totals import count_buckets, count_rows
from cassandra_ros.topics.topic_table import TableSet, TopicTable

Fields = Union[None, str, Sequence[str]]
"""Names of fields; None = all."""
_REQUIRED = object()
"""Value of ``default`` in getData if no default was given: a missing message is an error."""


class CassandraTopic:
    """The stored messages of one topic. Get it from RosCassandra; safe to share between threads.

    The ``key_format`` given to addTopic decides what the key of a message is:

    * ``time``: the time at which the message was received.
    * ``msg_part``: the value of a field. If it is a time field, the key is a time too. For any
      other field ``getData(value)`` returns the first message with this value, ``items(value)`` all
      of them, and a genpy.Time means the receive time. A number is rounded to float32 for such a
      field.
    * ``hash``: the md5 of type name, NUL and serialised bytes, as 32 hex digits. Equal messages are
      stored once, with the time of the last one.
    * ``manual``: a name that you give; ``getData(name)`` returns its newest message,
      ``items(name)`` all of them.

    ``len(topic)`` counts, ``for key, msg in topic`` reads all messages, ``key in topic`` looks for
    one.

    Fields are named as in a SELECT statement: ``linear.x``, ``ranges[0]``, ``header.stamp.secs``, a
    message (all of its fields), ``KEY``, ``NODE``, ``RUN``, each with ``AS name``. A field inside
    of an array of messages unnests the array: one row for each element, or with ``where`` for each
    element that satisfies the condition, with the other fields repeated. An array named as a whole
    is not unnested.

    Attributes:
        name: Name of the topic as it is stored.
    """

    def __init__(self, keyspace: Keyspace, adder: MessageAdder, wish: Wish) -> None:
        self.name = wish.metadata.topic
        self._keyspace = keyspace
        self._adder = adder
        self._wish = wish

    @property
    def tables(self) -> TableSet:
        """Tables of the topic, one for each kind and format; empty before the first message."""
        return self._keyspace.tables.of_topic(self.name)

    @property
    def getMeta(self) -> MetaView:
        """Metadata of the topic: ``getMeta['msg_type']`` or ``getMeta('msg_type')``."""
        tables = self.tables
        metadata = tables[0].metadata if tables else self._wish.metadata
        indexes = {field: "" for t in tables for field in t.metadata.indexes} or metadata.indexes
        key_format = metadata.key_format or "time"
        metadata = metadata.with_(indexes=indexes, key_format=key_format)
        return MetaView(metadata, self._keyspace.nodes(tables))

    def countBuckets(self) -> int:
        """Return the number of partitions: buckets of a node in a table; 0 for named messages."""
        return count_buckets(self._keyspace.directory, self.tables)

    def setMeta(self, **keys: Any) -> None:
        """Set keys of your own in the topic's metadata: ``setMeta(site='lab')``.

        Args:
            keys: Values that JSON gives back unchanged (texts, finite numbers, bools, lists, dicts
                with text keys); None removes a key. ``comment`` sets the topic's comment; the other
                keys of getMeta are facts and cannot be set.

        Raises:
            InvalidName, InvalidOption: A key cannot be set, or not to this value.
            TopicNotFound: The topic has no type yet, so it has no table to hold the metadata.
        """
        comment = keys.pop("comment", None)
        if comment is not None:
            check_text("comment", comment)
        checked = check_user_keys(keys)
        self._typed_tables("; give metadata= to addTopic")
        self._keyspace.schema.change_topic(self.name, lambda m: m.with_user(checked, comment))

    @property
    def format(self) -> CassandraTopic_:
        """Format object of the first table; raises TopicNotFound before the first message."""
        return self._typed_tables()[0].format

    def _typed_tables(self, remedy: str = "") -> list[TopicTable]:
        """Return the tables; without any, raise TopicNotFound with ``remedy`` in its text."""
        tables = self.tables
        if not tables:
            reason = f"topic {self.name} has no type yet: its first message fixes it"
            raise TopicNotFound(reason + remedy)
        return tables

    def getColValidationClasses(self) -> dict[str, str]:
        """Return the format's columns: name → CQL type (paper listing 3)."""
        return self.format.getColValidationClasses()

    def encode(self, msg: Any) -> EncodedMessage:
        """Translate a message into columns (paper 3.1). Raises TopicNotFound, as ``format``."""
        return self.format.encode(msg)

    def decode(self, data: EncodedMessage) -> Any:
        """Translate columns, as encode returns them, back into a message (paper 3.1)."""
        if not isinstance(data, EncodedMessage):
            raise TypeMismatch(f"{data!r:.80} is not an encoded message: give what encode returned")
        return self.format.decode(data)

    def addData(self, msg: Any, key: AnyKey | None = None, nodeID: str | None = None) -> Key:
        """Store one message; return when it is acknowledged.

        Args:
            msg: A message object of the topic's type.
            key: With key_format ``time`` its time; None = now, by the node's clock if a node runs
                in this process. With ``manual`` its name. Leave it out with ``msg_part`` and
                ``hash``.
            nodeID: The robot or other source of the message; None = the nodeID of addTopic.

        Returns:
            The row key, by which the row is found again: an exact time (Stamp) or a name (RowName).

        Raises:
            TypeMismatch: The message has another type; nothing is stored.
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
        refuse_units(self._keyspace, self.tables, key)
        return self._adder.add(table, msg, key, node)

    def getData(
        self,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        nearest: str | None = None,
        default: Any = _REQUIRED,
        nodeID: str | None = None,
        limit: int | None = None,
        where: Where | None = None,
        run: RunName = None,
    ) -> Any:
        """Return one message, or those of a time range.

        Args:
            key: A time (genpy.Time, datetime, numpy.datetime64, pandas.Timestamp, int ns, float s,
                ISO 8601 text), or another key of the topic; with to_key the first time.
            to_key: The last time, if keys are times. Both ends are included.
            nearest: 'before' (at or before key), 'after' (at or after) or 'either'.
            default: Returned if there is no message at key, in place of an error.
            nodeID: nodeID whose messages are read; None = all.
            run: Run whose messages are read, by name or writer id; None = all.
            limit: Maximum number of messages of a time range.
            where: Condition for the messages: the text after WHERE in CQL, such as
                ``'linear.x > 0.5'``, or a pair of text and parameters. A condition on the elements
                of an array of messages is satisfied if one element satisfies it.

        Returns:
            With to_key a list in order of time, otherwise one message: of several with the same
            stamp or value the first, of several with the same name the newest. Messages with equal
            stamps are in the order of nodeID, writer and arrival.

        Raises:
            MessageNotFound: There is no message at key (also a KeyError).
            InvalidKey: A key is not valid, or the topic's keys have no order.
            InvalidQuery: The condition is not valid; the text shows it.
            RunNotFound: There is no such run.
        """
        if to_key is not None:
            time_range = self._finder(nodeID, where, run).many(key, to_key, limit=limit)
            return [message for _, message in with_messages(self._keyspace.cassandra, time_range)]
        if key is None:
            raise InvalidKey(
                "getData needs a key (and to_key for a time range); items() reads "
                f"all messages of topic {self.name}, also with where="
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
        key: AnyKey | None = None,
        to_key: Time | None = None,
        *,
        nodeID: str | None = None,
        limit: int | None = None,
        reverse: bool = False,
        where: Where | None = None,
        run: RunName = None,
    ) -> Iterator[tuple[Key, Any]]:
        """Read (key, message) pairs lazily in order of time.

        In topics with names a scan lists all names first, which is slow with millions.

        Args:
            key: First time, included; None = open. In topics with names or values: the name or
                value.
            to_key: Last time, included; None = open.
            reverse: Newest first.
            nodeID, limit, where, run: As in getData, also the errors.

        Raises:
            InvalidKey: ``key`` or ``to_key`` is not a key of this topic.
        """
        rows = self._finder(nodeID, where, run).many(key, to_key, limit=limit, reverse=reverse)
        return ((row.key, msg) for row, msg in with_messages(self._keyspace.cassandra, rows))

    def getRow(
        self,
        key: AnyKey,
        *,
        nearest: str | None = None,
        nodeID: str | None = None,
        where: Where | None = None,
        run: RunName = None,
    ) -> StoredRow | None:
        """Return one stored row, found as in getData; None if there is no such row."""
        return self._finder(nodeID, where, run).find(key, nearest)

    def _finder(
        self, nodeID: str | None = None, where: Where | None = None, run: RunName = None
    ) -> Finder:
        """Return the finder of one call, with checked arguments; errors as in getData."""
        whose, tables = self._whose(nodeID, run), self._stored_tables()
        key_format = (tables[0] if tables else self._wish).metadata.key_format or "time"
        condition = None
        if where is not None:
            condition = self._keyspace.tables.naming(partial(Filter, self, where, whose))
        return Finder(self._keyspace, self.name, key_format, tables, whose, condition)

    def _whose(self, nodeID: str | None, run: RunName) -> Whose:
        """Return the checked robot and runs; warn once of a robot without messages."""
        nodes, runs = check_nodes(nodeID), self._keyspace.runs
        runs.check_robot(nodeID)
        return Whose(nodes, runs.writers(run))

    def versions(
        self, name: str, *, nodeID: str | None = None, reverse: bool = False, run: RunName = None
    ) -> Iterator[StoredRow]:
        """Yield the rows with one name, by time, without making message objects."""
        check_text("name", name, error=InvalidKey)
        return self._finder(nodeID, run=run).many(name, None, reverse=reverse)

    def rows(
        self,
        key: Time | None = None,
        to_key: Time | None = None,
        *,
        nodeID: str | None = None,
        limit: int | None = None,
        after: Position | None = None,
        reverse: bool = False,
        columns: Columns | None = None,
        chooser: Chooser | None = None,
        run: RunName = None,
        wanted: int | None = None,
    ) -> Iterator[StoredRow]:
        """Yield rows by time, like items but without making message objects.

        Args:
            key, to_key: First and last time, both included, whatever the topic's keys are; None =
                open.
            nodeID, limit, reverse, run: As in items.
            after: Position of a row after which to begin (a cursor).
            columns: Returns the columns of a table to read, None = all; a row fetches the others
                when its bytes are accessed.
            chooser: Decides which conditions the server checks.
            wanted: Number of rows that will probably be taken, None = limit; decides the first
                request.
        """
        if not isinstance(after, (Position, type(None))):
            raise InvalidKey(f"after={after!r:.80} is not a place: give the position of a row")
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
        """Yield the rows of a read, without making message objects.

        Raises:
            InvalidKey: The read asks for an invalid name.
            TopicNotFound: The topic was removed.
        """
        if isinstance(read.only, Named):
            check_message_name(self.name, read.only.name)
        return self._keyspace.rows.read(self._stored_tables(), read)

    def in_order(self, read: Read, least: LeastOf) -> Iterator[StoredRow | Window]:
        """Yield the messages of ``read`` in the same order; many of them come together.

        Args:
            read: What is read; ``only`` is not set.
            least: Minimum number of messages of a table that come together; see LeastOf.
        """
        return self._keyspace.rows.in_order(self._stored_tables(), read, least)

    def count(self, read: Read) -> int:
        """Return the number of messages in the time range of a read, of its nodes and writers."""
        return count_rows(self._keyspace.directory, self._stored_tables(), read)

    def _stored_tables(self) -> TableSet:
        """Return the tables to read; empty if the topic was added here and has no message yet.

        Raises:
            TopicNotFound: The topic was removed.
        """
        wish = self._wish
        tables = self.tables or self._keyspace.tables.of_topic(self.name, fresh=True)
        was_seen = (self.name, wish.metadata.format) in self._keyspace.schema.seen
        if not tables and (was_seen or not wish.pending):
            raise TopicNotFound(
                f"topic {self.name} is not stored in keyspace {self._keyspace.name} any more"
            )
        return tables

    def first(self, nodeID: str | None = None, *, run: RunName = None) -> Key | None:
        """Return the key of the oldest message; None if there are no messages."""
        return self._end(nodeID, run, reverse=False)

    def last(self, nodeID: str | None = None, *, run: RunName = None) -> Key | None:
        """Return the key of the newest message; None if there are no messages."""
        return self._end(nodeID, run, reverse=True)

    def _end(self, nodeID: str | None, run: RunName, reverse: bool) -> Key | None:
        rows = self.rows(nodeID=nodeID, limit=1, reverse=reverse, run=run)
        return next((row.key for row in rows), None)

    def keyOfText(self, text: str) -> AnyKey:
        """Return the key in a text that a user typed. Raises InvalidKey.

        A name is the text itself. A time is integer nanoseconds or ISO 8601. A value of a field is
        a number, true, false or a text, by the type of the field; then a time must be ISO 8601.
        """
        check_text("text", text, error=InvalidKey)
        return self._finder().of_text(text)

    def countTopicData(
        self,
        key: AnyKey | None = None,
        to_key: Time | None = None,
        nodeID: str | None = None,
        *,
        where: Where | None = None,
        run: RunName = None,
    ) -> int:
        """Return the number of messages that items with the same arguments reads.

        Without a condition they are counted without reading them, with ``where`` without objects.
        """
        return self._finder(nodeID, where, run).count(key, to_key)

    def removeData(
        self,
        key: AnyKey | None = None,
        to_key: Time | None = None,
        nodeID: str | None = None,
        *,
        where: Where | None = None,
        run: RunName = None,
    ) -> int:
        """Delete the messages at key, or with key <= time <= to_key; return their number.

        A key that the store returned deletes its one message; a bare time, name or value deletes
        all messages that have it. With ``where`` and ``run`` only messages that satisfy the
        condition, or of the run, are deleted; then key and to_key may be left out for all times.

        Raises:
            MessageNotFound: There is no message at key (without to_key).
            InvalidKey: Neither key, to_key, where nor run is given.
            InvalidQuery: The condition is not valid.
        """
        self._keyspace.schema.tables(fresh=True)  # so that tables just made by others are included
        return self._finder(nodeID, where, run).remove(key, to_key)

    def getArrays(
        self,
        fields: Fields,
        key: AnyKey | None = None,
        to_key: Time | None = None,
        where: Where | None = None,
        nodeID: str | None = None,
        run: RunName = None,
    ) -> dict[str, Any]:
        """Return fields as numpy arrays of equal length, in order of time.

        * Numbers and bools keep the field's type (float32 stays float32); text is str in an array
          of objects.
        * ``KEY``, times and durations are int64 nanoseconds: ``.view('datetime64[ns]')`` or
          ``.view('timedelta64[ns]')`` shows them as such. In topics with names KEY is text.
          ``secs`` and ``nsecs`` are int64, and so are computed integers if all of them fit.
        * Arrays of fixed length have two dimensions, such as (rows, 9). So have other arrays if
          every returned row has an array and all have the same length: scans of 360 ranges give
          (rows, 360), empty arrays (rows, 0). Otherwise, or without rows, they give an array of
          objects, one array a row. ``list(arrays['ranges'])`` is the same in both cases: use it in
          programs that must not depend on the lengths.
        * Arrays inside of arrays of messages give lists.

        Values that a message lacks (``ranges[5]`` of four, a field of another definition, damaged
        bytes) are masked in a numpy.ma.MaskedArray, or None in an array of objects. If definitions
        have different types for a field, the result has the smallest type that holds both exactly.

        Args:
            fields: Names of fields; None = all, and KEY.
            key, to_key, where, nodeID, run: The messages to read, as in items.

        Raises:
            InvalidQuery: A field or the condition does not fit this topic; the text shows the
                place.
            InvalidKey: key or to_key is not valid.
        """
        return as_arrays(self.gather(fields, key, to_key, where, nodeID, run))

    def toDataFrame(
        self,
        fields: Fields = None,
        key: AnyKey | None = None,
        to_key: Time | None = None,
        where: Where | None = None,
        nodeID: str | None = None,
        run: RunName = None,
    ) -> Any:
        """Return messages as a pandas.DataFrame with one column a field.

        The index ``KEY`` is their time, exact to the nanosecond, in UTC and without a zone, or
        their names. Columns are those of getArrays, except that times are datetime64[ns] without a
        zone, durations timedelta64[ns], and arrays are in cells, whatever their lengths. Missing
        values are NaN, NaT, None, or NA in a nullable type (Int32, UInt64, boolean), so that
        integers stay integers.

        Args:
            fields, key, to_key, where, nodeID, run: As in getArrays, also the errors.

        Raises:
            MissingDependency: pandas is not installed; the text says how to install it.
        """
        optional_module("pandas", "toDataFrame")  # before the messages are read
        if fields is not None:
            fields = ["KEY", *check_list("fields", fields, "['linear.x']")]
        return as_frame(self.gather(fields, key, to_key, where, nodeID, run))

    def toArrow(
        self,
        fields: Fields = None,
        key: AnyKey | None = None,
        to_key: Time | None = None,
        where: Where | None = None,
        nodeID: str | None = None,
        run: RunName = None,
    ) -> Any:
        """Return messages as a pyarrow.RecordBatchReader, which reads them lazily, batch by batch.

        The columns are KEY (timestamp in ns, UTC; in topics with names text), NODE, RUN, and one
        for each field of the message type: a message is a struct, an array a list, uint8[] binary,
        a time a timestamp in ns, and a duration an int64 of ns. A value that a message or its
        definition lacks is null. If definitions have types for a field that have nothing in common,
        its values are JSON texts. Messages come bucket by bucket, mostly but not always in the
        order of time.

        Args:
            fields: Names of columns, or of fields in them, such as 'linear.x'; None = all. A field
                in a message comes as a struct with only the fields that are named.
            key, to_key, where, nodeID, run: The messages to read, as in items.

        Raises:
            InvalidName: There is no such field.
            InvalidKey, InvalidQuery, RunNotFound: As in items.
            MissingDependency: pyarrow is not installed; the text says how to install it.
            StoreUnavailable: While batches are read: the topic was removed.
        """
        finder = self._finder(nodeID, where, run)
        names = None if fields is None else check_list("fields", fields, "['linear.x']")
        columns = None if names is None else wanted_columns(str(n).split(".") for n in names)
        schema = ArrowSchema(finder.tables, columns, names)
        batches = read_record_batches(self.name, schema, finder.batches(key, to_key))
        return schema.arrow.RecordBatchReader.from_batches(schema.schema, batches)

    def gather(
        self,
        fields: Fields,
        key: AnyKey | None,
        to_key: Time | None,
        where: Where | None,
        nodeID: str | None,
        run: RunName,
    ) -> dict[str, FieldArray]:
        """Return what getArrays returns, with the type and the missing values of each field."""
        finder = self._finder(nodeID, where, run)
        read = finder.batches(key, to_key)
        gather = partial(gather_fields, self, fields, where, read, whose=finder.whose)
        return self._keyspace.tables.naming(gather)

    def createIndex(self, field: str, progress: Progress | None = None) -> int:
        """Make an index on a field, so that conditions on it read only the matching rows.

        The topic may be recorded meanwhile, and its new rows are found in any case: a bucket that a
        writer has open is read without the index. Another call for an existing index goes on where
        the first was interrupted, and adds rows that were being written then.

        Args:
            field: Dotted path, such as 'linear.x'. For an array, or a field in an array of
                messages, the index finds the messages that contain a value. Texts over 1 KiB,
                arrays over 256 elements and NaN are not indexed; such messages are always read.
            progress: Called with the number of rows that are done, and of all rows.

        Returns:
            The number of stored messages that were indexed.

        Raises:
            InvalidName, InvalidOption: There is no such field, or it cannot be indexed.
            StoreUnavailable: Cassandra is rewriting the files of the topic (an index made meanwhile
                could miss rows), or is busy with other indexes; try again later.
            TopicNotFound: The topic was removed, or has no type yet.
        """
        check_field(field)
        return create_index(self._keyspace, self._adder, self.name, field, progress)

    def hasIndex(self, field: str) -> bool:
        """Return whether every table whose type has the field has an index on it."""
        return has_index(self.tables, check_field(field))

    def removeIndex(self, field: str) -> None:
        """Remove an index. The messages stay as they are.

        Raises:
            InvalidName: There is no such index.
            InvalidOption: The key of the messages needs the index.
            TopicNotFound: The topic was removed.
        """
        remove_index(self._keyspace, self.name, check_field(field))

    def __len__(self) -> int:
        return self.countTopicData()

    def __bool__(self) -> bool:
        return True  # so that a topic without messages is not false

    def __iter__(self) -> Iterator[tuple[Key, Any]]:
        return self.items()

    def __contains__(self, key: object) -> bool:
        return self.getRow(key) is not None

    def __dir__(self) -> list[str]:
        inner = "count countBuckets gather getRow in_order read rows tables"
        return public_names(self, inner.split())

    def __repr__(self) -> str:
        space = self._keyspace
        return topic_line(self.name, space.directory, lambda: space.tables.of_topic(self.name))

    def _repr_html_(self) -> str:
        return topic_html(self.name, self._keyspace.directory, self.tables)
