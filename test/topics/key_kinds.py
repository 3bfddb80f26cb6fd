# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The kinds of keys that a topic of std_msgs/Header can have."""

from __future__ import annotations

import pytest

KEYS = {
    "time": {},
    "stamp": {"key_format": "msg_part", "key_part": "stamp"},
    "value": {"key_format": "msg_part", "key_part": "frame_id"},
    "hash": {"key_format": "hash"},
    "manual": {"key_format": "manual"},
}
"""Arguments of addTopic, by kind."""
every_key = pytest.mark.parametrize("kind", KEYS)
