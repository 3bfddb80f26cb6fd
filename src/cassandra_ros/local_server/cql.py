# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The few words of CQL's protocol, version 4, that a start needs: OPTIONS, and one question.

The driver is not used: a server is started where only ROS and Java are.
"""

from __future__ import annotations

import json
import re
import socket
import struct

_HEADER = struct.Struct(">BBhBi")
_VERSION = 4
_STARTUP, _READY, _OPTIONS, _SUPPORTED, _QUERY, _RESULT = 1, 2, 5, 6, 7, 8
_STARTUP_OPTIONS = b"\0\1\0\x0bCQL_VERSION\0\x053.0.0"
_CONSISTENCY_ONE = 1
_MAX_FRAME = 1 << 20


def answers_cql(host: str, port: int, timeout_sec: float = 2.0) -> bool:
    """Tell whether a CQL server answers OPTIONS, the request that needs no login."""
    try:
        with socket.create_connection((host, port), timeout=timeout_sec) as connection:
            _call(connection, _OPTIONS, b"", _SUPPORTED)
    except (OSError, struct.error):
        return False
    return True


def schema_versions(host: str, port: int, timeout_sec: float = 2.0) -> dict[str, str]:
    """Ask a node which other nodes it knows, and with which version of the schema.

    Returns:
        Version by address of the other node, its own under 'here'; nodes of which it does not
        know tokens and schema yet are missing. Empty where it does not answer.
    """
    try:
        with socket.create_connection((host, port), timeout=timeout_sec) as connection:
            _call(connection, _STARTUP, _STARTUP_OPTIONS, _READY)
            here = _select(connection, "schema_version FROM system.local")
            peers = _select(connection, "peer, schema_version, tokens FROM system.peers_v2")
    except (OSError, struct.error):
        return {}
    known = {row["peer"]: row["schema_version"] for row in peers if row["tokens"]}
    known["here"] = here[0]["schema_version"] if here else ""
    return {address: version for address, version in known.items() if version}


def _select(connection: socket.socket, what: str) -> list[dict[str, str]]:
    """Return the rows of a SELECT of plain columns."""
    text = f"SELECT JSON {what}".encode()
    body = struct.pack(">i", len(text)) + text + struct.pack(">HB", _CONSISTENCY_ONE, 0)
    answer = _call(connection, _QUERY, body, _RESULT)
    # Each row is one text; what is packed around them holds no such brace.
    return [json.loads(row) for row in re.findall(rb'\{"[^{}]*\}', answer)]


def _call(connection: socket.socket, opcode: int, body: bytes, expected: int) -> bytes:
    """Send a frame; return the body of the answer, which is to have the expected opcode."""
    connection.sendall(_HEADER.pack(_VERSION, 0, 0, opcode, len(body)) + body)
    with connection.makefile("rb") as stream:
        version, _, _, answer, length = _HEADER.unpack(stream.read(_HEADER.size))
        if (version, answer) != (0x80 | _VERSION, expected) or not 0 <= length <= _MAX_FRAME:
            raise OSError("this is no CQL, or the server refused the question")
        found = stream.read(length)
    if len(found) < length:
        raise OSError("the connection was closed")
    return found
