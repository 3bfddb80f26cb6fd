# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The one tree of errors of the package.

* CassandraRosError
  - ConnectionFailed
    + LoginFailed, CertificateRefused, TlsMismatch
  - StoreUnavailable, WriteFailed, AccessDenied, KeyspaceNotFound, SchemaConflict,
    UnsupportedSchema, TopicExists, ClockNotSet, NotConfirmed, ServerError, DownloadFailed
  - TopicNotFound, MessageNotFound, RunNotFound (also a KeyError)
    + BagNotFound, a RunNotFound (also a FileNotFoundError)
  - TransformException
    + LookupException, ConnectivityException, ExtrapolationException
  - TypeMismatch, UnknownFormat, UnknownEncoding, InvalidKey, InvalidName, InvalidOption,
    InvalidQuery, InvalidExpression, AnswerTooLarge, DefinitionError, CorruptMessage,
    BagError (also a ValueError)
    + BagUnindexed and BagTooLarge, both a BagError
  - MissingDependency (also an ImportError)

Each text is a finished sentence: what failed, on which topic, why, and what to do.
"""

from __future__ import annotations


class CassandraRosError(Exception):
    """Base of everything that this package raises on purpose."""

    def __str__(self) -> str:
        # KeyError would show the text in quotes and with \n escaped.
        return str(self.args[0]) if self.args else type(self).__name__


class ConnectionFailed(CassandraRosError):
    """No Cassandra or ROS master answers at the given address, or refuses; or it was closed.

    Attributes:
        refused: It is there and refuses this user: waiting does not help.
    """

    refused = False

    def __init__(self, text: str = "", refused: bool | None = None) -> None:
        super().__init__(text)
        if refused is not None:
            self.refused = refused


class LoginFailed(ConnectionFailed):
    """The cluster asks for a user name and password, and none was given or they are wrong."""

    refused = True


class CertificateRefused(ConnectionFailed):
    """A certificate is expired, or none that the other side trusts: the server's or ours."""

    refused = True


class TlsMismatch(ConnectionFailed):
    """One side speaks TLS and the other one does not."""

    refused = True


class NotConfirmed(CassandraRosError):
    """A person did not agree to what cannot be undone, or nobody was there to be asked."""


class AccessDenied(CassandraRosError):
    """The user who is logged in lacks a right.

    Attributes:
        right: Its name in CQL, as SELECT or MODIFY; '' where the server does not tell it.
    """

    def __init__(self, text: str = "", right: str = "") -> None:
        super().__init__(text)
        self.right = right


class StoreUnavailable(CassandraRosError):
    """A connected Cassandra did not answer in time, or too few replicas are up."""


class WriteFailed(CassandraRosError):
    """Rows could not be stored; the text names the topic, the number and the cause.

    Attributes:
        first_ns, last_ns: When the first and the last of them came, ns; 0 = it is not known here.
    """

    def __init__(self, text: str = "", first_ns: int = 0, last_ns: int = 0) -> None:
        super().__init__(text)
        self.first_ns = first_ns
        self.last_ns = last_ns


class KeyspaceNotFound(CassandraRosError):
    """No keyspace is connected, or the one that was is gone."""


class SchemaConflict(CassandraRosError):
    """A table differs from what was asked for, or the schema lock cannot be had."""


class UnsupportedSchema(CassandraRosError):
    """A table was written by a newer release of this package."""


class TopicNotFound(CassandraRosError, KeyError):
    """No stored topic has this name; the text gives the nearest ones."""


class TopicExists(CassandraRosError):
    """The topic is stored already with other properties."""


class MessageNotFound(CassandraRosError, KeyError):
    """No message lies at this key."""


class RunNotFound(CassandraRosError, KeyError):
    """No recording or import has this name or writer id; the text gives the nearest names."""


class BagNotFound(RunNotFound, FileNotFoundError):
    """Class Bag was given the name or path of a bag that is not stored: as rosbag, an OSError."""


class TransformException(CassandraRosError):
    """There is no transform between two frames; tf2's own exception is the cause of this one.

    These four mean what those of their names in tf2 mean, but are no classes of tf2's.
    """


class LookupException(TransformException):
    """A frame is in no recorded transform, or the frames form a loop."""


class ConnectivityException(TransformException):
    """Nothing connects the two frames at that time."""


class ExtrapolationException(TransformException):
    """The time lies before the first or after the last transform of a frame."""


class TypeMismatch(CassandraRosError, ValueError):
    """A message is of another type than its topic; nothing was stored."""


class UnknownFormat(CassandraRosError, ValueError):
    """No storage format has this name."""


class UnknownEncoding(CassandraRosError, ValueError):
    """The pixels of an image are encoded in a way of which no picture can be made."""


class InvalidKey(CassandraRosError, ValueError):
    """A time, row key or cursor cannot be understood."""


class InvalidName(CassandraRosError, ValueError):
    """A keyspace, topic or field name is not allowed."""


class InvalidOption(CassandraRosError, ValueError):
    """An option has a value outside of its range; the text gives the range."""


class InvalidExpression(CassandraRosError, ValueError):
    """A condition cannot be evaluated on the messages that it is asked of."""


class InvalidQuery(CassandraRosError, ValueError):
    """A statement cannot be parsed or names something unknown.

    Args:
        statement: The statement as it was given.
        position: Index of the first character that is wrong, 0 to len(statement).
        reason: One sentence: what is wrong and what was perhaps meant.
    """

    def __init__(self, statement: str, position: int, reason: str) -> None:
        self.statement = statement
        self.position = max(0, min(position, len(statement)))
        self.reason = reason
        start = statement.rfind("\n", 0, self.position) + 1
        end = statement.find("\n", self.position)
        line = statement[start : end if end >= 0 else len(statement)]
        caret = " " * (self.position - start) + "^"
        super().__init__(f"{reason}\n  {line}\n  {caret}")


class AnswerTooLarge(CassandraRosError, ValueError):
    """An answer, or one row or message of it, is larger than what is made at once."""


class DefinitionError(CassandraRosError, ValueError):
    """A message definition is malformed, hostile, or does not agree with its md5sum."""


class CorruptMessage(CassandraRosError, ValueError):
    """Stored or received bytes are not a message of the type that they claim."""


class BagError(CassandraRosError, ValueError):
    """A file is not a bag of format 2.0 that can be read to its end."""


class BagUnindexed(BagError):
    """A bag has no index: it is still being written, or was cut short."""


class BagTooLarge(BagError):
    """A bag or an MCAP would unpack to more than is allowed: it may be made to fill the memory."""


class ClockNotSet(CassandraRosError):
    """Simulated time is in use and no /clock message has come yet."""


class ServerError(CassandraRosError):
    """The local Cassandra could not be installed, started, stopped or cleared."""


class DownloadFailed(CassandraRosError):
    """What is fetched from the network could not be, or is not what was asked for."""


class MissingDependency(CassandraRosError, ImportError):
    """An optional Python package is needed for this and is not installed."""
