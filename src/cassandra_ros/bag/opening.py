# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which reader a file needs: its first bytes say what it is, whatever its name."""

from __future__ import annotations

import os

from cassandra_ros.bag.message_file import MessageFile
from cassandra_ros.bag.reader import BagReader


def open_file(path: str | os.PathLike[str]) -> MessageFile:
    """Open a file of messages for reading; raises as its reader does, see BagReader."""
    return BagReader(path)
