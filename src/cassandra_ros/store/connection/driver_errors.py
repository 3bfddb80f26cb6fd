# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Translation of the driver's errors into ours; no other module does that."""

from __future__ import annotations

import re
from contextlib import contextmanager
from typing import Callable, Iterator, Mapping

from cassandra import (
    AlreadyExists,
    AuthenticationFailed,
    CoordinationFailure,
    DriverException,
    InvalidRequest,
    OperationTimedOut,
    ReadFailure,
    ReadTimeout,
    Timeout,
    Unauthorized,
    Unavailable,
)
from cassandra.cluster import NoHostAvailable
from cassandra.connection import ConnectionBusy, ConnectionException
from cassandra.pool import NoConnectionsAvailable
from cassandra.protocol import ErrorMessage, OverloadedErrorMessage, SyntaxException

from cassandra_ros.errors import (
    AccessDenied,
    CassandraRosError,
    KeyspaceNotFound,
    LoginFailed,
    SchemaConflict,
    StoreUnavailable,
    TopicNotFound,
)
from cassandra_ros.store.connection.cql_names import quote_name

MAX_CAUSE = 200
"""Maximum length of a cause in a log line, characters. The driver's texts may list all it knows."""
START_HINT = "start one with: rosrun cassandra_ros local_cassandra start"
"""End of the error texts of a connection that no server answers."""

DRIVER_ERRORS = (
    DriverException,
    NoHostAvailable,
    ConnectionException,
    ConnectionBusy,
    NoConnectionsAvailable,
    ErrorMessage,
)
"""All errors that the driver raises for a request or a connection."""
_PASSING = (
    Unavailable,
    Timeout,
    CoordinationFailure,
    OperationTimedOut,
    OverloadedErrorMessage,
    ConnectionException,
    ConnectionBusy,
    NoConnectionsAvailable,
)
"""Errors after which the same statement may succeed later."""
_DISK_FULL = ("no space left", "insufficient disk space", "disk usage exceeds", "nodiskavailable")
"""What the error texts of a server say if its disk is full, in lower case."""


def host_errors(exc: NoHostAvailable) -> Mapping[object, BaseException]:
    """Return the error of each host; empty if the driver tells none.

    If the first session found no host, the driver puts a list of hosts in the place of the errors.
    """
    return exc.errors if isinstance(exc.errors, dict) else {}


def is_busy(exc: BaseException) -> bool:
    """Return whether only our own socket buffers were full: nothing was sent, so it can be resent.

    The driver does not wait for room in a full socket buffer but fails (PYTHON-1248), disguised
    as NoHostAvailable.
    """
    if isinstance(exc, (ConnectionBusy, NoConnectionsAvailable)):
        return True
    errors = host_errors(exc) if isinstance(exc, NoHostAvailable) else {}
    return bool(errors) and all(is_busy(error) for error in errors.values())


def is_disk_full(exc: BaseException) -> bool:
    """Return whether a server says that its disk is full, or fuller than its guardrail allows."""
    errors = [exc, *(host_errors(exc).values() if isinstance(exc, NoHostAvailable) else ())]
    return any(sign in str(error).lower() for error in errors for sign in _DISK_FULL)


def is_answer(exc: BaseException) -> bool:
    """Return whether a server sent this error, which means that the server does answer."""
    if isinstance(exc, NoHostAvailable):
        return any(map(is_answer, host_errors(exc).values()))
    return isinstance(exc, (Unavailable, CoordinationFailure, Timeout, ErrorMessage))


def is_passing(exc: BaseException) -> bool:
    """Return whether the same idempotent statement may succeed later.

    If no host took it, it may, unless one of them refuses the user or the statement.
    """
    if is_disk_full(exc):
        return True  # until the operator makes room
    if isinstance(exc, NoHostAvailable):
        return not any(
            isinstance(error, (Unauthorized, AuthenticationFailed, InvalidRequest))
            for error in host_errors(exc).values()
        )
    return isinstance(exc, _PASSING)


def is_denied(exc: BaseException | None) -> bool:
    """Return whether a server refused a statement because the user lacks a right."""
    return isinstance(exc, (AccessDenied, Unauthorized))


def is_table_gone(exc: BaseException) -> bool:
    """Return whether a statement failed because its table or keyspace was dropped."""
    text = str(exc).lower()
    return isinstance(exc, InvalidRequest) and (
        "unconfigured table" in text or "does not exist" in text or "unknown table" in text
    )


def is_refused(exc: BaseException) -> bool:
    """Return whether a server cannot or will not run this statement, but may run a simpler one.

    A read that took too long counts too: less work may be done in time.
    """
    slow = isinstance(exc, (ReadTimeout, ReadFailure, OperationTimedOut))
    return slow or not (is_passing(exc) or is_busy(exc) or is_table_gone(exc))


def translate(exc: BaseException, what: str, nodes: str = "") -> CassandraRosError:
    """Translate one of the driver's errors into one of ours; one of ours is returned as it is.

    Args:
        what: What was being done, the beginning of the error text.
        nodes: Text that says which nodes of the cluster answer and which do not; '' if all or
            none do.
    """
    more = f"; {nodes}" if nodes else ""
    if isinstance(exc, CassandraRosError):
        return exc
    if is_disk_full(exc):
        return StoreUnavailable(f"{what}: the disk of the store is full; make room there ({exc})")
    if isinstance(exc, Unauthorized):
        return _denial(exc, what)
    if isinstance(exc, AuthenticationFailed):
        return LoginFailed(f"{what}: the server refuses this user: {exc}")
    if isinstance(exc, NoHostAvailable):
        causes = "; ".join(f"{host}: {error}" for host, error in host_errors(exc).items())
        who = "too few Cassandra nodes answer" if nodes else "no Cassandra node answers"
        return StoreUnavailable(f"{what}: {who} ({causes or exc.args[0]}){more}")
    if isinstance(exc, Unavailable):
        return StoreUnavailable(
            f"{what}: too few replicas are up ({exc.alive_replicas} of the "
            f"{exc.required_replicas} that the consistency level asks for){more}"
        )
    if isinstance(exc, _PASSING):
        return StoreUnavailable(f"{what}: the server did not answer in time or failed: {exc}{more}")
    if isinstance(exc, InvalidRequest) and "keyspace" in str(exc).lower() and is_table_gone(exc):
        return KeyspaceNotFound(f"{what}: {exc}")
    if is_table_gone(exc):
        return TopicNotFound(
            f"{what}: its table was removed meanwhile by another client; if it is still listed, "
            "Cassandra was killed while it made the table: stop and start Cassandra"
        )
    if isinstance(exc, (InvalidRequest, SyntaxException, AlreadyExists)):
        return SchemaConflict(f"{what}: the server refuses the statement: {exc}")
    return StoreUnavailable(f"{what}: {type(exc).__name__}: {exc}")


# "User ann has no MODIFY permission on <table ros.imu> or any of its parents".
_RIGHT = re.compile(r"User (.+?) has no ([A-Z_]+) permission on <(.*?)>")
# The answer to CREATE ROLE, which does not name the right.
_ROLES = re.compile(r"User (.+?) does not have sufficient privileges")


def _denial(exc: Unauthorized, what: str) -> AccessDenied:
    """Return an error that says which right the user lacks, as far as the server tells."""
    text = str(exc)
    match = _RIGHT.search(text)
    on_roles = _ROLES.search(text)
    if match:
        user, right, resource = match.groups()
    elif on_roles:
        user, right, resource = on_roles[1], "CREATE", "all roles"
    else:
        return AccessDenied(f"{what}: this user may not do that: {text}; log in as another user")
    return AccessDenied(
        f"{what}: user {user} lacks the right {right} on {resource}; have an owner or "
        f"administrator run: GRANT {right} ON {_in_grant(resource)} TO {quote_name(user)} "
        "('cassandra_bag roles' prints the roles of a keyspace), or log in as another user",
        right=right,
    )


def _in_grant(resource: str) -> str:
    """Return how GRANT names a resource that an error text names, e.g. 'table ros.imu'.

    For a table it is the keyspace, because a topic has many tables.
    """
    kind, _, name = resource.partition(" ")
    if kind == "all":
        keyspace = name.partition("tables in ")[2]
        return f"KEYSPACE {quote_name(keyspace)}" if keyspace else resource.upper()
    return f"KEYSPACE {quote_name(name.partition('.')[0])}"


def cause_of(exc: BaseException, nodes: str = "") -> str:
    """Return a short text of why a request failed, for a log line; nodes as in translate."""
    cause = str(translate(exc, "")).lstrip(": ")[:MAX_CAUSE]
    return f"{cause}; {nodes}" if nodes else cause


@contextmanager
def translated(what: str, nodes: Callable[[], str] = str) -> Iterator[None]:
    """Run a block and translate its driver errors.

    Args:
        what: What the block does, the beginning of the error text.
        nodes: Returns the ``nodes`` of translate.
    """
    try:
        yield
    except DRIVER_ERRORS as exc:
        raise translate(exc, what, nodes()) from exc
