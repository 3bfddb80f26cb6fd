# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import pytest

from cassandra_ros.errors import DefinitionError
from cassandra_ros.messages.formats.binary import CassandraTopic_binary


def test_without_a_definition_the_bytes_are_kept():
    storage = CassandraTopic_binary("led_array_msgs/Status", "53a14e6c", None)
    assert storage.getColValidationClasses() == {"_data": "blob"}
    encoded = storage.encode_wire(b"\0\1")
    assert encoded == ((b"\0\1",), False, None)
    message = storage.decode(encoded)
    assert (message._type, message._md5sum, message._buff) == (
        "led_array_msgs/Status",
        "53a14e6c",
        b"\0\1",
    )
    assert storage.encode(message) == encoded
    with pytest.raises(DefinitionError, match="led_array_msgs/Status"):
        storage.require_class()


def test_empty_messages():
    storage = CassandraTopic_binary("std_msgs/Empty", "d41d8cd9", None)
    assert storage.decode_wire(storage.encode_wire(b"").columns, None) == b""
