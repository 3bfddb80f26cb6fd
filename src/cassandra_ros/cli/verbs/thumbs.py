# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Draw a contact sheet of a camera: small pictures, evenly spaced in time, each with its time.

  cassandra_bag thumbs /camera/image_raw
  cassandra_bag thumbs /camera/image_raw -o drive.png --columns 8 --rows 4 --width 160
  cassandra_bag thumbs /camera/image_raw --start 2013-05-08T14:06:20Z --every 10

TOPIC must be of type sensor_msgs/Image or CompressedImage. Only the messages that are drawn are
read; with --where all messages that satisfy the condition. Depth images (16UC1, 32FC1) are drawn
from black, the minimum of the picture, to white. Times are UTC. If a message cannot be drawn, its
cell is empty, the reason is printed on standard error, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Iterator

from cassandra_ros.cli.json_answer import add_json_option, tell
from cassandra_ros.cli.options import (
    add_message_options,
    add_store_options,
    open_store,
    read_event,
    read_times,
    read_where,
)
from cassandra_ros.errors import (
    CassandraRosError,
    CorruptMessage,
    InvalidOption,
    MessageNotFound,
    UnknownEncoding,
)
from cassandra_ros.printable import shown
from cassandra_ros.quantities import duration, whole_number

if TYPE_CHECKING:
    from cassandra_ros.topics.catalog import Catalog
    from cassandra_ros.topics.overview.time_sample import MessageChoice
    from cassandra_ros.viewing.drawing.contact_sheet import CaptionedPicture

MAX_PICTURES = 1000
MAX_WIDTH = 2000
"""Maximum width of one picture of the sheet, pixels."""
_MAX_PIXELS = 1 << 27
"""Maximum size of a sheet with square pictures, pixels. The whole sheet is kept in memory."""


@dataclass(frozen=True)
class _Thumbnail:
    """A message of the sheet with its picture."""

    t: int
    node: str
    cell: CaptionedPicture
    """The cell of the sheet, still without caption."""
    problem: CassandraRosError | None = None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the topic, the selection of messages, the options of the sheet, and the store."""
    add = parser.add_argument
    add("topic", metavar="TOPIC", help="the topic of a camera")
    text = "the picture to write, .png, .jpg or .webp (default: the topic's name with .png)"
    add("-o", "--output", metavar="OUT.png", help=text)
    add("-f", "--force", action="store_true", help="replace the picture if it exists")
    text = "number of pictures in a row (default: %(default)s)"
    add("--columns", metavar="COUNT", type=whole_number, default=6, help=text)
    text = "maximum number of rows (default: 5; with --every no maximum)"
    add("--rows", metavar="COUNT", type=whole_number, help=text)
    text = "width of each picture, pixels (default: %(default)s)"
    add("--width", metavar="PIXELS", type=whole_number, default=240, help=text)
    text = "time between two pictures: seconds, or with m or h (default: fill all rows evenly)"
    add("--every", metavar="SECONDS", type=duration, help=text)
    add_message_options(parser)
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Select messages, draw them, write the sheet, and print what it shows."""
    from cassandra_ros.viewing.drawing.contact_sheet import (
        check_picture_path,
        draw_sheet,
        save_picture,
    )

    path = options.output or f"{options.topic.strip('/').replace('/', '_') or 'topic'}.png"
    count = _count(options)
    check_picture_path(path, options.force)
    with open_store(options) as ros_cas:
        topic = ros_cas.getTopic(options.topic)
        drawn = list(_draw(ros_cas.catalog, topic.name, options, count))
        kind = topic.getMeta["msg_type"]
    if not drawn:
        raise MessageNotFound(f"what topic {topic.name} had there was deleted meanwhile")
    _tell_problems(drawn)
    first, last = _clock(drawn[0].t), _clock(drawn[-1].t)
    title = f"{topic.name}   {kind}   {first} to {last} UTC"
    one_day = first[:10] == last[:10]
    cells = [thumbnail.cell._replace(caption=_caption(thumbnail, one_day)) for thumbnail in drawn]
    sheet = draw_sheet(cells, options.columns, options.width, title)
    size = save_picture(sheet, path)
    damaged = sum(thumbnail.problem is not None for thumbnail in drawn)
    pictures = [
        {"time_ns": thumbnail.t, "node": thumbnail.node, "drawn": thumbnail.problem is None}
        for thumbnail in drawn
    ]
    answer = {"path": path, "topic": topic.name, "width": sheet.width, "height": sheet.height}
    what = f"{len(drawn) - damaged} pictures of {shown(topic.name)}, {first} to {last}"
    text = f"{shown(path)}: {what}, {sheet.width} x {sheet.height} pixels"
    tell(options, {**answer, "size": size, "pictures": pictures}, text)
    return 1 if damaged else 0


def _count(options: argparse.Namespace) -> int:
    """Return the maximum number of pictures; raises InvalidOption if the sheet is too large."""
    if not 1 <= options.width <= MAX_WIDTH:
        raise InvalidOption(f"--width {options.width} is not within 1 to {MAX_WIDTH} pixels")
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
    catalog: Catalog, topic: str, options: argparse.Namespace, count: int
) -> Iterator[_Thumbnail]:
    """Read and draw the messages, one after the other."""
    from cassandra_ros.messages.stamps import seconds_to_ns
    from cassandra_ros.topics.overview.time_sample import spaced_rows
    from cassandra_ros.viewing.drawing.contact_sheet import CaptionedPicture
    from cassandra_ros.viewing.drawing.images import picture_of

    every_ns = seconds_to_ns(options.every) if options.every else 0
    rows = spaced_rows(catalog, topic, _message_choice(catalog, topic, options), count, every_ns)
    for row in rows:
        try:
            picture = picture_of(row, options.width)
            picture.thumbnail((options.width, 2 * options.width))  # limits very high pictures
            yield _Thumbnail(row.t, row.node, CaptionedPicture("", picture))
        except (CorruptMessage, UnknownEncoding, MessageNotFound) as exc:
            yield _Thumbnail(row.t, row.node, CaptionedPicture("", None), exc)


def _message_choice(catalog: Catalog, topic: str, options: argparse.Namespace) -> MessageChoice:
    """Return which messages may be drawn; InvalidOption: --where is for another topic."""
    from cassandra_ros.topics.overview.time_sample import MessageChoice

    start, end = read_times(options)
    where = {catalog.get(name).name: text for name, text in read_where(options).items()}
    if set(where) - {topic}:
        raise InvalidOption(f"--where is for {topic}, which is drawn, and for no other topic")
    writers = catalog.keyspace.runs.writers(options.run)
    event = read_event(options)
    return MessageChoice(start, end, options.node_id, writers, where.get(topic), event)


def _tell_problems(drawn: list[_Thumbnail]) -> None:
    """Print why messages could not be drawn; raise the error if no message could."""
    problems = [thumbnail.problem for thumbnail in drawn if thumbnail.problem is not None]
    if len(problems) == len(drawn):
        raise problems[0]
    for problem in problems:
        print(f"cassandra_bag: {' '.join(str(problem).split())}", file=sys.stderr)


def _caption(drawn: _Thumbnail, one_day: bool) -> str:
    """Return the caption of a picture. If all are of one day, only the title shows the day."""
    problem = "cannot be drawn" if drawn.problem is not None else ""
    clock = _clock(drawn.t)[11 if one_day else 0 :]
    return " ".join(filter(None, (clock, problem, drawn.node)))


def _clock(ns: int) -> str:
    from cassandra_ros.messages.stamps import iso_time

    return iso_time(ns)[:23].replace("T", " ")
