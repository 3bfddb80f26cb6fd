# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Draw a contact sheet of a camera: small pictures, evenly spaced in time, each with its time.

  cassandra_bag thumbs /camera/image_raw
  cassandra_bag thumbs /camera/image_raw -o drive.png --columns 8 --rows 4 --width 160
  cassandra_bag thumbs /camera/image_raw --start 2013-05-08T14:06:20Z --every 10

TOPIC holds sensor_msgs/Image or CompressedImage. Only the messages that are drawn are read, each
found by its time; with --where all that satisfy the condition. Depths (16UC1, 32FC1) go from black,
the least of a picture, to white. Times are UTC. A message that cannot be drawn leaves its place
empty, is told on standard error, and the exit status is 1 then.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Iterator

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import (
    add_origin_options,
    add_store_options,
    add_time_options,
    add_where_option,
    open_store,
    read_times,
    read_where,
)
from cassandra_ros.cli.readers import duration, whole_number
from cassandra_ros.errors import (
    CassandraRosError,
    CorruptMessage,
    InvalidOption,
    MessageNotFound,
    UnknownEncoding,
)
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra
    from cassandra_ros.drawing.contact_sheet import Cell
    from cassandra_ros.overview.time_sample import Chosen

MAX_PICTURES = 1000
MAX_WIDTH = 2000
"""Pixels."""
_MAX_PIXELS = 1 << 27
"""Of a sheet, were its pictures square: all of it is in memory."""


@dataclass(frozen=True)
class _Drawn:
    """A message of the sheet; not its bytes."""

    t: int
    node: str
    cell: Cell
    """Its caption is not written yet."""
    problem: CassandraRosError | None = None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the topic, which of its messages, the sheet, and the store."""
    add = parser.add_argument
    add("topic", metavar="TOPIC", help="the topic of a camera")
    text = "the picture to make, .png, .jpg or .webp (default: the topic's name with .png)"
    add("-o", "--output", metavar="OUT.png", help=text)
    add("-f", "--force", action="store_true", help="replace the picture if it exists")
    text = "pictures side by side (default: %(default)s)"
    add("--columns", metavar="COUNT", type=whole_number, default=6, help=text)
    text = "rows at the most (default: 5; with --every as many as it takes)"
    add("--rows", metavar="COUNT", type=whole_number, help=text)
    text = "of each picture, pixels (default: %(default)s)"
    add("--width", metavar="PIXELS", type=whole_number, default=240, help=text)
    text = "a picture each so many seconds, or with m or h (default: as many as there is room for)"
    add("--every", metavar="SECONDS", type=duration, help=text)
    add_time_options(parser)
    add_origin_options(parser)
    add_where_option(parser)
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Choose messages, draw them, write the picture, and say what it shows."""
    from cassandra_ros.drawing.contact_sheet import draw_sheet
    from cassandra_ros.drawing.picture_file import check_picture_path, save_picture

    path = options.output or f"{options.topic.strip('/').replace('/', '_') or 'topic'}.png"
    count = _count(options)
    check_picture_path(path, options.force)
    with open_store(options) as ros_cas:
        topic = ros_cas.getTopic(options.topic)
        drawn = list(_draw(ros_cas, topic.name, options, count))
        kind = topic.getMeta["msg_type"]
    if not drawn:
        raise MessageNotFound(f"what topic {topic.name} had there was deleted meanwhile")
    _tell_problems(drawn)
    first, last = _clock(drawn[0].t), _clock(drawn[-1].t)
    title = f"{topic.name}   {kind}   {first} to {last} UTC"
    one_day = first[:10] == last[:10]
    cells = [each.cell._replace(caption=_caption(each, one_day)) for each in drawn]
    sheet = draw_sheet(cells, options.columns, options.width, title)
    size = save_picture(sheet, path)
    damaged = sum(each.problem is not None for each in drawn)
    if options.json:
        pictures = [
            {"time_ns": each.t, "node": each.node, "drawn": each.problem is None} for each in drawn
        ]
        answer = {"path": path, "topic": topic.name, "width": sheet.width, "height": sheet.height}
        print_json({**answer, "size": size, "pictures": pictures})
    else:
        text = f"{len(drawn) - damaged} pictures of {shown(topic.name)}, {first} to {last}"
        print(f"{shown(path)}: {text}, {sheet.width} x {sheet.height} pixels")
    return 1 if damaged else 0


def _count(options: argparse.Namespace) -> int:
    """Return how many pictures there may be."""
    if not 1 <= options.width <= MAX_WIDTH:
        raise InvalidOption(f"--width {options.width} is none of 1 to {MAX_WIDTH} pixels")
    most: int = min(MAX_PICTURES, _MAX_PIXELS // options.width**2)
    rows = options.rows
    if options.columns < 1 or rows == 0:
        raise InvalidOption("a sheet has at least one row and one column")
    if rows is None:
        if options.every:
            return most
        rows = 5
    count: int = rows * options.columns
    if count > most:
        text = f"{count} pictures are more than the {most} of a sheet whose pictures are"
        raise InvalidOption(f"{text} {options.width} pixels wide")
    return count


def _draw(
    ros_cas: RosCassandra, topic: str, options: argparse.Namespace, count: int
) -> Iterator[_Drawn]:
    """Read messages and draw them, one after the other."""
    from cassandra_ros.drawing.contact_sheet import Cell
    from cassandra_ros.drawing.images import picture_of
    from cassandra_ros.messages.stamps import seconds_to_ns
    from cassandra_ros.overview.time_sample import spaced_rows

    every_ns = seconds_to_ns(options.every) if options.every else 0
    rows = spaced_rows(ros_cas.catalog, topic, _chosen(ros_cas, topic, options), count, every_ns)
    for row in rows:
        try:
            picture = picture_of(row, options.width)
            picture.thumbnail((options.width, 2 * options.width))  # some are very high
            yield _Drawn(row.t, row.node, Cell("", picture))
        except (CorruptMessage, UnknownEncoding, MessageNotFound) as exc:
            yield _Drawn(row.t, row.node, Cell("", None), exc)


def _chosen(ros_cas: RosCassandra, topic: str, options: argparse.Namespace) -> Chosen:
    from cassandra_ros.overview.time_sample import Chosen

    start, end = read_times(options)
    where = {ros_cas.getTopic(name).name: text for name, text in read_where(options).items()}
    if set(where) - {topic}:
        raise InvalidOption(f"--where is for {topic}, which is drawn, and for no other topic")
    writers = ros_cas.catalog.keyspace.runs.writers(options.run)
    return Chosen(start, end, options.node_id, writers, where.get(topic))


def _tell_problems(drawn: list[_Drawn]) -> None:
    """Print what could not be drawn; raise the error where nothing could."""
    problems = [each.problem for each in drawn if each.problem is not None]
    if len(problems) == len(drawn):
        raise problems[0]
    for problem in problems:
        print(f"cassandra_bag: {' '.join(str(problem).split())}", file=sys.stderr)


def _caption(drawn: _Drawn, one_day: bool) -> str:
    """Say what a picture is of; the title has the day where there is but one."""
    problem = "cannot be drawn" if drawn.problem is not None else ""
    clock = _clock(drawn.t)[11 if one_day else 0 :]
    return " ".join(filter(None, (clock, problem, drawn.node)))


def _clock(ns: int) -> str:
    from cassandra_ros.messages.stamps import iso_time

    return iso_time(ns)[:23].replace("T", " ")
