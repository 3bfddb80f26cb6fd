# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The name, the log on /rosout and the clock of a node of this package."""

from __future__ import annotations

import contextlib
import copy
import errno
import hashlib
import logging
import os
import signal
import socket
import struct
import threading
import time
import xmlrpc.client
from http.client import HTTPException
from types import FrameType
from typing import Callable, Iterable, Iterator, Mapping, Sequence
from urllib.parse import urlparse
from xml.parsers.expat import ExpatError

import rospy
from rospy.impl import tcpros_base

from cassandra_ros.errors import ClockNotSet, InvalidName
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.ros_master import MasterTransport, master_answers, master_uri
from cassandra_ros.nodes.subscription import subscribe
from cassandra_ros.printable import shown_lines

_log = logging.getLogger(__name__)

_OURS = "cassandra_ros"
"""Name of the logger of this package."""
_ROSPY = "rosout"
"""Name of the logger that rospy.logwarn and similar functions use."""
_LOG = "/rosout"
"""Topic of the log."""
_STAMP = struct.Struct("<II")
"""A serialised rosgraph_msgs/Clock."""
_NAME = "__name:="
"""Start of the command line word that sets the name of a node."""
_TIMEOUT_SEC = 2.0
"""Maximum time to connect to another node, s."""
MASTER_SEC = 5.0
"""Maximum time for an answer of the master, s."""
ALONE_SEC = 10.0
"""Maximum time to wait for another program that starts a node of the same name, s."""
_POLL_SEC = 0.05
_TELL_SEC = 0.5
"""Time without an answer of the master after which a program says that it waits for it, s."""
MASTER_ERRORS = (OSError, HTTPException, xmlrpc.client.Error, ExpatError)
"""Exceptions of a request to a master that does not answer, or ends while it answers."""


@contextlib.contextmanager
def own_name(default: str, argv: Sequence[str]) -> Iterator[tuple[str, str, bool]]:
    """Give the name of a node, its full name, and whether a node of that name is running.

    Start the node within the context: of programs on this machine that start at the same moment one
    after the other is in it, so each knows of the ones before.

    Args:
        default: Name if the command line has no ``__name:=x``.
        argv: The command line.
    """
    given = [word[len(_NAME) :] for word in argv if word.startswith(_NAME)]
    name = given[-1] if given else default
    full_name = str(rospy.get_namespace()) + name
    with _alone(full_name):
        yield name, full_name, _is_taken(full_name)


def await_master() -> None:
    """Wait until the ROS master answers; say what is waited for after _TELL_SEC.

    The main thread calls it before ``init_node``, which waits in silence, and ends late.

    Raises:
        KeyboardInterrupt, SystemExit: SIGINT came, or SIGTERM (status 143).
    """
    uri, answers, ended = master_uri(), threading.Event(), threading.Event()

    def ask() -> None:
        while not (ended.is_set() or master_answers()):
            ended.wait(_TELL_SEC)
        answers.set()

    def signalled(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)

    # A thread of its own asks: the search for the address of a host ignores signals.
    threading.Thread(target=ask, name="ask the master", daemon=True).start()
    # With & a shell ignores SIGINT, which counts all the same.
    before = {n: signal.signal(n, signalled) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        if not answers.wait(_TELL_SEC):
            _log.warning(
                "waiting for the ROS master at %s (ROS_MASTER_URI): start roscore there, or set "
                "ROS_MASTER_URI to the address of another one",
                shown_lines(uri),
            )
            answers.wait()
    finally:
        ended.set()
        for number, handler in before.items():
            signal.signal(number, handler)


def read_headers_on_threads() -> None:
    """Let rospy read each connection header on a thread of its own; call it before ``init_node``.

    rospy waits for the header of one peer after the other. If a peer connects and sends no header,
    all later peers would get neither topics nor services of the node. Such a peer may have lost its
    network at that moment, or it looks for an ended node that had the same port.
    """
    server = tcpros_base.init_tcpros_server()
    accept = server._tcp_server_callback

    def accept_on_thread(sock: socket.socket, address: tuple[str, int]) -> None:
        threading.Thread(target=accept, args=(sock, address), name="accept", daemon=True).start()

    server._tcp_server_callback = accept_on_thread


def start_named_node(
    default: str,
    argv: Sequence[str],
    *,
    signals: bool = False,
    rosout: bool = True,
    rostime: bool = False,
    alone: bool = False,
) -> Mapping[str, object]:
    """Start a node, or an anonymous one if a node of its name is running; return its parameters.

    An anonymous node also has the parameters of the name that the command line gives it: roslaunch
    has written them there.

    Args:
        default: Name if the command line has no ``__name:=x``.
        argv: The command line.
        signals: Whether rospy handles SIGINT and SIGTERM.
        rosout: Whether the log goes to the topic that /rosout is remapped to; False = to /rosout.
        rostime: Whether rospy follows /clock if /use_sim_time is set; False = its time is that of
            the machine, see ``follow_clock``.
        alone: Whether a second node of the name is refused instead.

    Raises:
        InvalidName: With ``alone``: a node of the same name is running.
        KeyboardInterrupt, SystemExit: A signal came while it waited for a master.
    """
    await_master()
    with own_name(default, argv) as (name, full_name, taken):
        if taken and alone:  # two nodes of one name would replace each other's services
            raise InvalidName(
                f"a node {full_name} runs already: stop it with rosnode kill {full_name}, "
                "or give this one another name with __name:=other"
            )
        # With a name on the command line rospy would not choose an anonymous one.
        words = [word for word in argv if not (taken and word.startswith(_NAME))]
        read_headers_on_threads()
        try:
            rospy.init_node(
                name,
                argv=words,
                anonymous=taken,
                disable_signals=not signals,
                disable_rostime=not rostime,
                disable_rosout=not rosout,
            )
        except rospy.ROSInitException as exc:
            if not (signals and rospy.is_shutdown()):
                raise
            # rospy handled a signal while it waited for a master.
            raise KeyboardInterrupt from exc
    if not rosout:
        log_as_rosout()
    forward_logging()
    bound_master_calls()
    if taken:
        _log.warning("a node %s runs already; this one is %s", full_name, rospy.get_name())
    parameters: dict[str, object] = {}
    for place in (full_name, "~") if len(words) < len(argv) else ("~",):
        values = rospy.get_param(place, {})
        if isinstance(values, dict):
            parameters.update(values)
    return parameters


def offer_services(
    services: Iterable[tuple[str, type, Callable[..., object]]],
    say: Callable[[str], object],
    *,
    none: bool = False,
) -> None:
    """Advertise the services of a node that was started, and say where they are.

    Args:
        services: Of each its name, as "~pause", its class and its handler.
        say: Prints a line for the user.
        none: Whether to advertise none, so that no other program controls the node.
    """
    if none:
        say(f"{rospy.get_name()} offers no services")
        return
    for name, kind, handler in services:
        rospy.Service(name, kind, handler)
    say(f"services under {rospy.get_name()}")


@contextlib.contextmanager
def _alone(full_name: str) -> Iterator[None]:
    """Wait at most ALONE_SEC until no other program on this machine is in this context."""
    text = f"{os.environ.get('ROS_MASTER_URI')} {full_name}".encode("utf-8", "surrogateescape")
    address = b"\0cassandra_ros " + hashlib.sha256(text).digest()
    ends = time.monotonic() + ALONE_SEC
    with contextlib.ExitStack() as held:
        with contextlib.suppress(OSError):  # a system without such sockets: names are as in ROS
            lock = held.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
            # An address that begins with NUL is not a file; it is free again when the program ends.
            while not _is_bound(lock, address) and time.monotonic() < ends:
                time.sleep(_POLL_SEC)
        yield


def _is_bound(lock: socket.socket, address: bytes) -> bool:
    """Bind a socket to an address; return False if another program has it."""
    try:
        lock.bind(address)
    except OSError as exc:
        if exc.errno == errno.EADDRINUSE:
            return False
        raise
    return True


def _is_taken(full_name: str) -> bool:
    """Return whether a node of this name is running; False also if no master answers yet."""
    try:
        code, _, uri = rospy.get_master().lookupNode(full_name)
    except MASTER_ERRORS:
        return False  # init_node waits for the master
    if code != 1:
        return False
    where = urlparse(uri)
    try:
        socket.create_connection((where.hostname, where.port), _TIMEOUT_SEC).close()
    except ConnectionRefusedError:
        return False  # it ended without unregistering
    except OSError:
        return True  # it may be running out of reach
    return True


class _Forwarder(logging.Handler):
    """A handler that hands log records to the logger of rospy, with their place in the code."""

    def emit(self, record: logging.LogRecord) -> None:
        target = logging.getLogger(_ROSPY)
        if target.isEnabledFor(record.levelno):
            safe = copy.copy(record)
            # Escaped because rospy prints it: names of topics and publishers come from outside.
            safe.msg, safe.args = shown_lines(record.getMessage()), None
            # The terminal may be gone. A thread that warns goes on without it.
            with contextlib.suppress(OSError, ValueError):
                target.handle(safe)


def log_as_rosout() -> None:
    """Write the log to /rosout itself, also where /rosout is remapped.

    Call it after an ``init_node`` with ``disable_rosout``. Otherwise a node that plays a stored
    /rosout under another name would write its own log under that name.
    """
    mappings = rospy.names.get_resolved_mappings()
    renamed = mappings.pop(_LOG, None)
    rospy.impl.rosout.init_rosout()
    rospy.impl.rosout.load_rosout_handlers(None)
    if renamed is not None:
        mappings[_LOG] = renamed


def forward_logging() -> None:
    """Forward the logger ``cassandra_ros`` to rospy; call it after rospy.init_node."""
    logger = logging.getLogger(_OURS)
    if any(isinstance(handler, _Forwarder) for handler in logger.handlers):
        return
    logger.addHandler(_Forwarder())
    logger.setLevel(logging.INFO)
    logger.propagate = False  # rospy's logger writes to the node's log file already
    for name in list(logging.root.manager.loggerDict):
        # init_node configures logging again, which disables existing loggers.
        if name.split(".")[0] == _OURS:
            logging.getLogger(name).disabled = False
    # The driver warns of settings that this package has chosen.
    logging.getLogger("cassandra").setLevel(logging.ERROR)


def bound_master_calls() -> None:
    """Set a timeout for rospy's calls to its master; call it after rospy.init_node.

    Without it rospy waits for ever, so that a robot outside the network could not end a recording.
    """
    # The existing proxies are changed: other parts of rospy hold references to them.
    for proxy in rospy.core._xmlrpc_cache.values():
        proxy._ServerProxy__transport = MasterTransport(MASTER_SEC)


def follow_clock() -> None:
    """Set rospy's time from /clock if /use_sim_time is set.

    rospy itself would subscribe to /clock with a queue of one message, which any other subscription
    of the process shares: a recorder of /clock would lose most of its messages. So nodes are
    started with ``disable_rostime=True``, and this function subscribes to /clock.
    """
    if rospy.get_param("/use_sim_time", False):
        rospy.rostime._set_rostime(rospy.Time(0, 0))
        subscribe("/clock", _set_time)


def ros_now_ns() -> int:
    """Return the time, ns, without the rounding of rospy's wall clock, which uses a float.

    Raises:
        ClockNotSet: Simulated time is in use and no /clock message has been received.
    """
    if rospy.rostime.is_wallclock():
        return time.time_ns()
    now = int(rospy.rostime.get_rostime().to_nsec())
    if not now:
        raise ClockNotSet("simulated time is in use and no /clock message had come")
    return now


def ros_time(ns: int) -> rospy.Time:
    """Return a time, ns, as messages of ROS have it; a negative one as 0."""
    return rospy.Time(*divmod(max(0, ns), SECOND_NS))


def _set_time(topic: str, header: Mapping[str, str], wire: bytes) -> None:
    """Set rospy's time from a message of /clock; one of another type is ignored."""
    if len(wire) == _STAMP.size:
        rospy.rostime._set_rostime(rospy.Time(*_STAMP.unpack(wire)))
