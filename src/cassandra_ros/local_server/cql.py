# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The few words of CQL's protocol, version 4, that a start needs: OPTIONS, and one question.

The driver is not used: a server is started where only ROS and Java are.
"""

from __future__ import annotations

import json
import socket
import struct
from typing import Any

_HEADER = struct.Struct(">BBhBi")
_VERSION = 4
_STARTUP, _READY, _OPTIONS, _SUPPORTED, _QUERY, _RESULT = 1, 2, 5, 6, 7, 8
_CONSISTENCY_ONE = 1
_GLOBAL_NAMES = 1
_MAX_FRAME = 1 << 20


def answers_cql(host: str, port: int, timeout_sec: float = 2.0) -> bool:
    """Tell whether a CQL server answers OPTIONS, the request that needs no login."""
    try:
        with socket.create_connection((host, port), timeout=timeout_sec) as connection:
            return _call(connection, _OPTIONS, b"")[0] == _SUPPORTED
    except (OSError, struct.error):
        return False


def schema_versions(host: str, port: int, timeout_sec: float = 2.0) -> dict[str, str]:
    """Ask a node which other nodes it knows, and with which version of the schema.

    Returns:
        Version by address of the other node, its own under 'here'; nodes of which it does not
        know tokens and schema yet are missing. Empty where it does not answer.
    """
    try:
        with socket.create_connection((host, port), timeout=timeout_sec) as connection:
            options = _string_map({"CQL_VERSION": "3.0.0"})
            if _call(connection, _STARTUP, options)[0] != _READY:
                return {}
            here = _select(connection, "SELECT JSON schema_version FROM system.local")
            peers = _select(
                connection, "SELECT JSON peer, schema_version, tokens FROM system.peers_v2"
            )
    except (OSError, struct.error, ValueError):
        return {}
    known = {row["peer"]: row["schema_version"] for row in peers if row["tokens"]}
    known["here"] = here[0]["schema_version"] if here else ""
    return {address: version for address, version in known.items() if version}


def _select(connection: socket.socket, statement: str) -> list[dict[str, Any]]:
    """Return the rows of a SELECT JSON: one column of text."""
    text = statement.encode()
    body = struct.pack(">i", len(text)) + text + struct.pack(">HB", _CONSISTENCY_ONE, 0)
    opcode, answer = _call(connection, _QUERY, body)
    if opcode != _RESULT:
        raise ValueError("the server refused the question")
    flags = struct.unpack_from(">i", answer, 4)[0]
    position = 12
    for _ in range(3 if flags & _GLOBAL_NAMES else 0):  # keyspace, table, column
        position += 2 + struct.unpack_from(">H", answer, position)[0]
    position += 2  # the column's type
    count = struct.unpack_from(">i", answer, position)[0]
    position += 4
    rows = []
    for _ in range(count):
        length = struct.unpack_from(">i", answer, position)[0]
        rows.append(json.loads(answer[position + 4 : position + 4 + length]))
        position += 4 + length
    return rows


def _call(connection: socket.socket, opcode: int, body: bytes) -> tuple[int, bytes]:
    """Send a frame; return opcode and body of the answer."""
    connection.sendall(_HEADER.pack(_VERSION, 0, 0, opcode, len(body)) + body)
    version, _, _, answer, length = _HEADER.unpack(_read(connection, _HEADER.size))
    if version != 0x80 | _VERSION or not 0 <= length <= _MAX_FRAME:
        raise OSError("this is no CQL")
    return answer, _read(connection, length)


def _read(connection: socket.socket, length: int) -> bytes:
    data = b""
    while len(data) < length:
        piece = connection.recv(length - len(data))
        if not piece:
            raise OSError("the connection was closed")
        data += piece
    return data


def _string_map(values: dict[str, str]) -> bytes:
    words = [word.encode() for pair in values.items() for word in pair]
    packed = b"".join(struct.pack(">H", len(word)) + word for word in words)
    return struct.pack(">H", len(values)) + packed
