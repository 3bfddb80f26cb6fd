# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Play what is stored on the topics from which it came, in the order of its reception.

Messages go out as the stored bytes, advertised with the stored definition, also of types that are
not installed. Names are remapped as everywhere in ROS: /scan:=/old/scan.

Times are seconds from the first message (12.5), seconds since 1970 (1368021980.25), nanoseconds
(from 13 digits on) or ISO 8601 (2013-05-08T14:06:20Z, no zone means UTC).

On a terminal: space pauses and resumes, s steps while paused, t turns --pause-topics off and on.
The services ~pause, ~resume, ~step, ~seek, ~setRate, ~stop and ~status (and ~pause_playback, as
rosbag play has it) do so from elsewhere.
"""

from __future__ import annotations

import argparse
import sys
import time
from typing import TYPE_CHECKING

from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.keyboard import Keyboard
from cassandra_ros.cli.options import (
    add_store_options,
    add_where_option,
    open_store,
    read_pair,
    read_where,
    strip_remappings,
    without_empty,
)
from cassandra_ros.cli.parsers import program_parser
from cassandra_ros.cli.readers import (
    duration,
    factor,
    megabytes,
    regular_expression,
    seconds,
    whole_number,
)
from cassandra_ros.cli.terminal_text import counted
from cassandra_ros.errors import InvalidName, InvalidOption
from cassandra_ros.printable import shown, shown_lines

if TYPE_CHECKING:
    from cassandra_ros.nodes.player import PlayerState
    from cassandra_ros.playing.play_options import PlayerOptions
    from cassandra_ros.playing.selection import PlaySelection

PROGRAM = "player"
SHOW_SEC = 0.1
_STATES = {"paused": "PAUSED ", "delayed": "DELAYED", "waiting": "WAITING", "ended": "ENDED  "}


class _Once(argparse.Action):
    """Refuses an option that is given twice: argparse would forget the first without a word."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option_string: str | None = None,
    ) -> None:
        if getattr(namespace, self.dest, None):
            parser.error(f"{option_string} is given twice: only one is taken")
        setattr(namespace, self.dest, values)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = program_parser(PROGRAM, __doc__)
    parser.usage = "%(prog)s [OPTION ...] [TOPIC ...]"
    parser.set_defaults(parser=parser)
    parser.add_argument("-q", "--quiet", action="store_true", help="suppress console output")
    _add_selection(parser.add_argument_group("what is played"))
    _add_pace(parser.add_argument_group("how"))
    _add_names(parser.add_argument_group("on which topics"))
    add_store_options(parser)
    return parser


def _add_selection(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add("topics", metavar="TOPIC", nargs="*", help="play these topics (default: all)")
    text = "the same, for those who know rosbag play (default: none more)"
    add("--topics", metavar="TOPIC", dest="more", nargs="+", default=[], help=text)
    add("-e", "--regex", action="store_true", help="match topics using regular expressions")
    text = "leave out topics whose whole name matches this regular expression (default: none)"
    add("-x", "--exclude", metavar="EXCLUDE_REGEX", type=regular_expression, default="", help=text)
    add("-s", "--start", metavar="T", help="begin there (default: with the first message)")
    add(
        "-u",
        "--duration",
        metavar="SEC",
        type=duration,
        help="play only SEC seconds (default: to the end)",
    )
    add("--end", metavar="T", help="last time, included (default: the last message)")
    text = "only messages of this recording or import: name or number (default: of all)"
    add("--run", metavar="RUN", action=_Once, help=text)
    add("--node-id", metavar="N", action=_Once, help="only messages of this node (default: of all)")
    add_where_option(group)
    add(
        "--around",
        metavar="'TOPIC: CONDITION'",
        action=_Once,
        help="play only what lies around the messages of a topic that satisfy a condition, of all "
        "topics (default: play all)",
    )
    text = "how far before them, with --around (default: %(default)s)"
    add("--before", metavar="SEC", type=seconds, default=5.0, help=text)
    text = "and how far behind (default: %(default)s)"
    add("--after", metavar="SEC", type=seconds, default=10.0, help=text)
    align = group.add_mutually_exclusive_group()
    text = "play all runs as if their first messages had come at once"
    align.add_argument("--align-start", action="store_true", help=text)
    text = "the same of all nodes: the runs of a node stay one behind the other"
    align.add_argument(
        "--align-nodes", action="store_const", const="node", dest="align_start", help=text
    )


def _add_pace(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    text = "multiply the publish rate by FACTOR (default: %(default)s)"
    add("-r", "--rate", metavar="FACTOR", type=factor, default=1.0, help=text)
    text = "play back all messages without waiting, but for slow subscribers"
    add("-i", "--immediate", action="store_true", help=text)
    add("--pause", action="store_true", help="start in paused mode")
    text = "pause before each message of these topics (default: of none)"
    add("--pause-topics", metavar="TOPIC", nargs="+", default=[], help=text)
    text = "jump over stretches without a message of more than SEC seconds (default: over none)"
    add("--skip-empty", metavar="SEC", type=seconds, help=text)
    add("-l", "--loop", action="store_true", help="loop playback")
    text = "stay at the end: for late subscribers of latched topics, and for ~seek"
    add("-k", "--keep-alive", action="store_true", help=text)
    text = "wait SEC seconds after advertising, to allow subscribers to connect (default: 0.2)"
    add("-d", "--delay", metavar="SEC", type=seconds, default=0.2, help=text)
    text = "wait for at least one subscriber on each topic before publishing"
    add("--wait-for-subscribers", action="store_true", help=text)
    text = "watch this topic, and wait while its last stamp is further behind (default: none)"
    add("--rate-control-topic", metavar="TOPIC", default="", help=text)
    text = "by how much it may lag behind (default: %(default)s)"
    add("--rate-control-max-delay", metavar="SEC", type=seconds, default=1.0, help=text)
    text = "read so much ahead of the time (default: 64)"
    add("--read-ahead", metavar="MB", type=megabytes, default="64", help=text)


def _add_names(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add(
        "-p",
        "--prefix",
        metavar="PREFIX",
        default="",
        help="prefix all output topics (default: none)",
    )
    text = "put the node, or the run, before the names: /<node>/topic"
    add("--node-prefix", action="store_true", help=text)
    text = "use an outgoing queue of size SIZE for each subscriber (default: 100, 0 = infinite)"
    add("--queue", metavar="SIZE", type=whole_number, default=100, help=text)
    add("--clock", action="store_true", help="publish the clock time")
    text = "use a frequency of HZ when publishing clock time (default: 100)"
    add("--hz", metavar="HZ", type=factor, default=100.0, help=text)


def read_selection(options: argparse.Namespace) -> PlaySelection:
    """Return what is to be played."""
    from cassandra_ros.playing.selection import PlaySelection

    around = options.around
    return PlaySelection(
        topics=[*options.topics, *options.more] or None,
        regex=options.regex,
        exclude=options.exclude,
        start=options.start,
        end=options.end,
        duration=options.duration,
        nodeID=options.node_id,
        run=options.run,
        where=read_where(options) or None,
        prefix=options.prefix,
        around=around and read_pair(around, ":", "'TOPIC: CONDITION'"),
        before=options.before,
        after=options.after,
        align_start=options.align_start,
        node_prefix=options.node_prefix,
    )


def read_options(options: argparse.Namespace) -> PlayerOptions:
    """Return how it is to be played."""
    from cassandra_ros.playing.play_options import PlayerOptions

    return PlayerOptions(
        rate=options.rate,
        immediate=options.immediate,
        paused=options.pause,
        loop=options.loop,
        keep_alive=options.keep_alive,
        skip_empty=options.skip_empty,
        pause_topics=options.pause_topics,
        queue=options.queue,
        clock_hz=options.hz if options.clock else 0.0,
        delay=options.delay,
        wait_for_subscribers=options.wait_for_subscribers,
        rate_control_topic=options.rate_control_topic,
        rate_control_max_delay=options.rate_control_max_delay,
        read_ahead=options.read_ahead,
    )


def main() -> int:
    """Play; return the exit status."""
    parser = make_parser()
    answer_shell(parser)
    options = parser.parse_args(without_empty(strip_remappings(None)))
    try:
        selection, chosen = read_selection(options), read_options(options)
    except (InvalidName, InvalidOption, argparse.ArgumentTypeError) as exc:
        options.parser.error(str(exc))
    from cassandra_ros.nodes.player_node import play

    def say(text: str) -> None:
        if not options.quiet:
            print(shown_lines(text), flush=True)

    with open_store(options) as ros_cas, Keyboard() as keyboard:
        shows = not options.quiet and sys.stdout.isatty()
        line = StatusLine(shows, hint=not options.quiet and keyboard.is_there)
        state = play(ros_cas, selection, chosen, sys.argv, say, line.show, keyboard.pressed)
        line.end()
    say(closing_line(state))
    return 0


class StatusLine:
    """The line of rosbag play, on a terminal: what it does, at which time."""

    def __init__(self, shows: bool, hint: bool = False) -> None:
        self._shows = shows
        self._hint = hint
        self._next = 0.0

    def show(self, state: PlayerState) -> None:
        """Write the line anew, some times a second; before the first one which keys there are."""
        if self._hint:
            self._hint = False
            print("Hit space to toggle paused, or 's' to step.", flush=True)
        if not self._shows or time.monotonic() < self._next:
            return
        self._next = time.monotonic() + SHOW_SEC
        print("\r" + status_line(state) + "               \r", end="", flush=True)

    def end(self) -> None:
        """Leave the line."""
        if self._shows:
            print(flush=True)


def status_line(state: PlayerState) -> str:
    """Write what a player does, as rosbag play writes it."""
    done, length = (state.time - state.start) / 1e9, (state.end - state.start) / 1e9
    return (
        f" [{_STATES.get(state.state, 'RUNNING')}]  Bag Time: {state.time / 1e9:13.6f}   "
        f"Duration: {done:.6f} / {length:.6f}"
    )


def closing_line(state: PlayerState) -> str:
    """Say what was played."""
    published = sum(topic.published for topic in state.topics)
    missed = sum(topic.missed for topic in state.topics)
    left_out = sum(topic.left_out for topic in state.topics)
    number = len(state.topics)
    text = f"played {counted(published, 'message')} of {counted(number, 'topic')}"
    if missed:
        text += f"; slow subscribers missed {missed}"
    if left_out:
        text += f"; {left_out} left out: " + ", ".join(
            f"{topic.left_out} of {shown(topic.topic)}" for topic in state.topics if topic.left_out
        )
    return text
