# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Publishes at a rate, from a process of its own: URI TOPIC SIZE COUNT RATE; SIZE 0 = a Twist."""

from __future__ import annotations

import struct
import sys
import time

from geometry_msgs.msg import Twist
from raw_publisher import RawPublisher, header_of, message
from sensor_msgs.msg import Image

TICK_SEC = 0.002
"""Shorter than what a subscriber's queue of 100 messages holds at 20,000 a second."""


def main():
    uri, topic, size, count, rate = sys.argv[1:]
    size, count, rate = int(size), int(count), float(rate)
    kind, wire = Twist, message(Twist())
    if size:
        kind = Image
        noise = bytes(range(256)) * (size // 256)
        wire = message(Image(height=1, width=size, step=size, encoding="mono8", data=noise))
    with RawPublisher(uri, topic, header_of(kind, "/load" + topic), "/load" + topic) as one:
        one.await_subscribers()
        began, sent = time.monotonic(), 0
        while sent < count:
            due = min(count, int((time.monotonic() - began) * rate) + 1)
            # Numbered in the first four bytes of the header, or of the first field.
            one.publish(*(struct.pack("<I", number) + wire[4:] for number in range(sent, due)))
            sent = due
            time.sleep(TICK_SEC)
        seconds = time.monotonic() - began
        print(f"sent {sent} in {seconds:.2f} s, {sent / seconds:.0f}/s", flush=True)
        time.sleep(1.0)


main()
