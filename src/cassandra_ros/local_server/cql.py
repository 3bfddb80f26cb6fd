# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A minimal client of the CQL protocol, version 4: OPTIONS, login, statements.

The driver is not used, because a server must also start where only ROS and Java are installed.
"""

from __future__ import annotations

import json
import re
import socket
import ssl
import struct

_HEADER = struct.Struct(">BBhBi")
"""Head of a frame: version, flags, stream, opcode, length of the body."""
_VERSION = 4
_ERROR, _STARTUP, _READY, _AUTHENTICATE, _OPTIONS, _SUPPORTED = 0, 1, 2, 3, 5, 6
_QUERY, _RESULT, _PREPARE, _AUTH_RESPONSE, _AUTH_SUCCESS = 7, 8, 9, 15, 16
_STARTUP_OPTIONS = b"\0\1\0\x0bCQL_VERSION\0\x053.0.0"
_CONSISTENCY_ONE = 1
_MAX_FRAME = 1 << 28
"""Maximum size of an answer, as in Cassandra, bytes."""
_STATEMENT_SEC = 30.0
"""Maximum time between two parts of an answer, s."""


class CqlRefused(OSError):
    """The server answered with an error; the text is the server's."""


class CqlSession:
    """A connection that is logged in; also a context manager that closes it.

    Args:
        host, port: Address of the server.
        context: TLS; None = without TLS.
        login: User name and password; None = the server must not require a login.
        timeout_sec: Maximum time of the connection, and between two parts of an answer, s.

    Raises:
        OSError: No server answers, or the answer is not CQL.
        CqlRefused: The server refuses the login.
        struct.error: The connection was closed within the head of an answer; run and check raise
            the same errors.
    """

    def __init__(
        self,
        host: str,
        port: int,
        context: ssl.SSLContext | None = None,
        login: tuple[str, str] | None = None,
        timeout_sec: float = _STATEMENT_SEC,
    ) -> None:
        self._connection = _connect(host, port, timeout_sec, context)
        try:
            answer, _ = _exchange(self._connection, _STARTUP, _STARTUP_OPTIONS)
            if answer == _AUTHENTICATE and login:
                token = b"\0" + login[0].encode() + b"\0" + login[1].encode()
                body = struct.pack(">i", len(token)) + token
                answer, _ = _exchange(self._connection, _AUTH_RESPONSE, body)
            if answer not in (_READY, _AUTH_SUCCESS):
                raise CqlRefused("it asks for a login")
        except BaseException:
            self.close()
            raise

    def run(self, statement: str) -> bytes:
        """Run a statement at consistency ONE; return the body of the answer."""
        text = statement.encode()
        body = struct.pack(">i", len(text)) + text + struct.pack(">HB", _CONSISTENCY_ONE, 0)
        return _call(self._connection, _QUERY, body, _RESULT)

    def check(self, statement: str) -> None:
        """Let the server check a statement without running it; raises CqlRefused."""
        text = statement.encode()
        _call(self._connection, _PREPARE, struct.pack(">i", len(text)) + text, _RESULT)

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def __enter__(self) -> CqlSession:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def answers_cql(
    host: str, port: int, timeout_sec: float = 2.0, context: ssl.SSLContext | None = None
) -> bool:
    """Return whether a CQL server answers OPTIONS, a request that needs no login."""
    try:
        with _connect(host, port, timeout_sec, context) as connection:
            _call(connection, _OPTIONS, b"", _SUPPORTED)
    except (OSError, struct.error):
        return False
    return True


def schema_versions(
    host: str,
    port: int,
    timeout_sec: float = 2.0,
    context: ssl.SSLContext | None = None,
    login: tuple[str, str] | None = None,
) -> dict[str, str]:
    """Return the schema versions of the nodes that a node knows.

    Returns:
        Schema version by address of the other node; the node's own version has the key 'here'.
        Nodes whose tokens or schema are not known yet are missing. Empty if the node does not
        answer.
    """
    try:
        with CqlSession(host, port, context, login, timeout_sec) as session:
            here = _select(session, "schema_version FROM system.local")
            peers = _select(session, "peer, schema_version, tokens FROM system.peers_v2")
    except (OSError, struct.error):
        return {}
    versions_of_peers = {row["peer"]: row["schema_version"] for row in peers if row["tokens"]}
    versions_of_peers["here"] = here[0]["schema_version"] if here else ""
    return {address: version for address, version in versions_of_peers.items() if version}


def may_log_in(session: CqlSession, role: str) -> bool:
    """Return whether a role exists and may log in; its name has no quotes."""
    rows = _select(session, f"can_login FROM system_auth.roles WHERE role = '{role}'")
    return any(row["can_login"] for row in rows)


def half_made_tables(session: CqlSession) -> list[str]:
    """Return the tables that a node lists and cannot use, with their keyspaces.

    A node that is killed while it makes or changes a table reads its schema at the next start
    before it repeats what was not flushed: its system tables list the change, and it does not know
    it until the start after that.
    """
    columns: dict[str, list[str]] = {}
    # Cassandra makes the tables of keyspaces that begin with "system" itself.
    for row in _select(session, "keyspace_name FROM system_schema.keyspaces"):
        keyspace = row["keyspace_name"]
        if keyspace.startswith("system"):
            continue
        where = f"WHERE keyspace_name = '{keyspace}'"
        what = f"table_name, column_name FROM system_schema.columns {where}"
        for column in _select(session, what):
            table = f'"{keyspace}"."{column["table_name"]}"'
            columns.setdefault(table, []).append(f'"{column["column_name"]}"')
    half_made = []
    for table, names in columns.items():
        try:
            session.check(f"SELECT {', '.join(names)} FROM {table}")  # noqa: S608 - names by the server
        except CqlRefused:
            half_made.append(table)
    return half_made


def _connect(
    host: str, port: int, timeout_sec: float, context: ssl.SSLContext | None
) -> socket.socket:
    plain = socket.create_connection((host, port), timeout=timeout_sec)
    if context is None:
        return plain
    try:
        return context.wrap_socket(plain)
    except BaseException:
        plain.close()
        raise


def _select(session: CqlSession, what: str) -> list[dict[str, str]]:
    """Return the rows of a SELECT of plain columns."""
    answer = session.run(f"SELECT JSON {what}")
    # Each row is one JSON text; the bytes between them never look like one.
    return [json.loads(row) for row in re.findall(rb'\{"[^{}]*\}', answer)]


def _call(connection: socket.socket, opcode: int, body: bytes, expected: int) -> bytes:
    """Send a frame; return the body of the answer; OSError if its opcode is another one."""
    answer, answer_body = _exchange(connection, opcode, body)
    if answer != expected:
        raise OSError("the server refused the question")
    return answer_body


def _exchange(connection: socket.socket, opcode: int, body: bytes) -> tuple[int, bytes]:
    """Send a frame; return the opcode and the body of the answer."""
    connection.sendall(_HEADER.pack(_VERSION, 0, 0, opcode, len(body)) + body)
    with connection.makefile("rb") as stream:
        version, _, _, answer, length = _HEADER.unpack(stream.read(_HEADER.size))
        if version != 0x80 | _VERSION or not 0 <= length <= _MAX_FRAME:
            raise OSError("this is no CQL")
        data = stream.read(length)
    if len(data) < length:
        raise OSError("the connection was closed")
    if answer == _ERROR:
        raise CqlRefused(data[6:].decode("utf-8", "replace"))  # after a code and a length
    return answer, data
