# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run an Apache Cassandra on this machine, for this machine: the default store of cassandra_ros."""

from __future__ import annotations

import argparse
import functools
import shlex
import shutil
import signal
import sys
import time
from typing import Sequence

from cassandra_ros.cli.candidates import answer_shell
from cassandra_ros.cli.confirmation import add_yes_option, confirm
from cassandra_ros.cli.options import strip_remappings
from cassandra_ros.cli.parsers import VerbGroup, verbs_parser
from cassandra_ros.cli.terminal_text import format_bytes
from cassandra_ros.errors import ServerError
from cassandra_ros.local_server import LocalCluster, NodeStatus, install_jars
from cassandra_ros.local_server.disk import full_disk
from cassandra_ros.local_server.jars import cassandra_version, jars_directory
from cassandra_ros.local_server.nodes import Node, size_of
from cassandra_ros.local_server.ports import count_clients
from cassandra_ros.local_server.processes import ProgressLines
from cassandra_ros.printable import shown
from cassandra_ros.store.connection.address import DEFAULT_HOST, DEFAULT_PORT

EXIT_NOT_RUNNING = 3
"""Exit status of `status` if not every node answers."""
# roslaunch sends SIGINT to all its programs at once, and SIGTERM 15 s later. Before that the
# recorder must store its buffered messages, and the drain takes 3 s.
CLIENTS_SEC = 9.0
"""Maximum time that `run` waits for clients to disconnect before it stops Cassandra, s."""
_STATUS_POLL_SEC = 0.3
_CLIENTS_POLL_SEC = 0.1


def install(options: argparse.Namespace) -> int:
    """Download Apache Cassandra's jars, once for all local clusters.

    Maven does it, or without Maven the Python package maven-artifact. They are stored in
    $ROS_HOME/cassandra_ros/jars, or in the folder that $CASSANDRA_ROS_JARS
    names. `start` downloads them if they are missing. `install` also starts Cassandra once, without
    data, so that Java can archive its classes: each later start is faster.
    """
    from cassandra_ros.local_server.class_archive import make_class_archive

    how = "is now" if install_jars(say) else "was already"
    try:
        make_class_archive(say)
    except ServerError as exc:
        say(f"starts will take longer: {exc}")
    say(f"Apache Cassandra {cassandra_version()} {how} in {jars_directory()}")
    return 0


def start(options: argparse.Namespace) -> int:
    """Start the local Cassandra and return when it answers.

    It keeps running after this command has ended and the terminal is closed. Options are stored, so
    the next start needs none. If Cassandra is running already, nothing happens.
    """
    cluster = open_cluster(options)
    begun = time.monotonic()
    if cluster.start():
        say(f"Cassandra answers at {where(cluster)} after {time.monotonic() - begun:.0f} s")
        _say_memory(cluster)
        say(f"data and logs: {cluster.directory}")
        _say_login(cluster)
    else:
        say(f"Cassandra runs already at {where(cluster)}")
    _say_address(cluster)
    return 0


def _say_memory(cluster: LocalCluster) -> None:
    """Say how much memory several nodes take."""
    taken = [status.memory_bytes for status in cluster.status()]
    if len(taken) > 1:
        sizes = ", ".join(map(format_bytes, taken))
        say(f"the {len(taken)} nodes take {format_bytes(sum(taken))} of memory now ({sizes})")


def _say_login(cluster: LocalCluster) -> None:
    """Say how programs log in, if the cluster requires it."""
    if cluster.settings.secure:
        say("it asks for a login, by TLS; programs, and cqlsh --cqlshrc, find theirs with:")
        say(f"  export CASSANDRA_ROS_CQLSHRC={shlex.quote(str(cluster.security.cqlshrc))}")


def _say_address(cluster: LocalCluster) -> None:
    """Say how programs find a Cassandra that is not where they look for it."""
    settings = cluster.settings
    values_and_defaults = {
        "HOST": (settings.host, DEFAULT_HOST),
        "PORT": (settings.port, DEFAULT_PORT),
    }
    texts = [
        f"CASSANDRA_ROS_{n}={value}"
        for n, (value, usual) in values_and_defaults.items()
        if value != usual
    ]
    if texts:
        say(f"programs find it with:\n  export {' '.join(texts)}")


def stop(options: argparse.Namespace) -> int:
    """Stop the local Cassandra, after it has finished its requests and written all data to disk."""
    cluster = open_cluster(options)
    begun = time.monotonic()
    if cluster.stop():
        seconds = time.monotonic() - begun
        stays = f"its data stay in {cluster.directory}"
        say(f"Cassandra at {where(cluster)} stopped after {seconds:.0f} s; {stays}")
    else:
        say(f"no Cassandra of {cluster.directory} was running")
    return 0


def status(options: argparse.Namespace) -> int:
    """Show whether the local Cassandra is running, its addresses, disk space and memory.

    The exit status is 0 if every node answers, else 3.
    """
    deadline = time.monotonic() + options.wait
    while True:
        cluster = open_cluster(options)  # again: the first start may just have written settings
        nodes = cluster.status() if cluster.exists else []
        answers = bool(nodes) and all(node.answers for node in nodes)
        if answers or time.monotonic() >= deadline:
            break
        time.sleep(_STATUS_POLL_SEC)
    if not nodes:
        say(f"no Cassandra was ever started in {cluster.directory}")
        return EXIT_NOT_RUNNING
    for node_status in nodes:
        say(_describe(node_status))
        _say_holdings(node_status.node)
    free = shutil.disk_usage(cluster.directory).free
    heap = f"heap {cluster.settings.java_heap_mb}M a node"
    say(f"directory {cluster.directory}, {format_bytes(free)} free, {heap}")
    _say_login(cluster)
    if cluster.settings.secure and (loss := cluster.security.loss()):
        say(f"warning: {loss}")
    if full := full_disk(cluster.directory):
        say(f"warning: {full}")
    return 0 if answers else EXIT_NOT_RUNNING


def _describe(status: NodeStatus) -> str:
    node = status.node
    if status.answers:
        state = f"answers, pid {status.pid}"
    elif status.pid:
        state = f"runs and does not answer, pid {status.pid}, log {node.log}"
    else:
        state = "does not run"
    memory = f", {format_bytes(status.memory_bytes)} of memory" if status.pid else ""
    size = format_bytes(size_of(node.directory))
    return f"node {node.number} {node.address}:{node.settings.port} {state}{memory}, {size} on disk"


def _say_holdings(node: Node) -> None:
    """Say what a node has: the size of each keyspace, and the writes that wait for other nodes."""
    sizes = [f"{shown(name)} {format_bytes(size)}" for name, size in node.keyspace_bytes().items()]
    if sizes:
        say(f"  keyspaces: {', '.join(sizes)}")
    if waiting := node.hint_bytes():
        say(f"  {format_bytes(waiting)} of writes wait here for nodes that were away")


def run(options: argparse.Namespace) -> int:
    """Run the local Cassandra in the foreground until Ctrl-C or SIGTERM, then stop it.

    For launch files and service managers. Before the stop, connected clients get 9 s to disconnect;
    a second Ctrl-C ends this wait. If Cassandra is running already, this command only waits, and
    leaves it running.
    """
    cluster = open_cluster(options)
    _on_signals(signal.default_int_handler)
    running_before = any(node.pid for node in cluster.status())
    try:
        cluster.start(die_with_us=True)
        say(f"Cassandra answers at {where(cluster)}")
        _say_login(cluster)
        cluster.wait()
    except KeyboardInterrupt:
        if cluster.has_started and not running_before:
            _let_clients_go(cluster.settings.port)
    finally:
        _on_signals(signal.SIG_IGN)  # another Ctrl-C must not interrupt the drain
        # Another program may have started it while this one waited for its lock.
        if cluster.has_started and not running_before and cluster.stop():
            say(f"Cassandra at {where(cluster)} stopped")
    return 0


def _let_clients_go(port: int) -> None:
    """Wait until all clients have disconnected, at most CLIENTS_SEC or until a signal."""
    deadline = time.monotonic() + CLIENTS_SEC
    try:
        while count_clients(port) and time.monotonic() < deadline:
            show_progress("waiting for clients to go", CLIENTS_SEC - deadline + time.monotonic())
            time.sleep(_CLIENTS_POLL_SEC)
    except KeyboardInterrupt:
        pass


def _on_signals(handler: signal._HANDLER) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def clear(options: argparse.Namespace) -> int:
    """Delete all data of the local Cassandra: every keyspace, every recorded topic.

    Stop it first. The jars are kept.
    """
    cluster = open_cluster(options)
    if not cluster.exists:
        say(f"there is nothing to clear in {cluster.directory}")
        return 0
    if not options.yes:
        size = sum(size_of(node.directory) for node in cluster.nodes) / 1e6
        confirm(f"Delete all data in {cluster.directory} ({size:.0f} MB)?")
    cluster.clear()
    say(f"cleared {cluster.directory}")
    return 0


def replace(options: argparse.Namespace) -> int:
    """Restore a node that has lost its data from the other nodes, which must be running.

    They send it their copies, then all copies are compared. A keyspace with one copy of each row
    has lost the rows of that node.
    """
    cluster = open_cluster(options)
    begun = time.monotonic()
    cluster.replace(options.number)
    say(f"node {options.number} has its data again after {time.monotonic() - begun:.0f} s")
    _say_holdings(cluster.nodes[options.number - 1])
    return 0


def repair(options: argparse.Namespace) -> int:
    """Compare the copies of all nodes, which must be running, and send each node what it lacks.

    Do so if a node was away for more than three hours, or after the number of copies of a keyspace
    was raised. Shorter absences repair themselves: the other nodes keep the writes.
    """
    cluster = open_cluster(options)
    begun = time.monotonic()
    cluster.repair()
    say(f"all copies are equal after {time.monotonic() - begun:.0f} s")
    for status in cluster.status():
        say(_describe(status))
        _say_holdings(status.node)
    return 0


VERBS = {
    verb.__name__: verb for verb in (install, start, stop, status, run, replace, repair, clear)
}


def _add_arguments(name: str, parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    parser.set_defaults(nodes=None, host=None, port=None, heap=None, secure=None)
    if name == "install":  # pom.xml defines what is downloaded
        return
    add(
        "--dir",
        metavar="DIR",
        help="folder of its data (default: $CASSANDRA_ROS_DIR, else $ROS_HOME/cassandra_ros, else "
        "~/.ros/cassandra_ros)",
    )
    if name == "replace":
        add("number", metavar="N", type=int, help="number of the node; the first one is 1")
    if name in ("start", "run"):
        _add_server_options(parser)
    elif name == "status":
        text = "maximum time to wait until it answers, seconds (default: 0)"
        add("--wait", metavar="SEC", type=float, default=0.0, help=text)
    elif name == "clear":
        add_yes_option(parser)


def _add_server_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add(
        "--nodes",
        type=_number_or_nothing,
        metavar="N",
        help="number of nodes, 1 to 3, on consecutive addresses; it cannot change once there are "
        "data (default: 1)",
    )
    add(
        "--heap",
        metavar="SIZE",
        help="Java heap of each node, such as 512M or 2G; kept for later starts (default: 0, all "
        "nodes share a quarter of the memory, at most 4G, and each has 512M or more)",
    )
    text = "port for CQL; kept for later starts (default: 9042)"
    add("--port", type=_number_or_nothing, help=text)
    text = "loopback address of the first node; kept for later starts (default: 127.0.0.1)"
    add("--host", metavar="ADDRESS", type=lambda text: text or None, help=text)
    text = (
        "require a login and use TLS, with a certificate of its own; the login files for programs "
        "are written to DIR/login; kept for later starts, until clear (default: no login, no TLS)"
    )
    add("--secure", action="store_const", const=True, help=text)


def _number_or_nothing(text: str) -> int | None:
    # A launch file cannot omit an option, but it can pass an empty value.
    return int(text) if text else None


def make_parser() -> argparse.ArgumentParser:
    """Return the parser with all verbs."""
    more = f"  {EXIT_NOT_RUNNING:<4} of status: not every node answers"
    groups = [VerbGroup("verbs", "local_cassandra start --nodes 3", VERBS)]
    return verbs_parser("local_cassandra", __doc__, groups, _add_arguments, more)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the verb that the arguments name; return the exit status."""
    parser = make_parser()
    answer_shell(parser)
    options = parser.parse_args(strip_remappings(argv))
    try:
        return VERBS[options.verb](options)
    finally:
        _clear_progress()


def open_cluster(options: argparse.Namespace) -> LocalCluster:
    """Return the cluster that the options describe; it prints its steps on the terminal."""
    return LocalCluster(
        options.dir,
        nodes=options.nodes,
        host=options.host,
        port=options.port,
        heap=options.heap or None,
        secure=options.secure,
        say=say,
        progress=show_progress,
    )


def say(text: str) -> None:
    """Print a line on standard output; it replaces the progress line, if there is one."""
    _clear_progress()
    print(text, flush=True)


def show_progress(text: str, seconds: float) -> None:
    """Update the progress line on standard error; if that is not a terminal, say it every 10 s."""
    if sys.stderr.isatty():
        print(f"\r{text} … {seconds:.0f} s\033[K", end="", file=sys.stderr, flush=True)
    else:
        _say_every_10_s(text, seconds)


_say_every_10_s = ProgressLines(functools.partial(print, file=sys.stderr, flush=True))


def _clear_progress() -> None:
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)


def where(cluster: LocalCluster) -> str:
    """Return the addresses of a cluster as text, for example 127.0.0.1:9042."""
    return ", ".join(f"{node.address}:{cluster.settings.port}" for node in cluster.nodes)
