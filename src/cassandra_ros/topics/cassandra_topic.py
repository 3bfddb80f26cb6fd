# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class CassandraTopic: the messages of one topic (paper section 3, figure 1)."""

from __future__ import annotations

from typing import Any, Iterator, Optional

from cassandra_ros.arguments import check_message_name, check_node
from cassandra_ros.errors import InvalidKey, MessageNotFound, TypeMismatch
from cassandra_ros.messages.definition import Definition, definitionOf
from cassandra_ros.messages.stamps import toNs
from cassandra_ros.topics.adder import Adder
from cassandra_ros.topics.filtering import Where
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.stored_row import Key
from cassandra_ros.topics.topic_arrays import TopicArrays
from cassandra_ros.topics.topic_indexes import TopicIndexes, checkField
from cassandra_ros.topics.topic_rows import AnyKey, Time
from cassandra_ros.topics.topic_table import TopicTable
from cassandra_ros.topics.wish import Wish

_REQUIRED: Any = object()


class CassandraTopic(TopicIndexes, TopicArrays):
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

    Attributes:
        name: The topic's name as it is stored.
    """

    def __init__(self, keyspace: Keyspace, adder: Adder, name: str, wish: Wish) -> None:
        super().__init__(keyspace, name, wish)
        self._adder = adder

    # ---------------------------------------------------------------- adding

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
        node = self._wish.nodeID if nodeID is None else check_node(nodeID)
        table = self._tableFor(msg)
        kind = table.metadata.key_format
        if kind == "manual":
            name = check_message_name(self.name, key)
            return self._adder.add(table, msg, self._adder.now(), node, name)
        if key is not None and kind != "time":
            raise InvalidKey(
                f"the key of a message of topic {self.name} comes from the message itself "
                f"(key_format {kind}): leave key out"
            )
        return self._adder.add(table, msg, self._adder.now() if key is None else toNs(key), node)

    def makeTable(self, definition: Definition) -> TopicTable:
        """Find or make the table for messages of this definition, in the topic's format."""
        for field in self._wish.index:
            checkField(definition, field)
        table = self._keyspace.makeTable(self._wish.metadata(self.name, definition), definition)
        if self._wish.asked:
            self._wish.check(table.metadata, None)  # another client may have been quicker
        return table

    def _tableFor(self, msg: Any) -> TopicTable:
        if not hasattr(type(msg), "_md5sum"):  # nor has a class, in place of its object
            raise TypeMismatch(
                f"{msg!r:.80} is no message: give topic {self.name} a message object, as "
                "std_msgs.msg.String(data='x'); nothing was stored"
            )
        definition = definitionOf(type(msg))
        tables = self.tables
        fitting = [t for t in tables if t.metadata.md5sum == definition.md5sum]
        wished = [t for t in fitting if t.metadata.format == self._wish.format]
        if wished or (fitting and not self._wish.asked):
            return (wished or fitting)[0]
        if tables and not fitting:
            stored = tables[0].metadata
            raise TypeMismatch(
                f"topic {self.name} holds {stored.msg_type} [{stored.md5sum}], the message is "
                f"{definition.type} [{definition.md5sum}]; nothing was stored"
            )
        return self.makeTable(definition)

    # ---------------------------------------------------------------- getting

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
    ) -> Any:
        """Return one message, or those of a stretch of time.

        Args:
            key: A time, or what else is the topic's key; with to_key the lower end.
            to_key: The upper end, where keys are times. Both ends are included.
            nearest: 'before' (at or before key), 'after' (at or after) or 'either'.
            default: Returned instead of raising when there is no message at key.
            nodeID: Only messages of this node; None = of all.
            limit: At most so many messages of a stretch.
            where: Only messages that satisfy this condition: what stands behind WHERE in CQL, as
                ``'linear.x > 0.5'``, or a pair of it and its parameters. One on the elements of
                an array of messages is satisfied when one element does. It holds besides key,
                nearest, nodeID and limit: the nearest, or the first few, of those that satisfy it.

        Returns:
            With to_key a list in the order of time, else one message: of several with the same
            stamp (also the nearest one) or value the first, of several with the same name the
            newest. Equal stamps are ordered by nodeID, then by the recording, import or client
            that wrote them, and of one of these by their arrival.

        Raises:
            MessageNotFound: No message at key (also a KeyError).
            InvalidKey: A key cannot be one, or the topic's keys have no order.
            InvalidQuery: where is no condition; shows it with a caret under the spot.
        """
        if to_key is not None:
            stretch = self._finder(nodeID, where).many(key, to_key, limit=limit)
            return [row.message() for row in stretch]
        if key is None:
            raise InvalidKey(
                "getData needs a key (and to_key for a stretch of time); items() walks "
                f"through all messages of topic {self.name}, also through those with where="
            )
        finder = self._finder(nodeID, where)
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
    ) -> Iterator[tuple[Key, Any]]:
        """Walk lazily through (key, message) in the order of time, any number of them.

        With key_format ``manual`` and ``hash`` the keys of all messages are listed first, by a
        scan of the whole table: slow where there are millions.

        Args:
            key: Lower end, included; None = the first message. Where keys are names or values:
                all messages of this one.
            to_key: Upper end, included; None = the last message.
            nodeID: Only messages of this node; None = of all.
            limit: At most so many.
            reverse: Newest first.
            where: Only messages that satisfy this condition, as getData takes it.

        Raises:
            InvalidKey, InvalidQuery.
        """
        rows = self._finder(nodeID, where).many(key, to_key, limit=limit, reverse=reverse)
        return ((row.key, row.message()) for row in rows)

    # ---------------------------------------------------------------- counting and removing

    def countTopicData(
        self,
        key: Optional[AnyKey] = None,
        to_key: Optional[Time] = None,
        nodeID: Optional[str] = None,
        *,
        where: Optional[Where] = None,
    ) -> int:
        """Count the messages that items(key, to_key, where=where) walks through.

        By time alone they are counted without reading them, with where= without making objects.
        """
        return self._finder(nodeID, where).count(key, to_key)

    def removeData(
        self,
        key: Optional[AnyKey] = None,
        to_key: Optional[Time] = None,
        nodeID: Optional[str] = None,
        *,
        where: Optional[Where] = None,
    ) -> int:
        """Delete the messages at key, or with key <= time <= to_key; return how many.

        A key that the store returned means its one message, a bare time, name or value all that
        have it. With where= only those that satisfy the condition are deleted; without key and
        to_key that is each one of the topic, of whatever time.

        Raises:
            MessageNotFound: There is no message at key (without to_key).
            InvalidKey: Neither key, to_key nor where is given.
            InvalidQuery: where is no condition.
        """
        return self._finder(nodeID, where).remove(key, to_key)

    def __repr__(self) -> str:
        return f"CassandraTopic({self.name!r})"
