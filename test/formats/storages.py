# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Formats that keep a message as one text: what tests expect of all of them."""

from __future__ import annotations

import pytest

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.messages.classes import installed_definition
from cassandra_ros.messages.definition import parse_definition


def storage_of(form, definition):
    """Return the storage of a definition, or of an installed type, in a format (a class)."""
    if isinstance(definition, str):
        definition = installed_definition(definition)
    return form(definition.type, definition.md5sum, definition)


def check_kept_beside(form, text, wire):
    """Check that a message of type ``text`` that the format cannot express is kept as bytes."""
    encoded = storage_of(form, parse_definition("p/T", text)).encode_wire(wire)
    assert encoded.columns[0] is not None
    assert (encoded.odd, encoded.raw) == (True, wire)


def check_refused(form, text):
    """Check that a text that is no Float64MultiArray is refused."""
    storage = storage_of(form, "std_msgs/Float64MultiArray")
    with pytest.raises(CorruptMessage, match="Float64MultiArray"):
        storage.decode_wire((text.encode(),), None)
