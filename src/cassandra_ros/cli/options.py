# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Options that several programs and verbs have, and the connection to the store that they name."""

from __future__ import annotations

import argparse
import math
import os
import re
import signal
import sys
import threading
import time
import weakref
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from types import FrameType
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Iterable,
    Iterator,
    NoReturn,
    Protocol,
    Sequence,
    TypeVar,
)

from cassandra_ros.arguments import check_pairs
from cassandra_ros.cli.far_times import check_times, read_time
from cassandra_ros.cli.parsers import Rare
from cassandra_ros.errors import ConnectionFailed, InvalidOption, TlsMismatch
from cassandra_ros.printable import shown, shown_lines
from cassandra_ros.quantities import exact_seconds
from cassandra_ros.store.connection.address import (
    DEFAULT_HOST,
    DEFAULT_KEYSPACE,
    DEFAULT_PORT,
    from_environment,
    port_number,
)
from cassandra_ros.store.connection.login import CQLSHRC, CREDENTIALS, read_login

if TYPE_CHECKING:
    from concurrent.futures import Future

    from cassandra_ros.client.ros_cassandra import RosCassandra
    from cassandra_ros.messages.stamps import Stamp
    from cassandra_ros.topics.event_finder import AroundRule, EventRule

_Value = TypeVar("_Value")

DEFAULT_CONSISTENCY = "LOCAL_QUORUM"
"""A majority of the copies must answer, so that a read sees each acknowledged write."""
CONSISTENCY_LEVELS = ("ONE", "TWO", "QUORUM", DEFAULT_CONSISTENCY, "ALL")
"""Values of --consistency."""
Tell = Callable[[str], object]
"""Function that tells the user a text."""
RETRY_SEC = 1.0
"""Interval between two attempts to connect during --wait, s."""
REFUSED_RETRY_SEC = 10.0
"""The same where the store answered and refused, as for a wrong password, s."""
TELL_SEC = 60.0
"""Interval at which it is told that there is no store yet, s."""
_MOST_TABLES = 5
"""Maximum number of tables of another program named in a warning."""
_OWN_SIGNS = ("--map", "--where", "--around", "--keep", "--event")
"""Options whose values may contain ``:=``."""
_REMAPPING = re.compile(r"[A-Za-z0-9_~/]*:=")


def add_large_chunks_option(parser: argparse._ActionsContainer) -> None:
    """Add --allow-large-chunks, for verbs that read bags."""
    parser.add_argument(
        "--allow-large-chunks",
        action="store_true",
        help=Rare(
            "also read chunks of more than 256 MiB of content, and files that unpack to more than "
            "1000 times their size (default: refuse them). Only for files that you trust: a small "
            "file that was made to do harm can fill the memory and the disk"
        ),
    )


def add_store_options(
    parser: argparse.ArgumentParser, prefix: str = "", wait_sec: float = 0.0
) -> None:
    """Add the options for address, login and keyspace of the store; open_store reads them.

    Args:
        prefix: Prefix of --host and --port, for a program that has other options of these names:
            'store-'.
        wait_sec: Default of --wait, s; inf = no limit.
    """
    group = parser.add_argument_group(
        "store",
        "defaults also from CASSANDRA_ROS_HOST, CASSANDRA_ROS_PORT, CASSANDRA_ROS_KEYSPACE, "
        "CASSANDRA_ROS_CQLSHRC, SSL_CERTFILE, SSL_VALIDATE. Passwords are read from files only",
    )
    group.add_argument(
        f"--{prefix}host",
        dest="host",
        metavar="HOST[,HOST]",
        type=lambda text: text or None,  # a launch file may pass an empty value
        default=from_environment("HOST") or None,
        help="address of one or more nodes of the cluster (default: that of the cqlshrc, else "
        f"{DEFAULT_HOST})",
    )
    group.add_argument(
        f"--{prefix}port",
        dest="port",
        metavar="PORT",
        type=read_port,
        # A text, so that argparse reports a wrong value from the environment like a wrong option.
        default=from_environment("PORT") or None,
        help=f"port for CQL (default: that of the cqlshrc, else {DEFAULT_PORT})",
    )
    _add_login_options(group.add_argument)
    group.add_argument(
        "--keyspace",
        metavar="NAME",
        default=from_environment("KEYSPACE") or DEFAULT_KEYSPACE,
        help="the keyspace that holds the topics (default: %(default)s)",
    )

    group.add_argument(
        "--consistency",
        metavar="LEVEL",
        type=str.upper,
        choices=CONSISTENCY_LEVELS,
        default=DEFAULT_CONSISTENCY,
        help=Rare(
            "how many copies of a row must answer: ONE, TWO, QUORUM, LOCAL_QUORUM or ALL; ONE "
            "reads what the nodes that answer have (default: %(default)s)"
        ),
    )
    unlimited = math.isinf(wait_sec)
    without = "no limit; 0: end at once with the error" if unlimited else f"{wait_sec:g}"
    group.add_argument(
        "--wait",
        metavar="SECONDS",
        type=read_seconds,
        default=wait_sec,
        help=Rare(
            f"maximum time to wait for a store that does not answer yet (default: {without})"
        ),
    )


def _add_login_options(add: Callable[..., object]) -> None:
    add(
        "--cqlshrc",
        metavar="FILE",
        type=lambda text: text or None,
        help=Rare(
            "file with the address of the cluster and its TLS settings, as for cqlsh (default: "
            f"{CQLSHRC})"
        ),
    )
    add(
        "--credentials",
        metavar="FILE",
        type=lambda text: text or None,
        help=Rare(
            "file with user name and password, as for cqlsh; only you may read it, mode 600 "
            f"(default: that of the cqlshrc, else {CREDENTIALS})"
        ),
    )


def read_seconds(text: str) -> float:
    """Read a number of seconds, at least 0, without a unit; raises InvalidOption."""
    if not re.fullmatch(r"[0-9]{1,9}(\.[0-9]*)?", text):
        raise InvalidOption(f"{text!r} is not a number of seconds, like 30 or 2.5")
    return float(text)


def read_port(text: str) -> int:
    """Read a TCP port; raises InvalidOption."""
    return port_number(text or "nothing")  # '' would mean the default, and hide a mistake


def store_place(options: argparse.Namespace) -> tuple[list[str], int]:
    """Return the hosts and the port from options, environment and the files of cqlsh."""
    login = read_login(options.host, options.port, options.cqlshrc, options.credentials)
    return login.hosts, login.port


def _print_error(text: str) -> None:
    print(shown_lines(text), file=sys.stderr, flush=True)


@dataclass(frozen=True)
class StoreWait:
    """What a program does while the store does not answer yet."""

    tell: Tell = _print_error
    """Gets a text that says so, with the reason, at once and then every TELL_SEC."""
    meanwhile: str = ""
    """What happens meanwhile, as a clause: ', messages wait in memory'."""
    given_up: threading.Event = field(default_factory=threading.Event)
    """Set when the program does not need the store any more."""


def open_store(
    options: argparse.Namespace, make: bool = False, wait: StoreWait | None = None
) -> RosCassandra:
    """Connect to the store that the options name. The caller closes it (a context manager).

    Times of options that lie far outside of what is stored are told, see ``check_times``.

    Args:
        options: Those that add_store_options adds; run, if it is there.
        make: The keyspace may be missing; the first write creates it.
        wait: What to do during --wait; default: to tell it on stderr.

    Raises:
        ConnectionFailed: No store answers, with what the local Cassandra knows of the reason.
        KeyspaceNotFound: The keyspace is missing, and ``make`` is false.
        InvalidOption: A file of the login cannot be used, or a time is not valid.
    """
    from cassandra_ros.local_server.disk import local_nodes

    ros_cas = _connect(options, wait or StoreWait())
    # Find the directories now: those of a server that has ended cannot be found.
    directories = _local_directories(options)
    ros_cas.cassandra.outage.tell_reason(partial(_trouble, directories))
    ros_cas.cassandra.expect_nodes(max(map(local_nodes, directories), default=0))
    hurry_on_interrupt(ros_cas.cassandra.outage)
    try:
        if not make:
            ros_cas.catalog.keyspace.side_tables.require_keyspace()
            _tell_namesakes(ros_cas, options)
        check_times(options, [ros_cas.catalog])
    except BaseException:
        ros_cas.close()
        raise
    return ros_cas


def _tell_namesakes(ros_cas: RosCassandra, options: argparse.Namespace) -> None:
    """Say on stderr that the name of a run that an option gives means several runs."""
    run = getattr(options, "run", None)
    if isinstance(run, str):
        several = ros_cas.catalog.keyspace.runs.describe_several(run)
        if several:
            _print_error(f"{several}; the number means one of them")


def foreign_keyspace(ros_cas: RosCassandra, before: str = "") -> str:
    """Return a warning that the keyspace only holds tables of another program; '' = it does not.

    Args:
        ros_cas: The store.
        before: Text to put before a warning, as '; '.
    """
    from cassandra_ros.topics.keyspace_list import tables_of_others

    tables = tables_of_others(ros_cas.cassandra, str(ros_cas.keyspace))
    if not tables:
        return ""
    named = ", ".join(map(shown, tables[:_MOST_TABLES]))
    more = ", …" if len(tables) > _MOST_TABLES else ""
    whose = f"keyspace {ros_cas.keyspace} is of another program"
    return f"{before}{whose}: its tables are {named}{more}"


class Hurried(Protocol):
    """An object that waits for answers of a store."""

    def hurry(self) -> None:
        """End all waits soon."""


class _Interrupt:
    """Handler of Ctrl-C that also ends the waits for all stores that a program has open."""

    def __init__(self) -> None:
        self.waits: weakref.WeakSet[Hurried] = weakref.WeakSet()
        """What waits for a store; a store that was closed and deleted leaves it by itself."""

    def __call__(self, number: int, frame: FrameType | None) -> None:
        for wait in list(self.waits):
            wait.hurry()
        signal.default_int_handler(number, frame)


def hurry_on_interrupt(wait: Hurried) -> None:
    """Let Ctrl-C also end the waits for the store while a program closes what it has open.

    A program that handles Ctrl-C itself, as a node does, keeps its handler.
    """
    handler = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()
    if main and handler is signal.default_int_handler:
        handler = _Interrupt()
        signal.signal(signal.SIGINT, handler)
    if isinstance(handler, _Interrupt):
        handler.waits.add(wait)


@contextmanager
def awaited_store(options: argparse.Namespace, wait: StoreWait) -> Iterator[Future[RosCassandra]]:
    """Open the store as ``open_store`` does, on a thread: the caller goes on during ``--wait``.

    The keyspace may be missing. With ``--wait 0`` the store is opened here, before the block. On
    exit the store is closed, or not waited for any more: then the thread may still be connecting.
    """
    from concurrent.futures import Future

    store: Future[RosCassandra] = Future()
    if options.wait:
        args = (store, options, wait)
        threading.Thread(target=_open_into, args=args, name="store-wait", daemon=True).start()
    else:
        store.set_result(open_store(options, make=True))
    try:
        yield store
    finally:
        wait.given_up.set()
        if store.done() and store.exception() is None:
            store.result().close()


def _open_into(store: Future[RosCassandra], options: argparse.Namespace, wait: StoreWait) -> None:
    try:
        store.set_result(open_store(options, make=True, wait=wait))
    except Exception as exc:  # noqa: BLE001 - the caller of result() gets it
        store.set_exception(exc)


def _connect(options: argparse.Namespace, wait: StoreWait) -> RosCassandra:
    """Connect; repeat it for the time that --wait gives, or until the wait is given up."""
    from cassandra_ros.client.ros_cassandra import RosCassandra

    ends = time.monotonic() + options.wait
    tell_due = -math.inf  # the first failure is told at once
    unlimited = math.isinf(ends)
    how_long = "no store yet" if unlimited else f"waiting up to {options.wait:g} s for the store"
    while True:
        try:
            return RosCassandra(
                options.host,
                options.port,
                keyspace=options.keyspace,
                cqlshrc=options.cqlshrc,
                credentials=options.credentials,
                consistency=options.consistency,
            )
        except ConnectionFailed as exc:
            failure = _explain(exc, options)
            # A server that refuses once refuses again; without a limit the user may correct it.
            over = time.monotonic() >= ends or wait.given_up.is_set()
            if over or (exc.refused and not unlimited):
                raise failure from exc
            if time.monotonic() >= tell_due:
                tell_due = time.monotonic() + TELL_SEC
                wait.tell(f"{how_long}{wait.meanwhile}: {failure}")
            pause = REFUSED_RETRY_SEC if exc.refused else RETRY_SEC
            wait.given_up.wait(min(pause, max(ends - time.monotonic(), 0.0)))


def _explain(exc: ConnectionFailed, options: argparse.Namespace) -> ConnectionFailed:
    """Return the error with what the local Cassandra knows of the reason."""
    directories = _local_directories(options)
    if isinstance(exc, TlsMismatch):
        return TlsMismatch(f"{exc}{_own_login(directories)}")
    trouble = "" if exc.refused else _trouble(directories)
    return ConnectionFailed(f"{exc}; {trouble}") if trouble else exc


def _local_directories(options: argparse.Namespace) -> list[Path]:
    """Return the data directories of the store's nodes that are local Cassandras."""
    from cassandra_ros.local_server.disk import local_directory

    hosts, port = store_place(options)
    directories = (local_directory(host, port) for host in hosts)
    return sorted({directory for directory in directories if directory is not None})


def _trouble(directories: Sequence[Path]) -> str:
    """Return why one of the local Cassandras may refuse writes; '' = no known reason."""
    from cassandra_ros.local_server.disk import disk_trouble

    return next(filter(None, map(disk_trouble, directories)), "")


def _own_login(directories: Sequence[Path]) -> str:
    """Return a hint with the login file of the local Cassandra; '' if there is no such file."""
    from cassandra_ros.local_server import LocalCluster

    files = (LocalCluster(directory).security.cqlshrc for directory in directories)
    cqlshrc = next((file for file in files if os.access(file, os.R_OK)), None)
    return f"; or give --cqlshrc {cqlshrc} (roslaunch: secure:=true)" if cqlshrc else ""


def add_time_options(parser: argparse.ArgumentParser, what: str = "") -> None:
    """Add --start and --end, with ``what`` before their help texts; read_times reads them."""
    parser.add_argument("--start", metavar="T", help=f"{what}first time (default: no limit)")
    parser.add_argument("--end", metavar="T", help=f"{what}last time, included (default: no limit)")
    parser.set_defaults(time_options=("start", "end"))


def read_times(options: argparse.Namespace) -> tuple[Stamp | None, Stamp | None]:
    """Return --start and --end; None = open.

    Raises:
        InvalidOption: A text is not a time, or the start is after the end.
    """
    start, end = (read_time(name, getattr(options, name)) for name in ("start", "end"))
    if start is not None and end is not None and start > end:
        raise InvalidOption(f"--start {options.start} is after --end {options.end}")
    return start, end


def add_event_options(parser: argparse._ActionsContainer, what: str = "") -> None:
    """Add --event, --before and --after, with ``what`` before their help texts."""
    add = parser.add_argument
    text = f"{what}only messages of a robot during its events of this name (default: of all time)"
    add("--event", metavar="NAME", help=text)
    text = f"{what}with --event: time before each event, as 5s or 2m (default: 0)"
    add("--before", metavar="SEC", type=exact_seconds, help=text)
    text = f"{what}with --event: time after each event (default: 0)"
    add("--after", metavar="SEC", type=exact_seconds, help=text)


def read_event(options: argparse.Namespace) -> EventRule:
    """Return the events that --event, --before and --after choose; None = --event is missing.

    The program ends if --before or --after have nothing to go with: --event, or --around of a verb
    that has this option.
    """
    if options.event is not None:
        return options.event, options.before or 0.0, options.after or 0.0
    if (options.before or options.after) and getattr(options, "around", None) is None:
        also = " or --around" if hasattr(options, "around") else ""
        options.parser.error(f"--before and --after go with --event{also}")
    return None


def add_around_option(parser: argparse._ActionsContainer, what: str) -> None:
    """Add --around; ``what``: its help text."""
    parser.add_argument("--around", metavar="'TOPIC: CONDITION'", help=what)


def read_around(options: argparse.Namespace) -> AroundRule:
    """Return what --around, --before and --after choose; None = --around is missing."""
    if options.around is None:
        return None
    if options.event is not None:
        options.parser.error("--around and --event choose times: give one of them")
    before, after = options.before, options.after
    return options.around, 5.0 if before is None else before, 10.0 if after is None else after


def add_origin_options(parser: argparse.ArgumentParser) -> None:
    """Add --node-id and --run, which select messages by robot and by run."""
    add = parser.add_argument
    add("--node-id", metavar="N", help="only messages of this robot (default: all robots)")
    add(
        "--run",
        metavar="NAME",
        help="only messages of the recordings or imports with this name or writer id, or of the "
        "import of this file (default: all)",
    )


def add_message_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that select messages by time, event, robot, run and condition."""
    add_time_options(parser)
    add_event_options(parser)
    add_origin_options(parser)
    add_where_option(parser)


def add_where_option(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """Add --where; read_where reads it."""
    parser.add_argument(
        "--where",
        metavar="'TOPIC: CONDITION'",
        action="append",
        type=lambda text: read_pair(text, ":", "'TOPIC: CONDITION'"),
        default=[],
        help="only messages of this topic that satisfy a condition as in CQL, for example "
        "'/cmd_vel: linear.x > 0.5'; other topics are not filtered; may be repeated",
    )


def read_pair(text: str, sign: str, form: str) -> tuple[str, str]:
    """Read two texts around the first separator, without blanks at their ends.

    Args:
        text: The text of an option.
        sign: The separator.
        form: How such a text looks, for the error text.

    Raises:
        InvalidOption: One of both texts is empty.
    """
    left, _, right = (word.strip() for word in text.partition(sign))
    if not (left and right):
        raise InvalidOption(f"{text!r} is not of the form {form}")
    return left, right


def read_where(options: argparse.Namespace) -> dict[str, str]:
    """Return the conditions of --where by topic."""
    return read_conditions(options, "where")


def read_conditions(options: argparse.Namespace, name: str) -> dict[str, str]:
    """Return the conditions of a repeated option ('keep' of --keep), by topic; see read_pairs."""
    return read_pairs(options, f"--{name}", getattr(options, name), "join them with AND or OR")


def read_pairs(
    options: argparse.Namespace,
    option: str,
    pairs: Iterable[tuple[str, _Value]],
    remedy: str = "give it once",
) -> dict[str, _Value]:
    """Return the pairs of an option as a mapping; end the program if two have the same key."""
    try:
        return check_pairs(option, pairs, remedy)
    except InvalidOption as exc:
        end_program: Callable[[str], NoReturn] = options.parser.error
        end_program(str(exc))


def same_named(kind: type[Any], options: argparse.Namespace) -> dict[str, Any]:
    """Return the values of those options that have the name of a field of a dataclass, by name."""
    return {f.name: getattr(options, f.name) for f in fields(kind) if hasattr(options, f.name)}


def without_empty(words: Sequence[str]) -> list[str]:
    """Remove options with an empty value, like ``--run=``, which launch files pass."""
    return [word for word in words if not re.fullmatch(r"--[a-z][a-z-]*=", word)]


def strip_remappings(argv: Sequence[str] | None) -> list[str]:
    """Remove arguments that rosrun and roslaunch add: ``__name:=x``, ``_param:=y``, ``from:=to``.

    Like rospy.myargv, but without rospy. Two kinds of arguments with ``:=`` are kept: those whose
    left side is not a name (a statement, say), and the values of --map, --where, --around, --keep,
    --event.

    Args:
        argv: Arguments without the program's name; None = the arguments of the process.
    """
    words = sys.argv[1:] if argv is None else argv
    return [
        word
        for previous, word in zip(["", *words], words)
        if not _REMAPPING.match(word) or previous in _OWN_SIGNS
    ]
