# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The error for bags of ROS 2, whose messages are serialised in another way."""

from __future__ import annotations

import os

from cassandra_ros.errors import BagError

METADATA = "metadata.yaml"
SQLITE_MAGIC = b"SQLite format 3\x00"


def refusal(path: str) -> BagError:
    """Return the error for a file or folder of rosbag2; it says how to convert it to ROS 1."""
    folder = path if os.path.isdir(path) else os.path.dirname(path) or "."
    whole = folder if os.path.exists(os.path.join(folder, METADATA)) else path
    return BagError(
        f"{path} is a bag of ROS 2 (rosbag2); its messages are not those of ROS 1, which are kept "
        "here: convert it with 'pip install rosbags' and 'rosbags-convert --src "
        f"{whole} --dst OUT.bag', and import OUT.bag"
    )
