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
from typing import Callable, Sequence

from cassandra_ros.arguments import check_pairs, check_pattern, check_ros_name
from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.options import (
    StoreWait,
    add_store_options,
    awaited_store,
    open_store,
    same_named,
    store_place,
    strip_remappings,
)
from cassandra_ros.cli.parameters import parameter_words
from cassandra_ros.cli.parsers import Parser, Rare, add_options, error_line, program_parser
from cassandra_ros.cli.recorder_report import (
    RecorderStatusLine,
    closing_table,
    failures,
    plan_table,
)
from cassandra_ros.cli.script import end_now
from cassandra_ros.cli.terminal_text import counted
from cassandra_ros.errors import InvalidName, InvalidOption, UnknownFormat
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.quantities import whole_number
from cassandra_ros.recording.recorder_options import RecorderOptions

_log = logging.getLogger(__name__)

PROGRAM = "recorder"
_LOOPBACK = ("localhost", "127.", "::1")


def make_parser() -> Parser:
    """Return the parser of the command line: the fields of RecorderOptions, and some more."""
    parser = program_parser(PROGRAM, __doc__)
    parser.usage = "%(prog)s [OPTION ...] [TOPIC ...]"  # short, because each usage error prints it
    add_options(parser, RecorderOptions)
    text = "print what would be recorded and how, and end"
    parser.add_argument("--dry-run", action="store_true", help=text)
    parser.add_argument("-q", "--quiet", action="store_true", help="suppress console output")
    add = parser.add_argument_group("without effect, for scripts of rosbag record").add_argument
    text = "none: Cassandra compresses its tables with LZ4"
    add("-j", "--bz2", action="store_true", help=Rare(text))
    add("--lz4", action="store_true", help=Rare(text))
    text = "none: messages over 512 KiB are always stored in chunks of that size (default)"
    add("--chunksize", metavar="SIZE", type=whole_number, help=Rare(text))
    add("--udp", action="store_true", help=Rare("refused: rospy has no UDP transport"))
    add_store_options(parser, wait_sec=math.inf)
    return parser


def read_options(parser: argparse.ArgumentParser, options: argparse.Namespace) -> RecorderOptions:
    """Return the options of the recorder; end the program if they are wrong or contradict."""
    if options.udp:
        parser.error("--udp: rospy has no UDP transport; leave it out: TCP loses nothing")
    is_anything_chosen = options.topics or options.all or options.node
    if not is_anything_chosen or (options.topics and options.all):
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
    if options.drop_uncopied and not options.max_size:
        parser.error("--drop-uncopied needs --max-size")
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
    hosts, port = store_place(options)
    address = f"{','.join(hosts)}:{port}"
    values.update(labels=labels, free_space=local_space(hosts), address=address)
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
    command_line = parser.parse_args(words)  # wrong usage and --help need no master
    from cassandra_ros.messages.ros_master import master_answers

    if not master_answers():
        read_options(parser, command_line)  # what is wrong needs no master to be told
    from cassandra_ros.nodes.diagnostics import KeyspaceAddress
    from cassandra_ros.nodes.recorder_node import record, start_node
    from cassandra_ros.nodes.subscriptions import make_plan
    from cassandra_ros.recording.store_future import NO_STORE, is_there

    # Topics of the command line take the place of those of the parameters.
    is_chosen = bool(command_line.topics or command_line.all or command_line.node)
    without = ("topics", "all", "node") if is_chosen else ()
    options = parser.parse_args([*parameter_words(parser, start_node(sys.argv), without), *words])
    recorder_options = read_options(parser, options)
    line = RecorderStatusLine(sys.stdout if not options.quiet and sys.stdout.isatty() else None)
    say = partial(line.say, quiet=options.quiet)
    if options.dry_run:
        options.wait = 0.0 if math.isinf(options.wait) else options.wait
        with open_store(options, make=True) as ros_cas:
            plan = make_plan(ros_cas.catalog, recorder_options)
        print(plan_table(plan, recorder_options))
        return _tell_problems([topic_plan.problem for topic_plan in plan if topic_plan.problem])
    place = KeyspaceAddress(store_place(options)[0], options.keyspace)
    with awaited_store(options, StoreWait(_log.warning, _meanwhile(recorder_options))) as store:
        show = line.show if line.shows else None
        reports, problem = record(store, recorder_options, place, say, show)
        spooled = sum(report.spooled for report in reports)
        if not (problem or spooled or is_there(store)):
            problem = NO_STORE
    say(closing_table(reports, rates=not recorder_options.snapshot))
    spool = recorder_options.spool_plan
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
    """Print the problems as error lines; return the exit status, 0 without problems."""
    for text in problems:
        print(error_line(PROGRAM, text), file=sys.stderr)
    return 1 if problems else 0
