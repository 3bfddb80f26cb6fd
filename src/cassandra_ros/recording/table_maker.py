# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The tables of recorded topics: made as the settings say, or used as they exist."""

from __future__ import annotations

import logging
import math
import queue
import threading
import time
from collections import deque
from dataclasses import replace
from functools import partial
from typing import Callable, Sequence

from cassandra_ros.errors import (
    CassandraRosError,
    InvalidKey,
    InvalidName,
    InvalidOption,
    SchemaConflict,
    StoreUnavailable,
    WriteFailed,
)
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.recording.message_buffer import MessageSource
from cassandra_ros.recording.topic_settings import RecordingSettings, TopicSettings
from cassandra_ros.store.tables.lengths import Lengths
from cassandra_ros.topics.message_writer import Asked, Handle, MessageWriter

_log = logging.getLogger(__name__)

PAUSE_SEC = 1.0
"""Pause before the next attempt to make a table, s."""
MAX_CONFLICTS = 5
"""Maximum number of attempts that end with a schema conflict.

The schema lock may be held by other clients for a while; a table of another kind stays a conflict.
"""
TOGETHER = 32
"""Maximum number of tables that are made under one lock: the messages of all of them wait until the
last one is made."""
LAST_TRIES_SEC = 20.0
"""How long tables are still tried to be made after the recording has ended, s."""


class TableMaker:
    """A thread that makes the tables of message sources, those that wait for it together.

    Args:
        prepare: Makes the tables of several sources together, as far as their settings permit;
            raises what the store raises.
        connect: Makes the table of a source, if it is missing; raises what the store raises.
        wake: Called when a source has got its handle or an error.

    All three are called on the thread.
    """

    def __init__(
        self,
        prepare: Callable[[Sequence[MessageSource]], None],
        connect: Callable[[MessageSource], Handle],
        wake: Callable[[], None],
    ) -> None:
        self._prepare, self._connect, self._wake = prepare, connect, wake
        self._asked: queue.Queue[MessageSource | None] = queue.Queue()  # None: no more
        self.decided: deque[MessageSource] = deque()
        """Sources that have got a handle or an error; the writing thread removes them."""
        self._deadline = math.inf
        """Monotonic time after which a failed attempt is the last one, s; 0 = the tables are not
        needed any more."""
        self._thread = threading.Thread(target=self._run, name="recorder-tables", daemon=True)
        self._thread.start()

    def make(self, source: MessageSource) -> None:
        """Queue a source for its table."""
        self._asked.put(source)

    def hurry(self) -> None:
        """Give up after LAST_TRIES_SEC if the store does not answer."""
        self._deadline = min(self._deadline, time.monotonic() + LAST_TRIES_SEC)

    def close(self, *, wait: bool = True) -> None:
        """End the thread after the last queued source; without ``wait`` later, by itself.

        No source may be queued after it. With ``wait`` each source that was queued must have got
        its handle or error: one that is tried again is queued again.
        """
        if not wait:
            self._deadline = 0.0
        self._asked.put(None)
        if wait:
            self._thread.join()

    def _run(self) -> None:
        """Make tables until ``close``; those that are asked for meanwhile are made together."""
        ended = False
        while not ended:
            sources = [self._asked.get()]
            while sources[-1] is not None and len(sources) < TOGETHER and not self._asked.empty():
                sources.append(self._asked.get())  # only this thread gets
            ended = sources[-1] is None
            self._make([source for source in sources if source is not None])

    def _make(self, sources: Sequence[MessageSource]) -> None:
        """Make the tables of sources; queue those again that are to be tried again."""
        if len(sources) > 1:
            self._make_together(sources)
        for source in sources:
            if self._decide(source):
                self.decided.append(source)
                self._wake()
            else:
                time.sleep(PAUSE_SEC)
                self._asked.put(source)

    def _make_together(self, sources: Sequence[MessageSource]) -> None:
        """Make tables under one lock. If that fails, ``_decide`` finds the error of each source."""
        try:
            self._prepare(sources)
        except CassandraRosError as exc:
            _log.debug("the tables of %d topics are made one by one: %s", len(sources), exc)
        except Exception:  # noqa: BLE001 - our mistake: each table is made by itself
            _log.exception("the tables of %d topics could not be made together", len(sources))

    def _decide(self, source: MessageSource) -> bool:
        """Try to make the table of a source; return whether it has got a handle or an error."""
        try:
            source.handle = self._connect(source)
            return True
        except (StoreUnavailable, SchemaConflict, WriteFailed) as exc:
            if not isinstance(exc, StoreUnavailable):
                source.conflicts += 1
            if source.conflicts < MAX_CONFLICTS and time.monotonic() <= self._deadline:
                if not source.told:
                    source.told = True
                    _log.warning("topic %s waits for its table: %s", source.topic, exc)
                return False
            source.error = str(exc)
        except CassandraRosError as exc:
            source.error = str(exc)
        except Exception as exc:  # noqa: BLE001 - our mistake: counted, the other topics go on
            _log.exception("the table of topic %s could not be made", source.topic)
            source.error = f"internal error: {type(exc).__name__}: {exc}"
        if self._deadline:  # else its messages are in the spool, and the connection is closed
            _log.error("topic %s cannot be recorded: %s", source.topic, source.error)
        return True


def connect(
    writer: MessageWriter, connection: Connection, lengths: Lengths, settings: RecordingSettings
) -> Handle:
    """Make the table of a connection, as its settings say, if it is missing. Return a handle of it.

    Raises what MessageWriter.connect raises.

    Settings that do not fit are left out with an error in the log, so that the topic is recorded in
    any case: a key field that the type does not have, or format packed with a key that is not a
    time.
    """
    topic_settings = settings.of(connection.topic)
    try:
        if topic_settings == settings.default and not (
            topic_settings.key_part or topic_settings.index
        ):
            return _open(writer, connection, lengths)
        handle = _connect(writer, connection, lengths, topic_settings)
    except InvalidOption as exc:
        usable_format = writer.format_of(connection)
        _log.error("topic %s is kept in format %s: %s", connection.topic, usable_format, exc)
        topic_settings = replace(topic_settings, format=usable_format)
        handle = _connect(writer, connection, lengths, topic_settings)
    for text in differences(topic_settings, handle.table.metadata):
        _log.warning("topic %s %s", connection.topic, text)
    return handle


def make_together(
    writer: MessageWriter, sources: Sequence[MessageSource], settings: RecordingSettings
) -> None:
    """Make the tables of several sources, except those with a key field or an index.

    Raises what MessageWriter.make_tables does.
    """
    tables = []
    for source in sources:
        topic_settings = settings.of(source.connection.topic)
        if not (topic_settings.key_part or topic_settings.index):
            like = None if topic_settings == settings.default else _metadata_like(topic_settings)
            tables.append(Asked(source.connection, *source.lengths(), topic_settings.format, like))
    writer.make_tables(tables)


def _connect(
    writer: MessageWriter, connection: Connection, lengths: Lengths, settings: TopicSettings
) -> Handle:
    """Make the table as the settings say, or by time of reception if their key does not fit."""
    open_as = partial(_open, writer, connection, lengths, format=settings.format)
    try:
        return open_as(like=_metadata_like(settings))
    except (InvalidKey, InvalidName) as exc:
        _log.error("topic %s is kept by time of reception: %s", connection.topic, exc)
        return open_as(like=_metadata_like(replace(settings, key_part="")))


def _open(
    writer: MessageWriter,
    connection: Connection,
    lengths: Lengths,
    format: str | None = None,
    like: TopicMetadata | None = None,
) -> Handle:
    """Return a handle; format and like as for MessageWriter.connect."""
    bucket_ns, span_ns, large = lengths
    return writer.connect(
        connection, bucket_ns, span_ns=span_ns, large=large, format=format, like=like
    )


def differences(settings: TopicSettings, stored: TopicMetadata) -> list[str]:
    """Return the differences between a stored topic and its settings, as texts."""
    texts = []
    if settings.ttl and settings.ttl != stored.ttl:
        texts.append(f"was made with a ttl of {stored.ttl} s, not {settings.ttl} s (0 = never)")
    if settings.key_part and settings.key_part != stored.key_part:
        key = stored.key_part or stored.key_format
        texts.append(f"was made with the key {key}, not {settings.key_part}")
    if settings.index and not stored.takes_index:
        texts.append("takes no index: it is packed, and conditions use the bounds of its blocks")
    for name in settings.index if stored.takes_index else ():
        if name not in stored.indexes:
            texts.append(
                f"has no index on {name}; make it with: cassandra_bag index {stored.topic} {name}"
            )
    return texts


def _metadata_like(settings: TopicSettings) -> TopicMetadata:
    """Return settings in the form of metadata of a former table, see MessageWriter.connect.

    Topic, type and definition come from the connection.
    """
    return TopicMetadata(
        "",
        "",
        "",
        "",
        0,
        ttl=settings.ttl,
        key_format="msg_part" if settings.key_part else "",
        key_part=settings.key_part,
        indexes=dict.fromkeys(settings.index, ""),
    )
