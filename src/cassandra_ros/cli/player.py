# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Publish stored messages on their topics, in the order of their receive times.

The player publishes the stored bytes under the stored message definition, so types need not be
installed. Remap names as everywhere in ROS: /scan:=/old/scan. A stored topic whose name is not
valid in ROS is played under another name: '/my topic:=/my_topic'.

Times are seconds from the first message (12.5), seconds since 1970 (1368021980.25), nanoseconds
(from 13 digits on) or ISO 8601 (2013-05-08T14:06:20Z, no zone means UTC).

With --store, given once or several times, the messages of all these stores are played as one, each
once; a store that does not answer is named, and the replay goes on with the others.

On a terminal: space pauses and resumes, s steps while paused, t turns --pause-topics off and on.
Other nodes control the player by the services ~pause, ~resume, ~step, ~seek, ~setRate, ~stop and
~status (and ~pause_playback, as of rosbag play), if --no-services does not close them.
"""

from __future__ import annotations

import argparse
import os
import select
import sys
import termios
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Callable

from cassandra_ros.arguments import check_pairs
from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.fleet_options import add_fleet_options, open_fleet, tell_missing
from cassandra_ros.cli.options import (
    add_around_option,
    add_store_options,
    add_where_option,
    open_store,
    read_pair,
    read_where,
    same_named,
    strip_remappings,
    without_empty,
)
from cassandra_ros.cli.parsers import Rare, add_option, add_options, program_parser
from cassandra_ros.cli.terminal_text import counted
from cassandra_ros.errors import InvalidName, InvalidOption
from cassandra_ros.playing.play_options import PlayerOptions
from cassandra_ros.printable import shown, shown_lines
from cassandra_ros.quantities import exact_duration, exact_seconds, factor
from cassandra_ros.shared_options import EXCLUDE

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra
    from cassandra_ros.nodes.player import PlayerState
    from cassandra_ros.playing.play_selection import PlaySelection
    from cassandra_ros.stores.fleet.fleet import Fleet

PROGRAM = "player"
SHOW_SEC = 0.1
"""Minimum interval between two updates of the status line, s."""
_REMAP = ":="
_STATES = {"paused": "PAUSED ", "delayed": "DELAYED", "waiting": "WAITING", "ended": "ENDED  "}


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = program_parser(PROGRAM, __doc__)
    parser.usage = "%(prog)s [OPTION ...] [TOPIC ...]"
    parser.set_defaults(parser=parser)
    parser.add_argument("-q", "--quiet", action="store_true", help="suppress console output")
    _add_selection(parser.add_argument_group("what is played"))
    _add_names(parser.add_argument_group("names and clock").add_argument)
    add_options(parser, PlayerOptions)
    add_store_options(parser)
    add_fleet_options(parser)
    return parser


def _add_selection(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    add("topics", metavar="TOPIC", nargs="*", help="play these topics (default: all)")
    text = "further topics, as with rosbag play; may be repeated (default: no further topics)"
    add(
        "--topics",
        dest="more",
        metavar="TOPIC",
        nargs="+",
        action="extend",
        default=[],
        help=Rare(text),
    )
    add("-e", "--regex", action="store_true", help="match topics using regular expressions")
    add_option(group, "exclude", EXCLUDE, [])
    add("-s", "--start", metavar="T", help="first time (default: the first message)")
    add(
        "-u",
        "--duration",
        metavar="SEC",
        type=exact_duration,
        help="play only SEC seconds (default: play to the end)",
    )
    add("--end", metavar="T", help="last time, included (default: the last message)")
    text = "only messages of this recording or import: name or writer id (default: all)"
    add("--run", metavar="RUN", help=text)
    text = "only messages of this robot (default: all robots)"
    add("--node-id", metavar="N", help=text)
    add_where_option(group)
    text = "play all topics, but only around the times at which a message of TOPIC satisfies "
    add_around_option(group, text + "CONDITION (default: play everything)")
    text = "play only messages of a robot during its events of this name (default: of all time)"
    add("--event", metavar="NAME", help=text)
    text = "time to play before each of these messages (default: 5), or of the events (default: 0)"
    add("--before", metavar="SEC", type=exact_seconds, help=text)
    text = "time to play after each of these messages (default: 10), or of the events (default: 0)"
    add("--after", metavar="SEC", type=exact_seconds, help=text)
    align = group.add_mutually_exclusive_group()
    text = "play all runs at once, as if their first messages had the same time"
    align.add_argument("--align-start", action="store_true", help=Rare(text))
    text = "play all robots at once; the runs of one robot are played one after the other"
    align.add_argument(
        "--align-nodes", action="store_const", const="node", dest="align_start", help=Rare(text)
    )


def _add_names(add: Callable[..., object]) -> None:
    text = "prefix all output topics (default: none)"
    add("-p", "--prefix", metavar="PREFIX", default="", help=text)
    text = "prefix each topic with its robot, or with its run: /<robot>/topic"
    add("--node-prefix", action="store_true", help=Rare(text))
    add("--clock", action="store_true", help="publish the clock time")
    text = "use a frequency of HZ when publishing clock time (default: 100)"
    add("--hz", metavar="HZ", type=factor, default=100.0, help=Rare(text))


def read_selection(options: argparse.Namespace) -> PlaySelection:
    """Return the selection of messages that the options describe.

    Raises:
        InvalidName, InvalidOption: An option is not valid.
    """
    from cassandra_ros.playing.play_selection import PlaySelection

    around, values = options.around, same_named(PlaySelection, options)
    # Where --before or --after is missing --around has the defaults of the class, --event 0.
    reach = {name: values.pop(name) for name in ("before", "after")}
    event = (options.event, reach["before"] or 0.0, reach["after"] or 0.0)
    values.update({name: length for name, length in reach.items() if length is not None})
    words = [*options.topics, *options.more]
    # rospy remaps names that are valid in ROS; the player also remaps stored ones that are not.
    remap = [read_pair(word, _REMAP, f"FROM{_REMAP}TO") for word in words if _REMAP in word]
    values.update(
        topics=[word for word in words if _REMAP not in word] or None,
        remap=check_pairs("FROM:=TO", remap),
        nodeID=options.node_id,
        where=read_where(options) or None,
        event=event if options.event else None,
        around=around and read_pair(around, ":", "'TOPIC: CONDITION'"),
    )
    return PlaySelection(**values)


def read_options(options: argparse.Namespace) -> PlayerOptions:
    """Return the options of the player that the command line gives."""
    clock_hz = options.hz if options.clock else 0.0
    return PlayerOptions(**same_named(PlayerOptions, options), clock_hz=clock_hz)


def main() -> int:
    """Run the player; return the exit status."""
    parser = make_parser()
    answer_shell(parser)
    options = parser.parse_args(without_empty(strip_remappings(None)))
    try:
        selection, player_options = read_selection(options), read_options(options)
    except (InvalidName, InvalidOption) as exc:
        options.parser.error(str(exc))
    from cassandra_ros.nodes.player_node import play

    def say(text: str) -> None:
        if not options.quiet:
            print(shown_lines(text), flush=True)

    with ExitStack() as opened:
        store: RosCassandra | Fleet
        store = open_fleet(options) if options.stores else open_store(options)
        opened.enter_context(store)
        keyboard = opened.enter_context(Keyboard())
        if options.no_services and not keyboard.is_there:
            _require_no_pause(options)
        shows = not options.quiet and sys.stdout.isatty()
        line = PlayerStatusLine(shows, hint=not options.quiet and keyboard.is_there)
        state = play(store, selection, player_options, sys.argv, say, line.show, keyboard.pressed)
        line.end()
    say(closing_line(state))
    return tell_missing(state.missing, PROGRAM)


def _require_no_pause(options: argparse.Namespace) -> None:
    """Refuse pauses that neither a key nor a service could end."""
    pausing_options = {"--pause": options.paused, "--pause-topics": options.pause_topics}
    for name in [name for name, value in pausing_options.items() if value]:
        options.parser.error(
            f"{name} pauses until a key is pressed or a service is called, and there is no "
            f"terminal: leave out {name} or --no-services"
        )


class PlayerStatusLine:
    """The status line of rosbag play: state and current time.

    Args:
        shows: Whether to print the line; only on a terminal, because it overwrites itself.
        hint: Whether to print which keys can be pressed, when ``show`` is called first.
    """

    def __init__(self, shows: bool, hint: bool = False) -> None:
        self._shows = shows
        self._hint = hint
        self._next = 0.0

    def show(self, state: PlayerState) -> None:
        """Update the line, unless the last update was less than SHOW_SEC ago."""
        if self._hint:
            self._hint = False
            print("Hit space to toggle paused, or 's' to step.", flush=True)
        if not self._shows or time.monotonic() < self._next:
            return
        self._next = time.monotonic() + SHOW_SEC
        print("\r" + status_line(state) + "               \r", end="", flush=True)

    def end(self) -> None:
        """Move the cursor to the next line, if the status line is there."""
        if self._shows:
            print(flush=True)


def status_line(state: PlayerState) -> str:
    """Return the state of a player as rosbag play prints it."""
    return (
        f" [{_STATES.get(state.state, 'RUNNING')}]  Bag Time: {state.time / 1e9:13.6f}   "
        f"Duration: {state.played / 1e9:.6f} / {state.length / 1e9:.6f}"
    )


def closing_line(state: PlayerState) -> str:
    """Return how many messages were played, missed and left out, in words."""
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


class Keyboard:
    """Reads single key presses, if standard input is a terminal and this is a foreground process.

    A context manager; on exit it restores the settings of the terminal.
    """

    def __init__(self) -> None:
        self._fd = -1
        self._earlier_settings: list[Any] | None = None
        """Settings of the terminal to be restored; None = keys cannot be read (any more)."""

    @property
    def is_there(self) -> bool:
        """Whether keys can be read."""
        return self._earlier_settings is not None

    def __enter__(self) -> Keyboard:
        try:
            self._fd = sys.stdin.fileno()
            # A background process is stopped when it changes the terminal.
            if os.isatty(self._fd) and os.tcgetpgrp(self._fd) == os.getpgrp():
                self._earlier_settings = termios.tcgetattr(self._fd)
                settings = termios.tcgetattr(self._fd)
                settings[3] &= ~(termios.ICANON | termios.ECHO)
                settings[6][termios.VMIN], settings[6][termios.VTIME] = 0, 0
                termios.tcsetattr(self._fd, termios.TCSANOW, settings)
        except (OSError, ValueError, AttributeError, termios.error):
            self._earlier_settings = None  # standard input is closed or cannot be changed
        return self

    def __exit__(self, *exc_info: object) -> None:
        if self._earlier_settings is not None:
            settings, self._earlier_settings = self._earlier_settings, None
            try:
                termios.tcsetattr(self._fd, termios.TCSANOW, settings)
            except termios.error:
                pass  # the terminal is gone

    def pressed(self) -> str:
        """Return the keys that were pressed since the last call, without waiting; '' = none."""
        if self._earlier_settings is None or not select.select([self._fd], [], [], 0)[0]:
            return ""
        try:
            return os.read(self._fd, 64).decode("utf-8", "replace")
        except OSError:
            self._earlier_settings = None  # the terminal is gone
            return ""
