# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Estimate the disk that topics need a day in each format, and what a cluster of three nodes needs.

  cassandra_bag size                                      stored topics at their stored mean rates
  cassandra_bag size --topics /tf /scan --rates /tf:50 /scan:10
  cassandra_bag size drive.bag --rates '/camera.*:15' --days 30 --format packed

Some messages of each topic, of the store or of FILE.bag, are encoded in each format, and compressed
by LZ4 in pieces as large as those that Cassandra compresses. So the figures hold as long as later
messages are like these. Blocks of format packed are those of a recording: up to 1,024 messages or
0.5 s; an import fills them better. Not included: index files, and the data that Cassandra deletes
later.

Of FILE.bag a second table shows the format in which 'import' without --format stores each topic, if
it is not stored yet, the reason, and the disk that all its messages then take. An import encodes
1000 messages for the choice: with a smaller --sample it may be another one.

If a topic is stored and takes 16 MiB or more on disk, the last columns tell what its table really
takes now, as the nodes say, divided by its messages and copies. Rows that Cassandra still
holds in memory are counted as messages but not on disk, so shortly after recording the figure is
too small. With replication factor 3 each of three nodes keeps all messages.
"""

from __future__ import annotations

import argparse
import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Callable, Iterable, Mapping, Sequence, Tuple

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import (
    add_large_chunks_option,
    add_store_options,
    open_store,
    read_pairs,
)
from cassandra_ros.cli.terminal_text import counted, format_bytes, format_table
from cassandra_ros.cli.topic_options import add_topics_option, stored_topics, topics_among
from cassandra_ros.errors import AccessDenied, InvalidOption
from cassandra_ros.metadata import DEFAULT_FORMAT, FORMAT_NAMES
from cassandra_ros.printable import shown
from cassandra_ros.recording.option_values import BLOCK_SEC, read_rate_limit

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra
    from cassandra_ros.files.bag.size_estimate import TopicSample

_NODES = 3
"""Number of nodes of the cluster, and replication factor, for which the need is printed."""
_MEASURED_BYTES = 16 << 20
"""Size of a table from which its bytes on disk tell the size of a message, bytes."""
_DAY_SEC = 24 * 60 * 60
Rates = Sequence[Tuple[str, float]]
"""Patterns of topics, and their messages a second."""


@dataclass(frozen=True)
class TopicSize:
    """Size of one topic and type; times and rates as they were given or measured."""

    topic: str
    type: str
    stored_format: str
    """Format in which it is stored; '' = it was read from a file."""
    sampled: int
    """Number of messages that were encoded."""
    rate_hz: float | None
    message_bytes: float
    """Mean size of a serialised message, bytes."""
    bytes_a_message: Mapping[str, float | None]
    """Estimated bytes on disk of one copy of a message, by format."""
    bytes_a_day: Mapping[str, float | None]
    """Estimated bytes on disk of one copy of a day's messages, by format; None = unknown rate, or
    the format cannot hold them."""
    measured: float | None
    """Bytes on disk of a message and copy in the store now; None = not known."""
    messages: int
    import_format: str
    """Format in which an import of the file stores the topic, if it is new; '' = no file."""
    import_why: str
    """Reason for this format in a few words."""
    import_bytes: float | None
    """Estimated bytes on disk of one copy of all messages of the file after its import."""


@dataclass(frozen=True)
class ClusterNeed:
    """What a cluster needs whose nodes each keep a copy of all messages; bytes are estimated."""

    format: str
    days: float
    node_bytes_a_day: float
    node_bytes: float
    """Disk of each node for all days."""
    node_free_bytes: float
    """Free disk of each node beside it, in which the files of the largest topic are merged."""
    network_bytes_a_second: float
    """Serialised messages that are sent to all nodes together."""
    left_out: int
    """Number of topics that are not counted: of unknown rate, or the format cannot hold them."""
    nodes: int = _NODES
    replication_factor: int = _NODES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add where the messages come from, the rates, and the cluster's time and format."""
    add = parser.add_argument
    text = "read messages from this bag or MCAP (default: stored topics)"
    add("bag", metavar="FILE.bag", nargs="?", help=text)
    add_topics_option(parser, "FILE.bag")
    text = (
        "messages a second of the topics whose whole name matches, or of all topics; the first "
        "match counts; may be repeated (default: the mean rate in the store or the file)"
    )
    add(
        "--rates",
        metavar="[TOPIC:]HZ",
        nargs="+",
        type=read_rate_limit,
        action="extend",
        default=[],
        help=text,
    )
    text = "days that the cluster keeps messages (default: %(default)s)"
    add("--days", metavar="DAYS", type=_days, default=30.0, help=text)
    text = "format in which the cluster keeps them (default: %(default)s)"
    add("--format", choices=FORMAT_NAMES, default=DEFAULT_FORMAT, help=text)
    text = "maximum number of messages of each topic that are encoded (default: %(default)s)"
    add("--sample", metavar="NUM", type=_number, default=1000, help=text)
    text = "measure what can be read of a damaged or unclosed FILE.bag (default: refuse it)"
    add("--salvage", action="store_true", help=text)
    add_large_chunks_option(parser)
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print bytes a day by format, and what three nodes need."""
    read_pairs(options, "--rates", options.rates)
    sizes = (_of_file if options.bag else _of_store)(options, options.rates)
    need = _need(sizes, options.format, options.days)
    if options.json:
        print_json({"topics": sizes, "cluster": need})
        return 0
    if not sizes:
        print("there are no messages to measure: name a bag, or another keyspace")
        return 1
    _print_topics(sizes)
    _print_need(sizes, need)
    if options.bag:
        _print_import(sizes)
    return 0


def _of_file(options: argparse.Namespace, rates: Rates) -> list[TopicSize]:
    from cassandra_ros.files.bag.file_formats import open_file
    from cassandra_ros.files.bag.size_estimate import sample_file

    with open_file(options.bag, options.salvage, options.allow_large_chunks) as reader:
        names = {connection.topic for connection in reader.connections.values()}
        topics = topics_among(options, names, reader.path)
        samples = sample_file(reader, topics, options.sample)
    return [_size(sample, rates, None) for sample in samples]


def _of_store(options: argparse.Namespace, rates: Rates) -> list[TopicSize]:
    from cassandra_ros.files.bag.size_estimate import sample_topic

    with open_store(options) as ros_cas:
        names = stored_topics(ros_cas.catalog, options)
        infos = ros_cas.info(names)
        measure = _measurement(ros_cas, options.keyspace)
        sizes = []
        for name in dict.fromkeys(info.topic for info in infos):
            mine = [info for info in infos if info.topic == name]
            for sample in sample_topic(ros_cas.getTopic(name), mine, options.sample):
                sizes.append(_size(sample, rates, measure(sample)))
    return sizes


def _measurement(ros_cas: RosCassandra, keyspace: str) -> Callable[[TopicSample], float | None]:
    """Return what tells the measured bytes of a message and copy of a topic."""
    from cassandra_ros.store.tables.disk_usage import disk_usage

    spaces = [space for space in ros_cas.getKeyspaces() if space.name == keyspace]
    copies = sum(sum(space.copies.values()) for space in spaces)
    try:
        used = disk_usage(ros_cas.cassandra, keyspace)
    except AccessDenied:
        return lambda sample: None

    def measure(sample: TopicSample) -> float | None:
        nbytes = used[sample.table] / max(copies, 1)
        return nbytes / sample.count if nbytes >= _MEASURED_BYTES else None

    return measure


def _size(sample: TopicSample, rates: Rates, measured: float | None) -> TopicSize:
    from cassandra_ros.files.bag.format_choice import FormatChoice, choose_format
    from cassandra_ros.files.bag.size_estimate import estimate, format_size

    # An import goes by the rate in the file, so before that of --rates is set.
    choice = FormatChoice("") if sample.stored_format else choose_format(sample)
    imported = format_size(sample, choice.format, math.inf) if choice.format else None
    given = (hz for pattern, hz in rates if re.fullmatch(pattern, sample.topic))
    sample.rate_hz = next(given, sample.rate_hz)
    sizes = {k: None if v is None else v.disk for k, v in estimate(sample, BLOCK_SEC).items()}
    rate = sample.rate_hz
    day = {
        name: None if size is None or rate is None else size * rate * _DAY_SEC
        for name, size in sizes.items()
    }
    return TopicSize(
        sample.topic,
        sample.type,
        sample.stored_format,
        len(sample.wires),
        rate,
        sample.message_bytes,
        sizes,
        day,
        measured,
        sample.count,
        *choice,
        import_bytes=None if imported is None else imported.disk * sample.count,
    )


def _need(sizes: Sequence[TopicSize], format: str, days: float) -> ClusterNeed:
    day = [size.bytes_a_day[format] for size in sizes]
    estimates = [nbytes for nbytes in day if nbytes is not None]
    sent = sum(size.rate_hz * size.message_bytes for size in sizes if size.rate_hz)
    return ClusterNeed(
        format,
        days,
        node_bytes_a_day=sum(estimates),
        node_bytes=sum(estimates) * days,
        node_free_bytes=max(estimates, default=0.0) * days,
        network_bytes_a_second=sent * _NODES,
        left_out=len(day) - len(estimates),
    )


def _print_topics(sizes: Sequence[TopicSize]) -> None:
    measured = any(size.measured is not None for size in sizes)
    header = ["topic", "rate", "message", *(f"{name}/day" for name in FORMAT_NAMES)]
    header += ["stored as", "estimated", "measured"] * measured
    rows = [_row(size, measured) for size in sizes]
    total = [_bytes(_sum(size.bytes_a_day[name] for size in sizes)) for name in FORMAT_NAMES]
    rows.append(["total", "", "", *total, *[""] * (3 * measured)])
    print(format_table(header, rows, right=set(header) - {"topic", "stored as"}))


def _row(size: TopicSize, measured: bool) -> list[str]:
    rate = "-" if size.rate_hz is None else f"{size.rate_hz:.1f} Hz"
    days = [_bytes(size.bytes_a_day[name]) for name in FORMAT_NAMES]
    cells = [shown(size.topic), rate, _bytes(size.message_bytes), *days]
    if measured:
        estimated = size.bytes_a_message.get(size.stored_format)
        cells += [size.stored_format, _bytes(estimated), _bytes(size.measured)]
    return cells


def _print_need(sizes: Sequence[TopicSize], need: ClusterNeed) -> None:
    sampled = sum(size.sampled for size in sizes)
    print(f"\nestimated from {counted(sampled, 'message')}; one copy, compressed as by Cassandra")
    kept = f"{need.days:g} days in format {need.format}"
    print(f"{need.nodes} nodes with replication factor {need.replication_factor}, {kept}:")
    print(
        f"  disk of each node    {_bytes(need.node_bytes)}, {_bytes(need.node_bytes_a_day)} a day"
    )
    merged = "for the files of the largest topic while they are merged"
    print(f"  free disk beside it  {_bytes(need.node_free_bytes)} {merged}")
    print(f"  disk of all nodes    {_bytes(need.node_bytes * need.nodes)}")
    sent = f"{_bytes(need.network_bytes_a_second)} a second to all nodes together"
    print(f"  network              {sent}, before compression")
    if need.left_out:
        topics = counted(need.left_out, "topic")
        print(f"  without {topics} of unknown rate (--rates), or that this format cannot hold")


def _print_import(sizes: Sequence[TopicSize]) -> None:
    rows = [
        (shown(s.topic), str(s.messages), _bytes(s.import_bytes), s.import_format, s.import_why)
        for s in sorted(sizes, key=lambda size: size.topic)
    ]
    total = _bytes(_sum(size.import_bytes for size in sizes))
    rows.append(("total", str(sum(size.messages for size in sizes)), total, "", ""))
    print("\nimported without --format:")
    header = ("topic", "messages", "on disk", "format", "why")
    print(format_table(header, rows, right=("messages", "on disk")))


def _sum(values: Iterable[float | None]) -> float:
    return sum(value for value in values if value is not None)


def _bytes(size: float | None) -> str:
    return "-" if size is None else format_bytes(round(size))


def _days(text: str) -> float:
    days = float(text)
    if not 0 < days <= 36500:
        raise InvalidOption(f"{text}: give days above 0 and up to 36500")
    return days


def _number(text: str) -> int:
    number = int(text)
    if not 0 < number <= 100_000:
        raise InvalidOption(f"{text}: give a number from 1 to 100000")
    return number
