# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Record topics into Cassandra. Every message is stored exactly as it was sent.

Ctrl-C, SIGTERM and the shutdown of the node end the recording, after all received messages are
stored. The exit status is 1 if messages were lost, or if a topic that you named had no publisher.

Each recording is a run; the option --run of other programs selects it. The services ~start, ~stop,
~pause, ~resume, ~status, ~snapshot and ~mark control the recorder, if --no-services does not close
them. Every option can also be set as a private parameter of the node: its long name with _ for -,
as in ~node_id; ~topics is a list.
"""

from __future__ import annotations

import argparse
import logging
import math
import shutil
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Callable, Mapping, NamedTuple, Sequence

from cassandra_ros.arguments import check_pairs, check_pattern, check_ros_name
from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.options import (
    StoreWait,
    add_format_option,
    add_store_options,
    awaited_store,
    open_store,
    same_named,
    store_place,
    strip_remappings,
)
from cassandra_ros.cli.parsers import Parser, Rare, error_line, program_parser
from cassandra_ros.cli.quota_options import add_quota_options, check_quota_options
from cassandra_ros.cli.readers import (
    byte_size,
    checked,
    duration,
    megabytes,
    truth,
    whole_number,
)
from cassandra_ros.cli.recorder_report import (
    RecorderStatusLine,
    closing_table,
    failures,
    plan_table,
)
from cassandra_ros.cli.script import end_now
from cassandra_ros.cli.terminal_text import counted
from cassandra_ros.cli.topic_options import add_exclude_option
from cassandra_ros.errors import InvalidName, InvalidOption, UnknownFormat
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.recording.option_values import (
    BLOCK_SEC,
    read_bound,
    read_label,
    read_rate,
    read_ttl,
)

if TYPE_CHECKING:
    from cassandra_ros.recording.event_marks import WatchedEvent
    from cassandra_ros.recording.recording_options import RecorderOptions
    from cassandra_ros.recording.topic_settings import Rule

_log = logging.getLogger(__name__)

PROGRAM = "recorder"
_LOOPBACK = ("localhost", "127.", "::1")
_NO_PARAMETERS = ("help", "help_all", "version", "quiet", "dry_run", "udp")


def make_parser() -> Parser:
    """Return the parser of the command line; it uses the names of RecorderOptions."""
    parser = program_parser(PROGRAM, __doc__)
    parser.usage = "%(prog)s [OPTION ...] [TOPIC ...]"  # short, because each usage error prints it
    _add_choice(parser)
    _add_runs(parser.add_argument_group("runs").add_argument)
    _add_settings(parser)
    _add_limits(parser.add_argument_group("limits").add_argument)
    _add_spool(parser)
    _add_rosbag(parser.add_argument_group("as rosbag record has them").add_argument)
    add_store_options(parser, wait_sec=math.inf)
    return parser


Add = Callable[..., object]


def _add_choice(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("topics", metavar="TOPIC", nargs="*", help="record these topics (default: none)")
    text = "record all topics, except the recorder's own messages on /rosout and /diagnostics"
    add("-a", "--all", action="store_true", help=text)
    add("-e", "--regex", action="store_true", help="match topics using regular expressions")
    add_exclude_option(parser, "none is left out")
    add(
        "--node",
        metavar="NODE",
        default="",
        help=Rare("record all topics subscribed to by a node (default: none)"),
    )
    text = "print what would be recorded and how, and end"
    add("--dry-run", action="store_true", help=text)
    add("-q", "--quiet", action="store_true", help="suppress console output")


def _add_runs(add: Add) -> None:
    text = "prepend PREFIX to the name of the run, which is the date (default: only the date)"
    add("-o", "--output-prefix", metavar="PREFIX", default="", help=Rare(text))
    text = (
        "name of the run; several runs may have one name, which then means all of them (default: "
        "the date)"
    )
    add("-O", "--output-name", "--name", metavar="NAME", default="", help=text)
    text = "store a label with the run; may be repeated"
    add(
        "--label",
        dest="labels",
        metavar="K=V",
        type=checked(read_label),
        action="append",
        default=[],
        help=text,
    )
    text = "begin a new run when the size or duration is reached: NAME_0, NAME_1, ..."
    add("--split", action="store_true", help=text)
    text = "record this many MB of messages; with --split: into each run (default: no limit)"
    add("--size", metavar="SIZE", type=megabytes, default=0, help=text)
    text = (
        "record this long, in seconds, or 5m, 2h; with --split: each run (default: until it is "
        "stopped)"
    )
    add("--duration", type=duration, default=0.0, help=text)
    text = (
        "keep at most MAX_SPLITS runs of this recording; the messages of older ones are "
        "deleted (default: keep all)"
    )
    add("--max-splits", metavar="MAX_SPLITS", type=whole_number, default=0, help=Rare(text))
    text = "begin each run of a split recording with the latched messages"
    add("--repeat-latched", action="store_true", help=Rare(text))
    text = "publish a latched message with the name of each run on begin_write"
    add("-p", "--publish", action="store_true", help=Rare(text))
    text = (
        "keep only the newest messages, in memory, up to this duration or size; the service "
        "~snapshot stores them as a run (default: store all)"
    )
    add("-s", "--snapshot", metavar="30s|200MB", type=checked(read_bound), help=text)


def _add_settings(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "storage of topics", "TOPIC is a name or a regular expression; the first match counts"
    )
    add = group.add_argument
    add_format_option(group)
    text = "delete messages of new topics after this time, as 3600, 90m or 7d (default: never)"
    add("--ttl", metavar="SEC", type=checked(read_ttl), default=0, help=text)
    text = (
        "record only messages of a topic that satisfy a condition as in CQL, for example "
        "'/cmd_vel: linear.x > 0.5'; other messages count as left out; may be repeated"
    )
    condition = "'TOPIC: CONDITION'"
    kind = checked(read_where)
    add("--where", metavar=condition, type=kind, action="append", default=[], help=text)
    text = "record at most HZ messages a second of a topic, or of each topic; may be repeated"
    pair = checked(read_limit)
    add("--rate-limit", metavar="[TOPIC:]HZ", type=pair, action="append", default=[], help=text)
    text = (
        "YAML file with settings for patterns of topics, and with events, as config/recorder.yaml. "
        "--where and --rate-limit override it, it overrides --format (default: no file)"
    )
    add("--config", metavar="FILE", type=checked(read_config), default=_Config(), help=text)
    text = (
        "format packed: maximum time that a message waits until its block is stored (default: "
        "0.5 s)"
    )
    add("--block-age", metavar="SEC", type=duration, default=BLOCK_SEC, help=Rare(text))
    text = "name of the robot that is recorded (default: no name)"
    add("--node-id", metavar="N", default="", help=text)


def _add_limits(add: Add) -> None:
    text = "only record NUM messages on each topic (default: all)"
    add("-l", "--limit", metavar="NUM", type=whole_number, default=0, help=text)
    text = "use an internal buffer of SIZE MB (default: 256, 0 = infinite)"
    add("-b", "--buffsize", metavar="SIZE", type=megabytes, default="256", help=Rare(text))
    text = (
        "stop storing while the disk of the local Cassandra has less free space (default: 1G; 0 = "
        "off). The free space of a Cassandra on another machine is unknown: watch it there"
    )
    add("-L", "--min-space", metavar="1G", type=byte_size, default="1G", help=Rare(text))
    add_quota_options(add)
    text = "do not publish on /diagnostics"
    add("--no-diagnostics", dest="diagnostics", action="store_false", help=Rare(text))
    text = (
        "offer no services, so that no other program of the ROS network starts, stops or pauses "
        "the recording"
    )
    add("--no-services", action="store_true", help=Rare(text))
    text = (
        "do not index the places where the robot is while its poses are recorded: NEAR then reads "
        "all poses, until 'cassandra_bag index --places' makes the index"
    )
    add("--no-places", dest="places", action="store_false", help=Rare(text))


def _add_spool(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "spool",
        "while the store does not answer or does not keep up, messages wait in files; what a "
        "recorder has left there, the next one stores",
    )
    add = group.add_argument
    text = "let messages wait in memory only (--buffsize)"
    add("--no-spool", dest="spool", action="store_false", help=Rare(text))
    text = (
        "write every message into the spool first: a recorder that is killed loses at most its "
        "last second, and the next one says so"
    )
    add("--journal", action="store_true", help=text)
    text = "maximum size of the spool (default: 2G)"
    add("--spool-size", metavar="SIZE", type=byte_size, default="2G", help=Rare(text))
    text = (
        "which messages a full spool drops; they are told as lost (default: oldest, as the buffer)"
    )
    choices = ("oldest", "newest")
    add(
        "--spool-drop",
        metavar="|".join(choices),
        choices=choices,
        default="oldest",
        help=Rare(text),
    )
    text = "folder of the spool (default: $ROS_HOME/cassandra_ros/spool, or in ~/.ros)"
    add("--spool-dir", metavar="DIR", default="", help=Rare(text))


def _add_rosbag(add: Add) -> None:
    text = "Use the TCP_NODELAY transport hint when subscribing to topics."
    add("--tcpnodelay", action="store_true", help=Rare(text))
    text = "accepted without effect: Cassandra compresses its tables with LZ4"
    add("-j", "--bz2", action="store_true", help=Rare(text))
    add("--lz4", action="store_true", help=Rare(text))
    text = (
        "accepted without effect: messages over 512 KiB are always stored in chunks of that "
        "size (default)"
    )
    add("--chunksize", metavar="SIZE", type=whole_number, help=Rare(text))
    add("--udp", action="store_true", help=Rare("refused: rospy has no UDP transport"))


def read_where(text: str) -> tuple[str, str]:
    """Parse 'TOPIC: CONDITION'. Return a pattern of topics and the condition."""
    from cassandra_ros.recording.topic_settings import check_condition

    topic, colon, condition = (word.strip() for word in text.partition(":"))
    if not (topic and colon and condition):
        raise InvalidOption(f"{text!r} is not of the form 'TOPIC: CONDITION'")
    return check_pattern(topic), check_condition(condition)


def read_limit(text: str) -> tuple[str, float]:
    """Parse '[TOPIC:]HZ'. Return a pattern of topics and the rate, Hz."""
    topic, _, rate = text.rpartition(":")
    return check_pattern(topic.strip() or ".*"), read_rate(rate.strip())


class _Config(NamedTuple):
    """What a settings file says."""

    rules: Sequence[Rule] = ()
    events: Sequence[WatchedEvent] = ()


def read_config(name: str) -> _Config:
    """Read a settings file. An empty name, which a launch file may pass, means no file."""
    if not name:
        return _Config()
    from cassandra_ros.recording.topic_settings import read_events, read_settings

    try:
        text = Path(name).read_text(encoding="utf-8")
        return _Config(read_settings(text, name), read_events(text, name))
    except (OSError, UnicodeDecodeError) as exc:
        raise InvalidOption(f"the settings {name!r} cannot be read: {exc}") from exc


def words_of(
    parser: Parser, parameters: Mapping[str, object], given: argparse.Namespace
) -> list[str]:
    """Return the parameters of the node as command line arguments.

    The caller puts them before the real arguments, which ``parser`` has just parsed as ``given``.
    Parameters that the command line gives, too, are left out, and those that select topics if it
    selects topics; only lists get the values of both.
    """
    actions = {action.dest: action for action in parser._actions}
    chosen = bool(given.topics or given.all or given.node)
    words: list[str] = []
    for name, value in parameters.items():
        dest = {"name": "output_name", "label": "labels"}.get(name, name)
        action = actions.get(dest)
        if action is None or dest in _NO_PARAMETERS:
            parser.error(f"there is no parameter ~{name}: parameters are called like options")
        if dest in parser.given or (dest in ("topics", "all", "node") and chosen):
            continue
        values = value if isinstance(value, list) else [value]
        if dest == "topics":
            texts = str(value).split() if isinstance(value, str) else map(str, values)
            words += ["--all" if text == "-a" else text for text in texts]
        elif action.nargs == 0:
            # --no-diagnostics and --no-places are given if the parameter is false.
            try:
                if truth(str(value)) != (action.const is False):
                    words.append(action.option_strings[-1])
            except argparse.ArgumentTypeError as exc:
                parser.error(f"parameter ~{name}: {exc}")
        else:
            words += [f"{action.option_strings[-1]}={text}" for text in values if text != ""]
    return words


def read_options(parser: argparse.ArgumentParser, options: argparse.Namespace) -> RecorderOptions:
    """Return the options of the recorder; end the program if they contradict each other."""
    from cassandra_ros.recording.recording_options import RecorderOptions

    if options.udp:
        parser.error("--udp: rospy has no UDP transport; leave it out: TCP loses nothing")
    if bool(options.topics) == options.all and not (options.node and not options.topics):
        parser.error("give topics to record, or -a for all" + (", not both" * options.all))
    if options.split and not (options.size or options.duration):
        parser.error("--split needs --size or --duration: when is the next run to begin?")
    if options.max_splits and not options.split:
        parser.error("--max-splits needs --split")
    if options.snapshot and (options.split or options.size or options.duration or options.limit):
        parser.error(
            "--snapshot writes when it is asked: leave out --split, --size, --duration and --limit"
        )
    if options.snapshot and options.no_services:
        parser.error(
            "--snapshot writes when the service ~snapshot is called: leave out --no-services"
        )
    check_quota_options(options, parser)
    if options.journal and not options.spool:
        parser.error("--journal needs the spool: leave out --no-spool")
    try:
        if options.format:
            format_class(options.format)
        for text in options.topics:
            (check_pattern if options.regex else check_ros_name)(text)
        labels = check_pairs("--label", options.labels)
        check_pairs("--where", options.where, "join the conditions with AND or OR")
        check_pairs("--rate-limit", options.rate_limit)
    except (InvalidName, InvalidOption, UnknownFormat) as exc:
        parser.error(str(exc))
    values = same_named(RecorderOptions, options)
    values.update(labels=labels, config=options.config.rules, events=options.config.events)
    hosts, port = store_place(options)
    values.update(free_space=local_space(hosts), address=f"{','.join(hosts)}:{port}")
    return RecorderOptions(**values)


def local_space(hosts: Sequence[str]) -> Callable[[], int | None] | None:
    """Return a function that returns the free disk space of the local Cassandra, bytes.

    The function returns None while the local Cassandra has no data directory.

    Returns:
        The function; None if the store is not on this machine.
    """
    from cassandra_ros.local_server.jars import default_directory

    data = default_directory()
    if not all(host.startswith(_LOOPBACK) for host in hosts):
        return None
    # Checked at each call: the local Cassandra may be created while the recorder waits for it.
    return lambda: shutil.disk_usage(data).free if data.is_dir() else None


def main() -> int:
    """Run the recorder; return the exit status."""
    parser = make_parser()
    answer_shell(parser)
    words = strip_remappings(None)
    given = parser.parse_args(words)  # wrong usage and --help need no master
    from cassandra_ros.messages.ros_master import master_answers

    if given.topics or given.all or given.node or not master_answers():
        read_options(parser, given)
    from cassandra_ros.nodes.diagnostics import KeyspaceAddress
    from cassandra_ros.nodes.recorder_node import record, start_node
    from cassandra_ros.nodes.subscriptions import make_plan
    from cassandra_ros.recording.store_future import NO_STORE, is_there

    options = parser.parse_args([*words_of(parser, start_node(sys.argv), given), *words])
    chosen = read_options(parser, options)
    line = RecorderStatusLine(sys.stdout if not options.quiet and sys.stdout.isatty() else None)
    say = partial(line.say, quiet=options.quiet)
    if options.dry_run:
        options.wait = 0.0 if math.isinf(options.wait) else options.wait
        with open_store(options, make=True) as ros_cas:
            plan = make_plan(ros_cas.catalog, chosen)
        print(plan_table(plan, chosen))
        return _tell_problems([topic_plan.problem for topic_plan in plan if topic_plan.problem])
    place = KeyspaceAddress(store_place(options)[0], options.keyspace)
    with awaited_store(options, StoreWait(_log.warning, _meanwhile(chosen))) as store:
        show = line.show if line.shows else None
        reports, problem = record(store, chosen, place, say, show)
        spooled = sum(report.spooled for report in reports)
        if not (problem or spooled or is_there(store)):
            problem = NO_STORE
    say(closing_table(reports, rates=not chosen.snapshot))
    spool = chosen.spool_plan
    if spooled and spool is not None:
        say(
            f"{counted(spooled, 'message')} in the spool {spool.folder.path}: the next recorder "
            "for this store stores them, or 'cassandra_bag spool drain'. For another store: "
            "'cassandra_bag spool drain RUN --host HOST', where 'cassandra_bag spool list' names "
            "RUN; elsewhere: copy the folder and add '--spool-dir FOLDER'"
        )
    status = _tell_problems([problem] * bool(problem) + failures(reports))
    if not store.done():
        end_now(status)
    return status


def _meanwhile(options: RecorderOptions) -> str:
    """Say where messages wait until the store answers for the first time."""
    plan = options.spool_plan
    where = "memory" if plan is None else f"the spool {plan.folder.path}"
    return f", messages wait in {where}"


def _tell_problems(problems: Sequence[str]) -> int:
    """Print the problems as error lines; return the exit status."""
    for text in problems:
        print(error_line(PROGRAM, text), file=sys.stderr)
    return 1 if problems else 0
