# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The tables of recorded topics: made as the settings say, or found as they are."""

from __future__ import annotations

import logging
import math
import queue
import threading
import time
from collections import deque
from dataclasses import replace
from functools import partial
from typing import Callable, Optional

from cassandra_ros.errors import (
    CassandraRosError,
    InvalidKey,
    InvalidName,
    InvalidOption,
    SchemaConflict,
    StoreUnavailable,
)
from cassandra_ros.messages.connection_header import Connection
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.recording.message_buffer import Source
from cassandra_ros.recording.topic_settings import Settings, TopicSettings
from cassandra_ros.tables.directory import Lengths
from cassandra_ros.topics.message_writer import Handle, MessageWriter

_log = logging.getLogger(__name__)

PAUSE_SEC = 1.0
MAX_CONFLICTS = 5
"""A schema lock may be held by others for a while; a table of another kind stays one."""
LAST_TRIES_SEC = 20.0
"""How long a store that does not answer is waited for when the recording ends."""


class TableMaker:
    """Gives sources their handles, one after the other, on a thread of its own.

    Args:
        connect: Makes the table of a source; raises what the store raises.
        wake: Called when it is decided what becomes of a source.
    """

    def __init__(self, connect: Callable[[Source], Handle], wake: Callable[[], None]) -> None:
        self._connect, self._wake = connect, wake
        self._asked: queue.Queue[Optional[Source]] = queue.Queue()  # None: no more
        self.decided: deque[Source] = deque()
        """Sources that have a handle now, or an error."""
        self._deadline = math.inf
        self._thread = threading.Thread(target=self._run, name="recorder-tables", daemon=True)
        self._thread.start()

    def make(self, source: Source) -> None:
        """Ask for the table of a source."""
        self._asked.put(source)

    def hurry(self) -> None:
        """Do not wait for a store that is gone for much longer."""
        self._deadline = min(self._deadline, time.monotonic() + LAST_TRIES_SEC)

    def close(self) -> None:
        """End the thread when all that was asked is decided."""
        self._asked.put(None)
        self._thread.join()

    def _run(self) -> None:
        for source in iter(self._asked.get, None):
            if self._decide(source):
                self.decided.append(source)
                self._wake()
            else:
                time.sleep(PAUSE_SEC)
                self._asked.put(source)

    def _decide(self, source: Source) -> bool:
        """Return whether it is decided what becomes of a source."""
        try:
            source.stand(self._connect(source))
            return True
        except (StoreUnavailable, SchemaConflict) as exc:
            if isinstance(exc, SchemaConflict):
                source.note_conflict()
            if source.conflicts < MAX_CONFLICTS and time.monotonic() <= self._deadline:
                if source.tell():
                    _log.warning("topic %s waits for its table: %s", source.topic, exc)
                return False
            source.fail(str(exc))
        except CassandraRosError as exc:
            source.fail(str(exc))
        except Exception as exc:  # noqa: BLE001 - our mistake: counted, the other topics go on
            _log.exception("the table of topic %s could not be made", source.topic)
            source.fail(f"internal error: {type(exc).__name__}: {exc}")
        _log.error("topic %s cannot be recorded: %s", source.topic, source.error)
        return True


def connect(
    writer: MessageWriter, connection: Connection, lengths: Lengths, settings: Settings
) -> Handle:
    """Make ready for the messages of a connection; raises as MessageWriter.connect does.

    A key field that the type has not is left out with an error, and so is format packed where the
    key is no time: recording goes before order.
    """
    wanted = settings.of(connection.topic)
    try:
        if wanted == settings.default and not (wanted.key_part or wanted.index):
            return _open(writer, connection, lengths)
        handle = _connect(writer, connection, lengths, wanted)
    except InvalidOption as exc:
        kept = writer.format_of(connection)
        _log.error("topic %s is kept in format %s: %s", connection.topic, kept, exc)
        wanted = replace(wanted, format=kept)
        handle = _connect(writer, connection, lengths, wanted)
    for text in differences(wanted, handle.table.metadata):
        _log.warning("topic %s %s", connection.topic, text)
    return handle


def _connect(
    writer: MessageWriter, connection: Connection, lengths: Lengths, wanted: TopicSettings
) -> Handle:
    open_as = partial(_open, writer, connection, lengths, format=wanted.format)
    try:
        return open_as(like=_like(wanted))
    except (InvalidKey, InvalidName) as exc:
        _log.error("topic %s is kept by time of reception: %s", connection.topic, exc)
        return open_as(like=_like(replace(wanted, key_part="")))


def _open(
    writer: MessageWriter,
    connection: Connection,
    lengths: Lengths,
    format: Optional[str] = None,
    like: Optional[TopicMetadata] = None,
) -> Handle:
    bucket_ns, span_ns, large = lengths
    return writer.connect(
        connection, bucket_ns, span_ns=span_ns, large=large, format=format, like=like
    )


def differences(wanted: TopicSettings, stored: TopicMetadata) -> list[str]:
    """Say in which ways a stored topic is not as the settings want it."""
    found = []
    if wanted.ttl and wanted.ttl != stored.ttl:
        found.append(f"was made with a ttl of {stored.ttl} s, not {wanted.ttl} s (0 = never)")
    if wanted.key_part and wanted.key_part != stored.key_part:
        key = stored.key_part or stored.key_format
        found.append(f"was made with the key {key}, not {wanted.key_part}")
    if wanted.index and stored.packed:
        found.append("takes no index: it is packed, and conditions use the bounds of its blocks")
    for name in () if stored.packed else wanted.index:
        if name not in stored.indexes:
            found.append(
                f"has no index on {name}; make it with: rosrun cassandra_ros cassandra_bag index "
                f"{stored.topic} {name}"
            )
    return found


def _like(wanted: TopicSettings) -> TopicMetadata:
    return TopicMetadata(
        "",
        "",
        "",
        "",
        0,
        ttl=wanted.ttl,
        key_format="msg_part" if wanted.key_part else "",
        key_part=wanted.key_part,
        indexes=dict.fromkeys(wanted.index, ""),
    )
