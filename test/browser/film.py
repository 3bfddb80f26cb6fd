# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A bag of a camera that takes as many pictures as one likes, of 100 KB each."""

from __future__ import annotations

import io

import genpy
import numpy as np
import rosbag
from PIL import Image
from sensor_msgs.msg import CompressedImage

START = 1368032400 * 10**9
"""2013-05-08T17:00:00Z"""
TOPIC = "/film/image/compressed"
RATE_HZ = 2
PICTURES = 20
"""Number of different pictures."""


def write(path, seconds):
    """Write the bag of a film of this length, s."""
    noise = np.random.default_rng(1)
    pictures = [_jpeg(noise.integers(0, 255, (320, 320, 3), np.uint8)) for _ in range(PICTURES)]
    with rosbag.Bag(str(path), "w") as bag:
        for k in range(seconds * RATE_HZ):
            ns = START + k * 10**9 // RATE_HZ
            stamp = genpy.Time(ns // 10**9, ns % 10**9)
            msg = CompressedImage(format="jpeg", data=pictures[k % PICTURES])
            msg.header.stamp, msg.header.frame_id = stamp, "film"
            bag.write(TOPIC, msg, stamp)


def _jpeg(array):
    file = io.BytesIO()
    Image.fromarray(array).save(file, "JPEG", quality=90)
    return file.getvalue()
