# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The CRC of stored bytes is zlib's, whichever library computes it."""

from __future__ import annotations

import importlib
import random
import sys
import zlib

import pytest

from cassandra_ros.store.tables import checksum


@pytest.mark.parametrize("with_isal", [True, False])
def test_it_is_that_of_zlib(monkeypatch, with_isal):
    if not with_isal:
        monkeypatch.setitem(sys.modules, "isal.isal_zlib", None)
    made = importlib.reload(checksum).crc32
    assert with_isal or made is zlib.crc32
    data = bytes(random.Random(1).choices(range(256), k=300_000))
    for size in (0, 1, 7, 8, 63, 64, 65, 1023, 4097, 300_000):
        for begin in (0, 1, 3):
            assert made(data[begin:size]) == zlib.crc32(data[begin:size])
            assert made(memoryview(data)[begin:size]) == zlib.crc32(data[begin:size])
    monkeypatch.undo()
    importlib.reload(checksum)
