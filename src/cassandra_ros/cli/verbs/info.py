# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Describe a keyspace as rosbag info describes a bag: duration, times, sizes, and topics.

  cassandra_bag info
  cassandra_bag info -v
  cassandra_bag info /tf -e '/camera/.*'
  cassandra_bag info -y -k duration
  cassandra_bag info --all

A topic has a line for each type, format and robot. All numbers come from the directory, so the
command takes as long for a hundred million messages as for a thousand. Times are receive times in
UTC, and in brackets in seconds since 1970; --start and --end of other verbs accept both. The rate
is the mean over the buckets with messages (in rosbag: the median); pauses inside a bucket lower it.

If the keys of a topic are not receive times, the last column says what they are. Then follow the
messages that were lost, with the reason, also of topics that are not stored, and the latest
recordings and imports.

With -v the types follow with their md5sums, and a line of bars for each topic and robot, which
shows the number of messages over time; the highest bar is the maximum. A pause of ten years or more
is shown as //, and each part then has its own maximum. The directory counts by buckets, so the
messages of a bucket are drawn as if evenly spread.

YAML and JSON have the keys of rosbag info -y (duration, start, end, size, messages, types, topics),
and keyspace, start_ns, end_ns, losses and runs. JSON also has activity: the numbers of messages per
time step that the bars show. Each topic has connections and frequency (Hz, 1 / median period, as in
rosbag), which are computed from its first 10,000 messages, and the mean rate, rate_hz.

With --store, given once or several times, the topics of all these stores are listed as one: each
message counts once, and the last column says how many each store has. If several stores have
messages of a robot in a topic, the keys of all of these are read.

With --all the keyspaces of the cluster that hold topics are listed, with their numbers of topics
and copies. Copies are the numbers of Cassandra nodes, by data centre, that keep each row: with one
copy, data are lost when a node is lost. A star marks the keyspace that --keyspace selects.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Iterator, Mapping, Sequence

from cassandra_ros.cli.fleet_options import add_fleet_options, open_fleet, tell_missing
from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_origin_options, add_store_options, open_store, store_place
from cassandra_ros.cli.terminal_text import (
    counted,
    format_bytes,
    format_length,
    format_table,
    format_time,
    sparkline,
)
from cassandra_ros.cli.topic_options import add_topics, stored_topics, topics_among
from cassandra_ros.cli.verbs.runs import time_of
from cassandra_ros.errors import InvalidOption
from cassandra_ros.keys import NAMED_FORMATS, SECOND_NS
from cassandra_ros.printable import format_duration, shown, shown_lines

if TYPE_CHECKING:
    from cassandra_ros.files.bag.message_sample import MessageSample
    from cassandra_ros.store.tables.registry import Loss, LossKind, Run
    from cassandra_ros.stores.fleet.fleet_info import FleetTopicInfo
    from cassandra_ros.topics.catalog import Catalog
    from cassandra_ros.topics.overview.timeline.lanes import Picture
    from cassandra_ros.topics.stored_totals import TopicInfo

_HEADER = ("topic", "type", "format", "node", "messages", "rate", "size", "first", "last", "bucket")
_RIGHT = ("messages", "rate", "size", "bucket")
_RUNS_SHOWN = 5
"""Maximum number of runs that are shown without -v."""
_SAMPLED = 10_000
"""Number of first messages of each topic and robot from which connections and frequency follow."""
_CELLS = 60
"""Number of time steps for which the number of messages is drawn."""
_FOLD = " // "
"""Text that is drawn for a pause of ten years or more."""


@dataclass
class _Description:
    """The facts that the verb prints about the selected topics."""

    place: str
    """Hosts and port of the store."""
    keyspace: str
    infos: list[TopicInfo]
    losses: list[Loss]
    runs: list[Run]
    activity: Picture
    eras: list[Picture]
    """The activity between pauses of ten years or more; without such a pause only ``activity``."""
    samples: list[MessageSample]
    """First messages of each entry of ``infos``, for YAML and JSON only."""

    @property
    def ends(self) -> tuple[int, int] | None:
        """Times of the first and of the last message, ns; None = there are no messages."""
        return _ends_of(self.infos)

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(info.count for info in self.infos)

    @property
    def bytes(self) -> int:
        """Size of the serialised messages, bytes."""
        return sum(info.bytes for info in self.infos)

    @property
    def types(self) -> list[tuple[str, str]]:
        """Message types with their md5sums."""
        return sorted({(info.type, info.md5sum) for info in self.infos})


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, the form of the output and the store."""
    add_topics(parser)
    text = "list the keyspaces of the cluster that hold topics, in place of the topics of one"
    parser.add_argument("--all", action="store_true", help=text)
    add_origin_options(parser)
    text = "show also the types, the number of messages over time, and all runs"
    parser.add_argument("-v", "--verbose", action="store_true", help=text)
    form = parser.add_mutually_exclusive_group()
    form.add_argument("-y", "--yaml", action="store_true", help="print information in YAML format")
    add_json_option(form)
    text = "with -y or --json: print only the information on this key (default: all)"
    parser.add_argument("-k", "--key", metavar="KEY", help=text)
    text = "accepted as by rosbag info; the rate of each topic is always printed"
    parser.add_argument("--freq", action="store_true", help=text)
    add_store_options(parser)
    add_fleet_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print the description."""
    if options.key is not None and not (options.yaml or options.json):
        options.parser.error("-k goes with -y or --json")
    if options.all:
        return _tell_keyspaces(options)
    if options.stores:
        return _tell_fleet(options)
    description = _describe(options)
    if options.yaml or options.json:
        answers = _answer(description)
        if options.json:
            answers["activity"] = _activity_answer(description.activity)
        answer = _value_of_key(answers, options.key)
        (_print_yaml if options.yaml else print_json)(answer)
        return 0
    _print_summary(description)
    if description.infos:
        print()
        _print_topics(description.infos)
    if description.losses:
        print()
        columns = ("lost of topic", "node", "run", "messages", "from", "to", "why")
        rows = list(_loss_rows(description.losses, description.runs))
        print(format_table(columns, rows, right=("messages",)))
    if description.runs and not options.topics:
        print()
        latest = description.runs if options.verbose else description.runs[-_RUNS_SHOWN:]
        columns = ("run", "kind", "node", "started", "state", "messages", "lost")
        print(format_table(columns, list(map(_run_row, latest)), right=("messages", "lost")))
        if len(description.runs) > len(latest):
            print(f"… and {len(description.runs) - len(latest)} earlier ones: -v shows all")
    if options.verbose and description.infos:
        print()
        types = [(shown(name), f"[{shown(md5sum)}]") for name, md5sum in description.types]
        print(format_table(("type", "md5sum"), types))
        _print_activity(description.eras)
    return 0


def _tell_keyspaces(options: argparse.Namespace) -> int:
    """Print a line for each keyspace with topics; that of --keyspace may be missing."""
    refused = ("topics", "node_id", "run", "key", "stores")
    options.parser.refuse_options(options, refused, "--all lists keyspaces: it goes without {}")
    with open_store(options, make=True) as ros_cas:
        keyspaces = ros_cas.getKeyspaces()
    if options.json:
        print_json(keyspaces)
    elif options.yaml:
        _print_yaml(list(map(asdict, keyspaces)))
    elif keyspaces:
        header = ("", "keyspace", "topics", "tables", "copies")
        rows = [
            (
                "*" if keyspace.name == options.keyspace else "",
                keyspace.name,
                str(keyspace.topics),
                str(keyspace.tables),
                ", ".join(f"{where} {count}" for where, count in keyspace.copies.items()),
            )
            for keyspace in keyspaces
        ]
        print(format_table(header, rows, right=("topics", "tables")))
    else:
        print("no keyspace of the cluster holds topics; a recording or an import makes one")
    return 0


def _tell_fleet(options: argparse.Namespace) -> int:
    with open_fleet(options) as fleet:
        present = fleet.topics()
        names = topics_among(options, set(present), "the fleet")
        infos = fleet.info(names, nodeID=options.node_id, run=options.run)
    missing = {**present.missing, **infos.missing}
    if options.yaml or options.json:
        answer = _value_of_key(_fleet_answer(infos, missing), options.key)
        (_print_yaml if options.yaml else print_json)(answer)
    else:
        _print_fleet(infos)
    return tell_missing(missing)


def _describe(options: argparse.Namespace) -> _Description:
    """Read all facts that the verb may print; the bars are drawn when the store is closed."""
    from cassandra_ros.topics.overview.timeline.lanes import Timeline, View

    hosts, port = store_place(options)
    with open_store(options) as ros_cas:
        selection = {"nodeID": options.node_id, "run": options.run}
        topics = stored_topics(ros_cas.catalog, options)
        infos = ros_cas.info(topics, **selection)
        losses = ros_cas.losses(topics, **selection)
        runs = sorted(ros_cas.runs(times=True), key=lambda run: str(run.started))
        whose = ros_cas.catalog.whose(options.node_id, options.run)
        view = View(*_picture_ends(infos), cells=_CELLS, topics=topics, whose=whose)
        timeline = Timeline(ros_cas.catalog)
        activity = timeline.picture(view)
        eras = [activity]
        if len(activity.eras) > 1:
            cells = _CELLS // len(activity.eras)
            views = [replace(view, start=s, end=e, cells=cells) for s, e in activity.eras]
            eras = list(map(timeline.picture, views))
        needs_samples = (options.yaml or options.json) and options.key in (None, "topics")
        samples = _samples(ros_cas.catalog, infos, options.run) if needs_samples else []
    if whose.writers is not None:
        runs = [run for run in runs if run.writer in whose.writers]
    place = f"{','.join(hosts)}:{port}"
    return _Description(place, options.keyspace, infos, losses, runs, activity, eras, samples)


def _samples(catalog: Catalog, infos: Sequence[TopicInfo], run: str | None) -> list[MessageSample]:
    """Read the first messages of each topic and robot; return a sample for each of ``infos``."""
    from cassandra_ros.files.bag.message_sample import MessageSample, read_samples

    samples: dict[tuple[str, str], dict[str, MessageSample]] = {}
    for info in infos:
        if (info.topic, info.node) not in samples:
            topic = catalog.get(info.topic)
            samples[info.topic, info.node] = read_samples(topic, _SAMPLED, info.node, run)
    return [samples[info.topic, info.node].get(info.table, MessageSample()) for info in infos]


def _ends_of(infos: Sequence[TopicInfo | FleetTopicInfo]) -> tuple[int, int] | None:
    """Return the times of the first and of the last message, ns; None = there are no messages."""
    firsts = [info.first_ns for info in infos if info.first_ns is not None]
    lasts = [info.last_ns for info in infos if info.last_ns is not None]
    return (min(firsts), max(lasts)) if firsts and lasts else None


def _picture_ends(infos: Sequence[TopicInfo]) -> tuple[int | None, int | None]:
    """Return the first and the last time for the picture, ns; None = there are no messages.

    They are those of the topics whose keys are times. Only without such messages those of the
    others count: the times at which messages with names were stored may lie far from all others.
    """
    timed = [info for info in infos if info.key not in NAMED_FORMATS and info.count]
    return _ends_of(timed or infos) or (None, None)


def _print_summary(description: _Description) -> None:
    from cassandra_ros.messages.stamps import iso_time

    names, ends = {info.topic for info in description.infos}, description.ends
    print(f"keyspace:  {description.keyspace} at {description.place}")
    if ends is not None:
        eras = description.activity.eras
        length = format_duration(sum(end - start for start, end in eras))
        without = f"; without pauses of ten years or more {length}" if len(eras) > 1 else ""
        print(f"duration:  {format_duration(ends[1] - ends[0])}{without}")
        for name, ns in zip(("start", "end"), ends):
            print(f"{name + ':':<10} {iso_time(ns)} ({ns // SECOND_NS}.{ns % SECOND_NS:09d})")
    print(f"size:      {format_bytes(description.bytes)}")
    print(f"messages:  {description.messages} of {counted(len(names), 'topic')}")


def _print_topics(infos: list[TopicInfo]) -> None:
    header = list(_HEADER)
    if any(info.key != "time" for info in infos):
        header.append("key")
    rows = [_topic_row(info) for info in infos]
    print(format_table(header, [[row[name] for name in header] for row in rows], right=_RIGHT))


def _print_activity(eras: list[Picture]) -> None:
    """Print bars with the number of messages over time, unless all have the same time.

    Args:
        eras: The pictures between pauses of ten years or more, each of which becomes a mark.
    """
    scales = [era.scale for era in eras if era.scale is not None]
    if not scales or scales[0].start == scales[-1].end:
        return
    lines: dict[tuple[str, str], list[str]] = {}
    for number, (era, scale) in enumerate(zip(eras, scales)):
        for lane in era.lanes:
            blank = [" " * era_scale.cells for era_scale in scales]  # a lane may lack an era
            texts = lines.setdefault((shown(lane.topic), shown(lane.node) or "-"), blank)
            texts[number] = sparkline(lane.cells(scale).counts.tolist(), sys.stdout.encoding)
    rows = [(*lane, _FOLD.join(texts)) for lane, texts in lines.items() if "".join(texts).strip()]
    if not rows:
        return
    when = _FOLD.join(
        f"{format_time(era_scale.start)} to {format_time(era_scale.end)}" for era_scale in scales
    )
    print()
    print(format_table(("activity of", "node", when), rows))


def _activity_answer(activity: Picture) -> dict[str, object]:
    """Return the picture for JSON: the number of messages in each time step, by topic and robot."""
    scale = activity.scale
    if scale is None:
        return {"start_ns": None, "step_ns": None, "topics": []}
    topics = [
        {
            "topic": lane.topic,
            "node": lane.node,
            "messages": [round(count, 3) for count in lane.cells(scale).counts.tolist()],
        }
        for lane in activity.lanes
    ]
    return {"start_ns": scale.start, "step_ns": scale.step, "topics": topics}


def _topic_row(info: TopicInfo) -> dict[str, str]:
    from cassandra_ros.messages.stamps import iso_time

    return {
        "topic": shown(info.topic),
        "type": info.type,
        "format": info.format,
        "node": shown(info.node) or "-",
        "messages": str(info.count),
        "rate": "-" if info.rate_hz is None else f"{info.rate_hz:.1f} Hz",
        "size": format_bytes(info.bytes),
        "first": "-" if info.first_ns is None else iso_time(info.first_ns),
        "last": "-" if info.last_ns is None else iso_time(info.last_ns),
        "bucket": "-" if info.key in NAMED_FORMATS else format_length(info.bucket_ns),
        "key": info.key,
    }


def _run_row(run: Run) -> tuple[str, ...]:
    return (
        shown(run.name) or "-",
        run.kind,
        shown(run.node) or "-",
        time_of(run.started),
        run.state,
        str(sum(run.stored.values())),
        str(sum(run.lost.values())),
    )


def _loss_rows(losses: list[Loss], runs: list[Run]) -> Iterator[tuple[str, ...]]:
    """Yield a table row for each topic, run and reason."""
    names = {run.writer: run.name for run in runs}
    groups: dict[tuple[str, str, int, LossKind], list[Loss]] = {}
    for loss in losses:
        groups.setdefault((loss.topic, loss.node, loss.writer, loss.kind), []).append(loss)
    for (topic, node, writer, kind), group in sorted(groups.items()):
        count = sum(loss.count for loss in group)
        # A count of 0 means that it is not known how many were lost.
        unknown = "" if all(loss.count for loss in group) else "?" if not count else " or more"
        yield (
            shown(topic),
            shown(node) or "-",
            shown(names.get(writer) or str(writer)),
            f"{count or ''}{unknown}",
            format_time(min(loss.first_ns for loss in group)),
            format_time(max(loss.last_ns for loss in group)),
            kind.value,
        )


def _answer(description: _Description) -> dict[str, object]:
    """Return the answer for YAML and JSON, in types that PyYAML can write."""
    start_ns, end_ns = description.ends or (None, None)
    times: dict[str, object] = {}
    if start_ns is not None and end_ns is not None:
        times = {
            "duration": (end_ns - start_ns) / SECOND_NS,
            "start": start_ns / SECOND_NS,
            "end": end_ns / SECOND_NS,
            "start_ns": start_ns,
            "end_ns": end_ns,
        }
    return {
        "keyspace": description.keyspace,
        **times,
        "size": description.bytes,
        "messages": description.messages,
        "types": [{"type": name, "md5": md5sum} for name, md5sum in description.types],
        "topics": list(map(_topic_answer, description.infos, description.samples)),
        "losses": [{**asdict(loss), "kind": loss.kind.value} for loss in description.losses],
        "runs": [
            {**vars(run), **{k: dict(getattr(run, k)) for k in ("labels", "stored", "lost")}}
            for run in description.runs
        ],
    }


def _topic_answer(info: TopicInfo, sample: MessageSample) -> dict[str, object]:
    """Return the answer of one entry of the topics: first the keys of rosbag, then all others."""
    values = asdict(info)
    head = {
        "topic": values.pop("topic"),
        "type": values.pop("type"),
        "messages": values.pop("count"),
        "size": values.pop("bytes"),
        "connections": len(sample.connections),
        "frequency": sample.frequency,
    }
    return {**head, **values}


def _value_of_key(answer: dict[str, object], key: str | None) -> object:
    """Return the value of -k, or the whole answer without it; InvalidOption: there is no key."""
    if key is None:
        return answer
    if key not in answer:
        raise InvalidOption(f"there is no key {key!r:.80}; there are {', '.join(answer)}")
    return answer[key]


def _print_yaml(answer: object) -> None:
    import yaml

    if isinstance(answer, (str, int, float)):
        print(shown_lines(str(answer)))  # PyYAML would add the line '...'
    else:
        print(yaml.safe_dump(answer, sort_keys=False, allow_unicode=True), end="")


_FLEET_HEADER = ("topic", "type", "format", "node", "messages", "size", "first", "last", "in")


def _print_fleet(infos: Sequence[FleetTopicInfo]) -> None:
    """Print a summary, and a line for each topic, type and robot."""
    from cassandra_ros.messages.stamps import iso_time

    ends = _ends_of(infos)
    if ends is not None:
        print(f"duration:  {format_duration(ends[1] - ends[0])}")
        print(f"start:     {iso_time(ends[0])}")
        print(f"end:       {iso_time(ends[1])}")
    print(f"size:      {format_bytes(sum(info.bytes for info in infos))}")
    topics = counted(len({info.topic for info in infos}), "topic")
    print(f"messages:  {sum(info.count for info in infos)} of {topics}, each counted once")
    if infos:
        print()
        print(format_table(_FLEET_HEADER, list(map(_fleet_row, infos)), right=("messages", "size")))


def _fleet_row(info: FleetTopicInfo) -> Sequence[str]:
    from cassandra_ros.messages.stamps import iso_time

    return (
        shown(info.topic),
        info.type,
        ", ".join(info.formats),
        shown(info.node) or "-",
        str(info.count),
        format_bytes(info.bytes),
        "-" if info.first_ns is None else iso_time(info.first_ns),
        "-" if info.last_ns is None else iso_time(info.last_ns),
        ", ".join(f"{shown(name)} {count}" for name, count in info.stores.items()) or "-",
    )


def _fleet_answer(infos: Sequence[FleetTopicInfo], missing: Mapping[str, str]) -> dict[str, object]:
    """Return the answer for YAML and JSON; ``missing`` is store → why it did not answer."""
    topics = []
    for info in infos:
        topics.append({**asdict(info), "messages": info.count, "size": info.bytes})
    return {
        "messages": sum(info.count for info in infos),
        "size": sum(info.bytes for info in infos),
        "partial": bool(missing),
        "missing": dict(missing),
        "topics": topics,
    }
