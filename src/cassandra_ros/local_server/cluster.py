# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Start, stop, inspect and clear the local Cassandra of a directory."""

from __future__ import annotations

import math
import os
import shutil
import struct
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import Callable, NoReturn, Sequence

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server import preflight, processes
from cassandra_ros.local_server.cluster_settings import (
    MIN_HEAP_MB,
    SETTINGS_FILE,
    ClusterSettings,
    change_settings,
    free_memory_mb,
    load_settings,
    needed_memory_mb,
    new_settings,
    save_settings,
)
from cassandra_ros.local_server.commit_log import cut_torn_end
from cassandra_ros.local_server.cql import CqlSession, half_made_tables, schema_versions
from cassandra_ros.local_server.jars import (
    default_directory,
    find_java,
    install_jars,
    jars_directory,
)
from cassandra_ros.local_server.node_tool import run_node_tool
from cassandra_ros.local_server.nodes import Node, NodeStatus, nodes_of, with_visible_root
from cassandra_ros.local_server.preflight import explain_failure, log_since, log_size
from cassandra_ros.local_server.processes import locked
from cassandra_ros.local_server.server_security import Security

START_TIMEOUT_SEC = 300.0
"""Maximum time until a node that was started answers, s."""
STOP_TIMEOUT_SEC = 90.0
"""Maximum time until a node that was asked to end has ended, s."""
_NEIGHBOUR_TIMEOUT_SEC = 30.0
_STAGGER_SEC = 2.0  # time between the starts of two nodes: a few cores cannot start all at once
_POLL_SEC = 0.1


class LocalCluster:
    """A cluster of one to three Cassandra nodes on loopback addresses, with its directory.

    If an argument is None, the stored setting of the cluster applies; for a new one the default.
    What changes the cluster holds the lock of the directory, and reads the settings again first:
    other processes may start and stop the same cluster.

    Args:
        directory: Directory of settings, data and logs; default: $CASSANDRA_ROS_DIR, else
            $ROS_HOME/cassandra_ros.
        nodes: Number of nodes; default: 1.
        host: Loopback address of the first node; default: 127.0.0.1.
        port: CQL port; default: 9042.
        heap: Java heap of each node, such as 512M; default: see own_heap_mb.
        secure: Whether the cluster requires a login and uses TLS; default: False.
        archive: File for the classes of the servers; see Node.
        say: Callback that gets one line of text for each step.
        progress: Callback that gets regularly what is being waited for, and since how many seconds.

    Raises:
        ServerError: An option has an impossible value, or the directory holds something else.
    """

    def __init__(
        self,
        directory: str | os.PathLike[str] | None = None,
        *,
        nodes: int | None = None,
        host: str | None = None,
        port: int | None = None,
        heap: str | None = None,
        secure: bool | None = None,
        archive: Path | None = None,
        say: Callable[[str], None] = lambda text: None,
        progress: Callable[[str, float], None] = lambda text, seconds: None,
    ) -> None:
        self.directory = Path(os.path.realpath(directory or default_directory()))
        self._changes = nodes, host, port, heap, secure  # in the order of change_settings
        self._archive = archive
        self._say = say
        self._progress = progress
        self._children: dict[int, subprocess.Popen[bytes]] = {}
        """The servers that this object has started, by number of the node."""
        self._load()

    def _load(self) -> None:
        """Read the stored settings, and apply the arguments to them."""
        self._stored = load_settings(self.directory)
        self.settings = change_settings(self._stored or new_settings(), *self._changes)

    @property
    def nodes(self) -> list[Node]:
        """All nodes of the cluster, running or not."""
        return nodes_of(self.directory, self.settings, self._archive)

    @property
    def security(self) -> Security:
        """The login files of the cluster; they exist if settings.secure is set."""
        return Security(self.directory, self.settings)

    @property
    def exists(self) -> bool:
        """Whether the directory holds a cluster."""
        return self._stored is not None

    def status(self) -> list[NodeStatus]:
        """Return the current status of each node."""
        statuses = []
        for node in self.nodes:
            pid = self._pid(node)
            answers = bool(pid) and node.lets_in()
            memory = processes.resident_bytes(pid) if pid else 0
            statuses.append(NodeStatus(node, pid, answers, memory))
        return statuses

    def start(self, *, die_with_us: bool = False) -> bool:
        """Start the nodes that are not running, and return when all nodes answer CQL requests.

        Args:
            die_with_us: Stop the nodes when this process ends for any reason; see spawn.

        Returns:
            False if all nodes were running already.

        Raises:
            ServerError: A node cannot be started; the text gives the cause and the remedy.
        """
        if not self.directory.exists():
            self._check(self.nodes)  # before the directory is made, in case the start is refused
        warning = preflight.make_directory(
            self.directory, self.settings.nodes, holds_data=self.exists
        )
        if warning:
            self._say(f"warning: {warning}")
        with locked(self.directory / "lock", self._progress):
            self._load()  # another process may just have made the cluster
            offsets = {node.number: log_size(node) for node in self.nodes}
            # Nodes whose replacement was interrupted. They are left to ``replace``.
            replaced = [node for node in self.nodes if node.is_being_replaced]
            asleep = [node for node in self.nodes if not self._pid(node) and node not in replaced]
            if self._stored is not None:
                running = any(map(self._pid, self.nodes))
                preflight.check_change(self.directory, self._stored, self.settings, running)
            killed = [node for node in asleep if node.pid_file.exists()]
            if asleep:
                self._tell_memory(len(asleep))
                self._start_nodes(asleep, die_with_us)
            for node in self.nodes:
                if node not in replaced:
                    self._await_answer(node, offsets[node.number])
            self._await_neighbours([node.number for node in asleep], offsets)
            for node in killed:
                self._restart_half_made(node, die_with_us)
            if replaced:
                number = replaced[0].number
                raise ServerError(
                    f"Cassandra node {number} has only a part of its data, because its "
                    "replacement was interrupted: start the others, and go on by local_cassandra "
                    f"replace {number}"
                )
            if self.settings.secure:  # an earlier start may have been interrupted before this
                self.security.ensure_users()
        return bool(asleep)

    @property
    def has_started(self) -> bool:
        """Whether this object has started a node, also if the start failed later."""
        return bool(self._children)

    def stop(self) -> bool:
        """Drain and stop all nodes; return False if no node was running.

        Raises:
            ServerError: A node does not stop.
        """
        if not self.directory.is_dir():
            return False
        with locked(self.directory / "lock", self._progress):
            self._load()  # another process may just have started more nodes
            running = [(node, pid) for node in self.nodes if (pid := self._pid(node))]
            for _, pid in running:
                processes.terminate(pid)
            for node, pid in running:
                self._await_end(node, pid)
                node.pid_file.unlink(missing_ok=True)
        return bool(running)

    def replace(self, number: int, *, die_with_us: bool = False) -> None:
        """Restore a node that has lost its data: copy it from the other nodes, then compare.

        Keyspaces with one copy of each row have lost the rows of that node.

        Args:
            number: Number of the node; the first one is 1.
            die_with_us: As in start.

        Raises:
            ServerError: The node is running or has data, another node does not answer, or the copy
                or the comparison fails.
        """
        if not self.exists or not 1 <= number <= self.settings.nodes or self.settings.nodes < 2:
            raise ServerError(
                f"there is no node {number} that others could give its data: the cluster in "
                f"{self.directory} has {self.settings.nodes if self.exists else 0} nodes"
            )
        node = replace(self.nodes[number - 1], replaced=True)
        with locked(self.directory / "lock", self._progress):
            self._check_replaceable(node)
            offset = log_size(node)
            if self._pid(node):  # an earlier call did not wait for the end
                java = find_java()
            else:
                java = self._check([node])
                self._empty(node)
                self._start_node(node, java, die_with_us)
            self._say(f"node {number} at {node.address} gets its data from the others")
            self._await_answer(node, offset, math.inf)
            node.replacing_file.unlink(missing_ok=True)  # it answers when it has all data
            self._await_neighbours([number], {n.number: 0 for n in self.nodes})
            self._repair(node, java)

    def _empty(self, node: Node) -> None:
        """Delete what is left of a node's data, and note that it has not all of them."""
        try:
            node.directory.mkdir(parents=True, exist_ok=True)
            node.replacing_file.touch()
        except OSError as exc:
            raise ServerError(f"{node.directory} cannot be written: {exc}") from exc
        for name in ("data", "commitlog", "hints", "saved_caches"):
            shutil.rmtree(node.directory / name, ignore_errors=True)

    def repair(self) -> None:
        """Compare the copies of all data of all nodes, and send each node what it lacks.

        Raises:
            ServerError: A node does not answer, there is only one node, or the comparison fails.
        """
        if not self.exists or self.settings.nodes < 2:
            raise ServerError(
                f"the cluster in {self.directory} has {self.settings.nodes if self.exists else 0} "
                "node(s): only several nodes have copies to compare"
            )
        with locked(self.directory / "lock", self._progress):
            self._load()
            silent = self._silent_of(self.nodes)
            if silent is not None:
                raise ServerError(
                    f"Cassandra node {silent.number} does not answer: its copies cannot be "
                    "compared; start it with local_cassandra start, or local_cassandra replace if "
                    "its data are lost"
                )
            java = find_java()
            for node in self.nodes:
                # Each node repairs its own part of the ring; together they are all data, once.
                self._repair(node, java, "--partitioner-range")

    def _repair(self, node: Node, java: str, *options: str) -> None:
        """Compare the data of a running node with the other copies, for as long as it takes."""
        self._say(f"comparing the data of node {node.number} with the other copies")
        words = ["repair", "--full", *options]
        run_node_tool(node, self._pid(node), java, jars_directory(), words)

    def _check_replaceable(self, node: Node) -> None:
        """Raise ServerError if a node runs or has data, or another node does not answer."""
        pid = self._pid(node)
        if pid and not node.is_being_replaced:
            raise ServerError(f"Cassandra node {node.number} runs (pid {pid}): it needs no other")
        # A start without data has created some system keyspaces; those do not count.
        data = node.directory / "data"
        if not node.is_being_replaced and any(
            not folder.name.startswith("system") for folder in data.glob("*/")
        ):
            raise ServerError(
                f"Cassandra node {node.number} has data in {node.directory}: start it; where they "
                "cannot be used move that folder away first"
            )
        silent = self._silent_of([other for other in self.nodes if other.number != node.number])
        if silent is not None:
            raise ServerError(
                f"Cassandra node {silent.number} does not answer: all the others are needed; "
                "start them with local_cassandra start, which ends at the node without data"
            )

    def _silent_of(self, nodes: Sequence[Node]) -> Node | None:
        """Return a node that does not answer; None = all answer.

        A node that runs may be busy: it is asked again for up to _NEIGHBOUR_TIMEOUT_SEC.
        """
        begun = time.monotonic()
        for node in nodes:
            while not node.answers():
                waited = time.monotonic() - begun
                if not self._pid(node) or waited > _NEIGHBOUR_TIMEOUT_SEC:
                    return node
                self._progress(f"waiting for an answer of node {node.number}", waited)
                time.sleep(_POLL_SEC)
        return None

    def clear(self) -> bool:
        """Delete data, logs and settings of the stopped cluster, but not the jars.

        Returns:
            False if the directory holds no cluster.

        Raises:
            ServerError: A node is still running, or a file cannot be deleted.
        """
        if not self.directory.is_dir():
            return False
        with locked(self.directory / "lock", self._progress):
            self._load()
            if self._stored is None:
                return False
            if pid := next(filter(None, map(self._pid, self.nodes)), 0):
                raise ServerError(
                    f"the Cassandra in {self.directory} runs (pid {pid}); stop it first: "
                    "rosrun cassandra_ros local_cassandra stop"
                )
            try:
                for path in self.directory.glob("node[1-9]"):
                    shutil.rmtree(path)
                if self.security.folder.exists():
                    shutil.rmtree(self.security.folder)
                (self.directory / SETTINGS_FILE).unlink()
            except OSError as exc:
                raise ServerError(f"the data cannot be deleted: {exc}") from exc
            self._load()
        return True

    def wait(self) -> None:
        """Wait until a node ends by itself.

        Raises:
            ServerError: A node has ended. This method never returns.
        """
        while True:
            for node in self.nodes:
                if not self._pid(node):
                    self._fail(node, "ended by itself.", 0)
            time.sleep(1.0)

    def _pid(self, node: Node) -> int:
        """Return the pid of the node's server; 0 = it is not running."""
        child = self._children.get(node.number)
        if child is not None:
            child.poll()  # otherwise it remains a zombie
        return processes.find_server(node.config, node.pid_file)

    def _tell_memory(self, nodes: int) -> None:
        """Say how much memory several nodes will take."""
        if self.settings.nodes < 2:
            return
        needed = nodes * needed_memory_mb(self.settings.java_heap_mb)
        free = free_memory_mb()
        self._say(
            f"starting {nodes} nodes with a Java heap of {self.settings.java_heap_mb} MiB each: "
            f"about {needed} MiB of memory together; {free} MiB are free"
        )
        if needed > free:
            self._say(
                "warning: this is more than what is free: choose a smaller --heap "
                f"({MIN_HEAP_MB}M or more), or fewer nodes"
            )

    def _check(self, asleep: list[Node]) -> str:
        """Check Java and ports, and download missing jars; return the path of Java."""
        java = find_java()
        install_jars(self._say)
        for node in asleep:
            preflight.check_port(node)
        return java

    def _start_nodes(self, asleep: list[Node], die_with_us: bool) -> None:
        """Make all checks, choose the storage port, save the settings, and start the nodes.

        It does not wait for their answers.
        """
        for node in asleep:
            if note := preflight.note_stale_pid_file(node):
                self._say(note)
                self._cut_torn_end(node)
        java = self._check(asleep)
        storage_port = preflight.choose_storage_port(self.settings, [n.address for n in asleep])
        before = self._stored
        self.settings = self._stored = replace(self.settings, storage_port=storage_port)
        try:
            save_settings(self.directory, self.settings)
            if self.settings.secure:
                self._secure(asleep, java, before)
        except OSError as exc:
            raise ServerError(f"{self.directory} cannot be written: {exc}") from exc
        for node in asleep:
            if node != asleep[0]:
                time.sleep(_STAGGER_SEC)
            self._start_node(replace(node, settings=self.settings), java, die_with_us)

    def _secure(self, asleep: list[Node], java: str, before: ClusterSettings | None) -> None:
        """Make what a login needs; if that fails, the cluster keeps its earlier settings.

        A new cluster has none (``before`` is None): its next start tries again to make the login.
        """
        try:
            self.security.make_files(java)
            directories = [node.directory for node in asleep]
            self.security.set_superuser(directories, java, jars_directory())
        except BaseException:
            if before is not None and not before.secure:
                save_settings(self.directory, before)
            raise

    def _cut_torn_end(self, node: Node) -> None:
        """Cut an incomplete write off the commit log of a node that was killed, and say so."""
        try:
            note = cut_torn_end(node.directory / "commitlog")
        except OSError as exc:
            raise ServerError(
                f"the commit log of node {node.number} cannot be read: {exc}"
            ) from exc
        if note:
            self._say(note)

    def _start_node(self, node: Node, java: str, die_with_us: bool) -> None:
        # C.UTF-8: Java encodes file names by the locale.
        environment = {**os.environ, "MALLOC_ARENA_MAX": "4", "LC_ALL": "C.UTF-8"}
        try:
            node.write_config()
            command = with_visible_root(node.command(java, jars_directory()), node.directory)
            child = processes.spawn(command, node.console, environment, die_with_us=die_with_us)
            self._children[node.number] = child
            processes.write_start(node.pid_file, child.pid)
        except OSError as exc:
            raise ServerError(f"Cassandra node {node.number} cannot be started: {exc}") from exc

    def _restart_half_made(self, node: Node, die_with_us: bool) -> None:
        """Start a node once more if it was killed while it made a table; see half_made_tables."""
        secure, port = self.settings.secure, self.settings.port
        context, login = (
            (self.security.context(), self.security.root_login()) if secure else (None, None)
        )
        try:
            with CqlSession(node.address, port, context, login) as session:
                tables = half_made_tables(session)
        except (OSError, struct.error) as exc:
            self._say(
                f"warning: node {node.number} was killed, and does not tell whether it was making "
                f"a table then ({exc}); if a topic is missing start it once more"
            )
            return
        pid = self._pid(node)
        if not tables or not pid:
            return
        self._say(f"node {node.number} was killed while it made {tables[0]}: starting it once more")
        processes.terminate(pid)
        self._await_end(node, pid)
        offset, java = log_size(node), self._check([node])
        self._start_node(replace(node, settings=self.settings), java, die_with_us)
        self._await_answer(node, offset)
        offsets = {member.number: 0 for member in self.nodes}
        self._await_neighbours([node.number], {**offsets, node.number: offset})

    def _await_answer(self, node: Node, offset: int, limit_sec: float | None = None) -> None:
        """Wait until a node answers; raise ServerError if it ends or takes too long.

        Args:
            node: The node.
            offset: Size of its log before the start, for the error text.
            limit_sec: Maximum time, s; None = START_TIMEOUT_SEC.
        """
        limit_sec = START_TIMEOUT_SEC if limit_sec is None else limit_sec
        begun = time.monotonic()
        while not node.answers():
            waited = time.monotonic() - begun
            where, pid = f"{node.address}:{self.settings.port}", self._pid(node)
            if not pid:
                self._fail(node, "ended while it was starting.", offset)
            self._progress(
                f"starting Cassandra node {node.number} (pid {pid}): waiting for {where}", waited
            )
            if waited > limit_sec:
                text = f"does not answer on {where} after {waited:.0f} s; it is left running."
                self._fail(node, text, offset)
            time.sleep(_POLL_SEC)

    def _fail(self, node: Node, what: str, offset: int) -> NoReturn:
        """Raise ServerError with the reason that the log of a node gives after an offset."""
        reason = explain_failure(node, offset)
        raise ServerError(f"Cassandra node {node.number} {what}\n{reason}")

    def _await_neighbours(self, started: list[int], offsets: dict[int, int]) -> None:
        """Wait until the nodes that were just started and all others know each other.

        Before that no quorum can be reached. It takes a second or two. After the timeout the start
        still counts as successful: only requests that need both nodes fail.

        Args:
            started: Numbers of the nodes that were just started.
            offsets: Size of the log of each node before that, by number.
        """
        begun = time.monotonic()
        deadline = begun + _NEIGHBOUR_TIMEOUT_SEC
        nodes = [node for node in self.nodes if not node.is_being_replaced]
        for node in nodes:
            others = [other for other in nodes if other != node]
            fresh = [o for o in others if o.number in started or node.number in started]
            while fresh and time.monotonic() < deadline:
                # The log shows which nodes are up, the system tables which tokens they have.
                lines = log_since(node, offsets[node.number]).splitlines()
                alive = [line for line in lines if "now UP" in line]
                seen = all(any(f"/{o.address}:" in line for line in alive) for o in fresh)
                versions = self._schema_versions(node)
                if seen and len(versions) > len(others) and len(set(versions.values())) == 1:
                    break
                waited = time.monotonic() - begun
                self._progress("waiting for the nodes to know each other", waited)
                time.sleep(_POLL_SEC)

    def _schema_versions(self, node: Node) -> dict[str, str]:
        """Return the schema versions that a node knows, see schema_versions; {} = no answer."""
        if not self.settings.secure:
            return schema_versions(node.address, self.settings.port)
        # A new cluster only has Cassandra's superuser until its own users are created.
        for login in (self.security.login(), self.security.root_login()):
            context = self.security.context()
            versions = schema_versions(
                node.address, self.settings.port, context=context, login=login
            )
            if versions:
                return versions
        return {}

    def _await_end(self, node: Node, pid: int) -> None:
        """Wait until a server that was asked to end has ended; raise ServerError if it does not."""
        begun, child = time.monotonic(), self._children.get(node.number)
        started = processes.read_start(node.pid_file)
        while processes.is_server(pid, node.config, started):
            if child is not None:
                child.poll()  # otherwise it remains a zombie
            waited = time.monotonic() - begun
            self._progress(f"stopping Cassandra node {node.number} (pid {pid})", waited)
            if waited > STOP_TIMEOUT_SEC:
                raise ServerError(
                    f"Cassandra node {node.number} (pid {pid}) does not end {waited:.0f} s after "
                    f"it was asked to; its log is {node.log}. 'kill -9 {pid}' ends it; what it "
                    "acknowledged is kept"
                )
            time.sleep(_POLL_SEC)
