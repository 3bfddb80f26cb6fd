# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Compare what converts many messages together with what converts them one by one.

These are the mechanisms of messages/wire/ whose figures doc/internals.md shows. Times are of one
thread's processor, the minimum of rounds in which both ways take turns; no server is needed. On the
way back the driver would cut single rows into columns first: that is not measured.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from io import BytesIO
from itertools import accumulate
from struct import Struct
from typing import Any, Callable

import numpy as np
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Float64, String
from tf2_msgs.msg import TFMessage

from cassandra_ros.messages.classes import deserialize, installed_definition
from cassandra_ros.messages.formats.cassandra_topic_ import CassandraTopic_
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.messages.wire.objects import ObjectMaker

size = Struct(">i").pack
COUNT = 1000
"""Number of messages that are converted at once."""
Work = Callable[[], object]


def wire_of(message: Any) -> bytes:
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def transforms(number: int) -> TFMessage:
    """Make a message of /tf with two transforms."""
    message = TFMessage([TransformStamped(), TransformStamped()])
    for transform, child in zip(message.transforms, ("base_link", "laser")):
        transform.header.seq, transform.header.stamp.secs = number, number
        transform.header.frame_id, transform.child_frame_id = "odom", child
        transform.transform.translation.x = number / 7
        transform.transform.rotation.w = 1.0
    return message


def scan(number: int) -> LaserScan:
    """Make a scan of 360 beams."""
    return LaserScan(ranges=[(number + n) % 30 / 3 for n in range(360)], intensities=[0.5] * 360)


def joints(number: int) -> JointState:
    """Make the state of six joints."""
    names = [f"joint_{n}" for n in range(6)]
    numbers = [number / 3] * 6
    return JointState(name=names, position=numbers, velocity=numbers, effort=numbers)


def text(number: int) -> String:
    """Make a text of 0 to 99 characters."""
    return String("x" * (number * 37 % 100))


CONVERTED = {"/tf, two transforms": transforms, "String, lengths 0 to 99": text}
MADE = {
    "LaserScan, 360 beams": scan,
    "Float64": lambda number: Float64(number / 7),
    "JointState, six joints": joints,
}


def columns_together(codec: CassandraTopic_, wires: list[bytes]) -> list[bytes]:
    rows = [row for row in codec.encode_together(wires) if row is not None]
    assert len(rows) == len(wires), "some messages were not converted together"
    return rows


def columns_single(codec: CassandraTopic_, wires: list[bytes]) -> list[bytes]:
    """Return each row as the store sends it: its columns, each after its size."""
    encoded = [codec.encode_wire(wire) for wire in wires]
    return [b"".join([size(len(c)) + c for c in row.columns]) for row in encoded]


def wires_together(codec: CassandraTopic_, rows: list[bytes], sizes: list[int]) -> list[bytes]:
    ends = np.array(list(accumulate(map(len, rows))))
    starts = ends - np.array(list(map(len, rows)))
    found = codec.decode_together(b"".join(rows), starts, ends, np.array(sizes))
    return [wire for wire in found if wire is not None]


def measure(works: list[Work], rounds: int) -> list[float]:
    """Return the processor time of each work, ms."""
    best = [float("inf")] * len(works)
    for _ in range(rounds):
        for number, work in enumerate(works):
            start = time.thread_time()
            work()
            best[number] = min(best[number], (time.thread_time() - start) * 1e3)
    return best


def compare_columns(name: str, make: Callable[[int], Any], rounds: int) -> None:
    """Print the times of both ways from messages to columns of format ros, and back."""
    definition = installed_definition(make(0)._type)
    codec = format_class("ros")(definition.type, definition.md5sum, definition)
    wires = [wire_of(make(number)) for number in range(COUNT)]
    rows = columns_together(codec, wires)
    single = [codec.encode_wire(wire) for wire in wires]
    back = partial(wires_together, codec, rows, list(map(len, wires)))
    assert columns_single(codec, wires) == rows
    assert back() == wires == [codec.decode_wire(row.columns, row.raw) for row in single]
    ways = {
        "to columns": [
            partial(columns_together, codec, wires),
            partial(columns_single, codec, wires),
        ],
        "from columns": [
            back,
            lambda: [codec.decode_wire(row.columns, row.raw) for row in single],
        ],
    }
    for way, works in ways.items():
        show(f"{name}, {way}", *measure(works, rounds))


def compare_objects(name: str, make: Callable[[int], Any], rounds: int) -> None:
    """Print the times of both ways from messages to message objects."""
    cls = type(make(0))
    wires = [wire_of(make(number)) for number in range(COUNT)]
    sizes = np.array(list(map(len, wires)))
    data, starts = b"".join(wires), np.cumsum(sizes) - sizes
    maker = ObjectMaker(cls, installed_definition(cls._type))
    assert list(maker.make(data, starts, sizes)) == [deserialize(cls, wire) for wire in wires]
    works: list[Work] = [
        lambda: list(maker.make(data, starts, sizes)),
        lambda: [cls().deserialize(wire) for wire in wires],
    ]
    show(f"{name}, to objects", *measure(works, rounds))


def show(what: str, together: float, single: float) -> None:
    print(f"| {what} | {together:.2f} | {single:.2f} | {single / together:.1f} |")


def main() -> None:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=15, help="of timing (%(default)s)")
    rounds = parser.parse_args().rounds
    print(f"Processor time of {COUNT} messages, ms, minimum of {rounds} rounds\n")
    print("| | together | one by one | ratio |\n| --- | ---: | ---: | ---: |")
    for name, make in CONVERTED.items():
        compare_columns(name, make, rounds)
    for name, make in MADE.items():
        compare_objects(name, make, rounds)


if __name__ == "__main__":
    main()
