# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class RosCassandra: topics in a Cassandra cluster (paper section 3, listing 1)."""

from __future__ import annotations

from typing import Any, Iterable, Mapping, Optional, Sequence

from cassandra_ros.arguments import (
    MAX_TOPIC_BYTES,
    check_fields,
    check_integer,
    check_key_format,
    check_new_topic,
    check_node,
    check_seconds,
    check_text,
    check_topics,
    check_ttl,
    check_user_keys,
    check_writer_id,
)
from cassandra_ros.errors import InvalidKey, InvalidName, InvalidOption
from cassandra_ros.formats.table import DEFAULT_FORMAT
from cassandra_ros.keys import newWriterId
from cassandra_ros.messages.connection import Connection
from cassandra_ros.store.registry import Run
from cassandra_ros.store.write_stats import LossCallback
from cassandra_ros.store.writer import RowWriter
from cassandra_ros.topics.across import AcrossTopics
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.message_writer import MessageWriter
from cassandra_ros.topics.totals import TopicInfo
from cassandra_ros.topics.wish import Wish


class RosCassandra(AcrossTopics):
    """Keeps ROS topics in a Cassandra cluster. Safe to share between threads.

    Args:
        host: One address, or several divided by commas; None = CASSANDRA_ROS_HOST of the
            environment, else 127.0.0.1.
        port: CQL port, 1 to 65535; None = CASSANDRA_ROS_PORT, else 9042.
        keyspace: Connected at once when given, or named by CASSANDRA_ROS_KEYSPACE; one
            that is missing is made by what first writes.
        clock: Returns the time for messages without a key; default rospy's where a node runs
            in this process, else wall clock.
        consistency: Name of a Cassandra consistency level.
        username, password, ssl_context: Where the cluster asks for them.

    Raises:
        ConnectionFailed: Nobody answers there; the text says how to start a server.
        InvalidOption: The port cannot be one.
    """

    # ---------------------------------------------------------------- topics

    def addTopic(
        self,
        topic: str,
        format: str = DEFAULT_FORMAT,
        *,
        msg_type: Optional[str] = None,
        nodeID: str = "",
        ttl: int = 0,
        comment: str = "",
        key_format: Optional[str] = None,
        key_part: str = "",
        metadata: Optional[Mapping[str, Any]] = None,
        index: Sequence[str] = (),
    ) -> CassandraTopic:
        """Make a topic, or find it where it is stored already in this format.

        Args:
            topic: Its name, kept as it is given.
            format: Name of a storage format.
            msg_type: 'pkg/Name' of an installed type; None = the type that the ROS master
                knows, else that of the first message.
            nodeID: The entity (robot) that produces its messages.
            ttl: Seconds until a message expires, 0 to MAX_TTL_SEC (some 18 years); 0 = never.
            comment: Free text.
            key_format: What finds a message: 'time' (when it was received), 'msg_part' (a field
                of it), 'hash' (its content) or 'manual' (a name that you give); None = as the
                topic is stored, else 'time'. See CassandraTopic.
            key_part: The field of 'msg_part', as 'header.stamp'.
            metadata: Keys of your own, for getMeta; values that JSON gives back as they are.
            index: Fields that are to have an index, as 'linear.x'; see createIndex. Those that a
                stored topic lacks are made.

        Raises:
            TopicExists: It is stored with another type, key_format or ttl than given. (The comment
                and metadata of a stored topic stay as they are: setMeta changes them.)
            InvalidKey: The type has no such field as key_part.
            InvalidName: It has no such field as one of index, or topic, nodeID or a key of
                metadata cannot be a name.
            InvalidOption: comment is no text, or ttl no number of seconds.
            UnknownFormat, DefinitionError.
        """
        if msg_type is not None:
            check_text("msg_type", msg_type, error=InvalidName, wanted="one like 'std_msgs/String'")
        wish = Wish(
            format=format,
            nodeID=check_node(nodeID),
            ttl=check_ttl(ttl),
            comment=check_text("comment", comment),
            key_format=check_key_format(key_format, key_part),
            key_part=key_part,
            user=check_user_keys({} if metadata is None else metadata),
            index=check_fields("index", index),
        )
        return self._topics.add(check_new_topic(topic), wish, msg_type)

    def getTopic(self, topic: str) -> CassandraTopic:
        """Return a topic by its name, with or without the leading slash.

        Raises:
            TopicNotFound: There is none; the text gives the nearest names.
            InvalidName: It is no text.
        """
        return self._topics.get(topic)

    def existTopic(self, topic: str) -> bool:
        """Say whether getTopic would find the topic."""
        return self._topics.exists(topic)

    def getAllTopics(self, pattern: Optional[str] = None) -> list[CassandraTopic]:
        """Return all topics, sorted by name.

        Args:
            pattern: Only those whose whole name matches this regular expression.

        Raises:
            InvalidName: The pattern is not a regular expression.
        """
        if pattern is not None:
            check_text("pattern", pattern, error=InvalidName, wanted="a regular expression")
        return self._topics.all(pattern)

    def removeTopic(self, topic: str) -> None:
        """Drop a topic with all its messages.

        Raises:
            TopicNotFound: There is none.
        """
        self._topics.remove(topic)

    def truncateTopic(self, topic: str) -> None:
        """Remove all messages of a topic; the topic and its metadata stay.

        Raises:
            TopicNotFound: There is none.
        """
        self._topics.truncate(topic)

    def renameTopic(self, topic: str, new_name: str) -> None:
        """Give a topic another name. Its messages stay where they are: this takes no time.

        A recorder that is writing the topic goes on into the renamed one for the publishers that
        it knows; the next one, or the next recording, makes the topic anew.

        Raises:
            TopicNotFound: There is none.
            TopicExists: A topic has the new name already, or it is the topic's own, with or without
                the leading slash.
            InvalidName: The new name is not one.
        """
        self._topics.rename(topic, check_new_topic(new_name))

    # ---------------------------------------------------------------- messages of many topics

    def messageWriter(
        self,
        *,
        writer_id: Optional[int] = None,
        format: str = DEFAULT_FORMAT,
        nodeID: str = "",
        ttl: int = 0,
        linger_sec: float = 0.2,
        give_up_after_sec: float = 60.0,
        run: Optional[Run] = None,
        on_loss: Optional[LossCallback] = None,
    ) -> MessageWriter:
        """Make a writer of serialised messages; close it.

        Args:
            writer_id: Repeats of the same import give the same; None = a random one.
            format: For topics that are not stored yet.
            nodeID: The entity that produces the messages.
            ttl: Seconds until a message expires; 0 = never.
            linger_sec: How long a message may wait to be sent together with others.
            give_up_after_sec: How long the writing of a message is tried.
            run: Description of the recording or import, kept in the store.
            on_loss: Called with (topic, messages, error) for what was given up; without it
                the writer raises.

        Raises:
            InvalidName, InvalidKey, InvalidOption, UnknownFormat: An argument cannot be one.
        """
        parts = self.parts
        number = newWriterId() if writer_id is None else check_writer_id(writer_id)
        timing: Any = {
            "linger_sec": check_seconds("linger_sec", linger_sec),
            "give_up_after_sec": check_seconds("give_up_after_sec", give_up_after_sec),
        }
        if run is not None and not isinstance(run, Run):
            raise InvalidOption(f"run={run!r:.80} describes no run: give a store.registry.Run")
        node, ttl_sec = check_node(nodeID), check_ttl(ttl)
        place = (parts.cassandra, parts.schema, parts.directory)
        rows = RowWriter(*place, number, on_loss=on_loss, **timing)
        return MessageWriter(
            *(parts, rows, number),
            format=format,
            nodeID=node,
            ttl=ttl_sec,
            run=run,
            on_loss=on_loss,
        )

    def connection(self, table: str, conn: int) -> Connection:
        """Return the connection that a row of a table names."""
        check_text("table", table, MAX_TOPIC_BYTES, InvalidKey, "row.table.name")
        check_integer("conn", conn, -(2**63), 2**63 - 1, InvalidKey)
        return self.parts.connections.get(table, conn)

    def info(self, topics: Optional[Iterable[str]] = None) -> list[TopicInfo]:
        """Describe what is stored: counts, sizes and times by topic, table and node."""
        return self.parts.totals.info(self._tables(check_topics(topics)))

    def runs(self) -> list[Run]:
        """List the recordings and imports of the keyspace."""
        return self.parts.registry.runs()
