# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The tree of errors of the package.

* CassandraRosError
  - ConnectionFailed
    + LoginFailed, CertificateRefused, TlsMismatch
  - StoreUnavailable, WriteFailed, AccessDenied, KeyspaceNotFound, SchemaConflict,
    UnsupportedSchema, TopicExists, ClockNotSet, NotConfirmed, ServerError, DownloadFailed,
    SpoolError
  - TopicNotFound, MessageNotFound, RunNotFound, EventNotFound (also a KeyError)
    + BagNotFound, a RunNotFound (also a FileNotFoundError)
  - TransformException
    + LookupException, ConnectivityException, ExtrapolationException
  - TypeMismatch, UnknownFormat, UnknownEncoding, InvalidKey, InvalidName, InvalidOption,
    InvalidQuery, InvalidExpression, AnswerTooLarge, DefinitionError, CorruptMessage, BagError (also
    a ValueError)
    + BagUnindexed, BagTooLarge, both a BagError
  - MissingDependency (also an ImportError)

Each error text is a complete sentence: what failed, on which topic, why, and what to do.
"""

from __future__ import annotations

import errno
import os

DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a disk that is full, a quota that is used up, and a file of the maximum size."""


def cannot_write(where: str | os.PathLike[str], cause: OSError) -> str:
    """Return the text of an error about a file or an output that cannot be written."""
    remedy = "free some space there, or write" if cause.errno in DISK_FULL else "write"
    return f"{os.fspath(where)} cannot be written: {cause.strerror or cause}; {remedy} elsewhere"


class CassandraRosError(Exception):
    """Base class of all errors that this package raises."""

    def __str__(self) -> str:
        # KeyError would show the text in quotes, with line breaks escaped.
        return str(self.args[0]) if self.args else type(self).__name__


class ConnectionFailed(CassandraRosError):
    """No Cassandra or ROS master answers at the address, it refuses, or the connection was closed.

    Attributes:
        refused: Whether a server answers but refuses this user; then waiting does not help.

    Args:
        text: The text.
        refused: None = as the class says.
    """

    refused = False

    def __init__(self, text: str = "", refused: bool | None = None) -> None:
        super().__init__(text)
        if refused is not None:
            self.refused = refused


class LoginFailed(ConnectionFailed):
    """The cluster requires a login, and user name or password are missing or wrong."""

    refused = True


class CertificateRefused(ConnectionFailed):
    """The server's certificate, or ours, has expired or is not trusted by the other side."""

    refused = True


class TlsMismatch(ConnectionFailed):
    """Only one side of the connection uses TLS."""

    refused = True


class NotConfirmed(CassandraRosError):
    """The user did not confirm a deletion, or there was no terminal to ask on."""


class AccessDenied(CassandraRosError):
    """The user who is logged in lacks a right.

    Attributes:
        right: Name of the right in CQL, as SELECT or MODIFY; '' = the server does not name it.
    """

    def __init__(self, text: str = "", right: str = "") -> None:
        super().__init__(text)
        self.right = right


class StoreUnavailable(CassandraRosError):
    """The connected Cassandra did not answer in time, or too few of its nodes are up."""


class WriteFailed(CassandraRosError):
    """Rows could not be stored; the text names the topic, the number and the cause.

    Attributes:
        first_ns, last_ns: Receive times of the first and the last of the rows, ns; 0 = unknown.
    """

    def __init__(self, text: str = "", first_ns: int = 0, last_ns: int = 0) -> None:
        super().__init__(text)
        self.first_ns = first_ns
        self.last_ns = last_ns


class KeyspaceNotFound(CassandraRosError):
    """No keyspace is connected, or the keyspace does not exist (any more)."""


class SchemaConflict(CassandraRosError):
    """A table has other properties than expected, or the schema lock cannot be acquired."""


class UnsupportedSchema(CassandraRosError):
    """A table has another schema version than the one that this release reads and writes."""


class TopicNotFound(CassandraRosError, KeyError):
    """No stored topic has this name; the text gives the nearest ones."""


class TopicExists(CassandraRosError):
    """The topic, or the bag, is stored already: with other properties, or under the new name."""


class MessageNotFound(CassandraRosError, KeyError):
    """There is no message with this key, or in this time range."""


class RunNotFound(CassandraRosError, KeyError):
    """No recording or import has this name or writer id; the text gives the nearest names."""


class EventNotFound(CassandraRosError, KeyError):
    """No stored event has this name or key; the text gives the nearest names."""


class BagNotFound(RunNotFound, FileNotFoundError):
    """No stored run has the name or path that was given to class Bag. As in rosbag, an OSError."""


class TransformException(CassandraRosError):
    """There is no transform between two frames. The exception of tf2 is the cause of this one.

    This class and its subclasses are named after those of tf2, but do not derive from them.
    """


class LookupException(TransformException):
    """A frame is in no recorded transform, or the frames form a loop."""


class ConnectivityException(TransformException):
    """Nothing connects the two frames at that time."""


class ExtrapolationException(TransformException):
    """The time lies before the first or after the last transform of a frame."""


class TypeMismatch(CassandraRosError, ValueError):
    """A message has another type than its topic. It was not stored."""


class UnknownFormat(CassandraRosError, ValueError):
    """No storage format has this name."""


class UnknownEncoding(CassandraRosError, ValueError):
    """The pixel encoding of an image is unknown, so no picture can be made of it."""


class InvalidKey(CassandraRosError, ValueError):
    """A time, a key or a cursor is not valid, or a topic cannot have these keys."""


class InvalidName(CassandraRosError, ValueError):
    """A name of a topic, robot, run, field or label cannot be used, or a value stored with it."""


class InvalidOption(CassandraRosError, ValueError):
    """An option or an argument has a value that it cannot have; the text says what to give."""


class InvalidExpression(CassandraRosError, ValueError):
    """A condition cannot be evaluated on the messages of its topic."""


class InvalidQuery(CassandraRosError, ValueError):
    """A statement cannot be parsed or names something unknown.

    Args:
        statement: The statement as it was given.
        position: Index of the first wrong character, 0 to len(statement).
        reason: One sentence: the error, and a suggestion if there is one.
    """

    def __init__(self, statement: str, position: int, reason: str) -> None:
        self.statement = statement
        self.position = max(0, min(position, len(statement)))
        self.reason = reason
        start = statement.rfind("\n", 0, self.position) + 1
        end = statement.find("\n", self.position)
        line = statement[start : end if end >= 0 else len(statement)]
        # Tabs stay, so that the caret is under the character however wide a terminal makes them.
        before = statement[start : self.position]
        caret = "".join("\t" if c == "\t" else " " for c in before) + "^"
        super().__init__(f"{reason}\n  {line}\n  {caret}")

    def __reduce__(self) -> tuple[object, ...]:
        # Otherwise pickle would call the constructor with the text that is shown.
        return type(self), (self.statement, self.position, self.reason), vars(self)


class AnswerTooLarge(CassandraRosError, ValueError):
    """An answer, or a row or message in it, is larger than the maximum."""


class DefinitionError(CassandraRosError, ValueError):
    """A message definition is malformed or hostile, or does not match its md5sum."""


class CorruptMessage(CassandraRosError, ValueError):
    """Stored or received bytes are not a valid message of their type."""


class BagError(CassandraRosError, ValueError):
    """A bag or an MCAP cannot be read to its end, or cannot be written."""


class BagUnindexed(BagError):
    """A bag or an MCAP has no index: it is still being written, or was cut short."""


class BagTooLarge(BagError):
    """A bag or an MCAP would unpack to too many bytes; it may be made to fill the memory."""


class SpoolError(CassandraRosError):
    """A folder or a file of the spool cannot be used; the text names it."""


class ClockNotSet(CassandraRosError):
    """Simulated time is in use and no /clock message has come yet."""


class ServerError(CassandraRosError):
    """Something on the local Cassandra failed: its installation, a start, a stop, a repair."""


class DownloadFailed(CassandraRosError):
    """A file could not be downloaded, or its content is not the expected one."""


class MissingDependency(CassandraRosError, ImportError):
    """An optional Python package that is needed is not installed."""
