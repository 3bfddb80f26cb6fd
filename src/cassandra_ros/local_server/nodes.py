# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The configuration, files and command line of one node of the local cluster."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from cassandra_ros.local_server.cluster_settings import ClusterSettings
from cassandra_ros.local_server.cql import answers_cql
from cassandra_ros.local_server.jars import module_options, server_file
from cassandra_ros.local_server.server_security import Security, write_private

_RING = 1 << 64

# The options of bin/cassandra for Java 17, without those for large heaps. No JMX port is set, so
# JMX is off; a SIGTERM drains the node without it.
_JVM_FLAGS = (
    "-Xss256k -XX:+UseThreadPriorities "
    "-XX:+PerfDisableSharedMem -XX:+ExitOnOutOfMemoryError -Djava.net.preferIPv4Stack=true "
    # Where nodetool finds the JMX port that is open while it runs; see node_tool.py.
    "-Djava.rmi.server.hostname=127.0.0.1 "
    "-Dchronicle.analytics.disable=true -Djdk.attach.allowAttachSelf=true "
    "-Dio.netty.tryReflectionSetAccessible=true -Dio.netty.allocator.useCacheForAllThreads=true "
    "-Dio.netty.allocator.maxOrder=11 -Dcassandra-foreground=yes "
    # The metrics of a table take heap, even without rows. On few cores one copy of their counters
    # is enough: 0.26 MiB per table instead of 0.35 MiB.
    "-Dcassandra.dehr_stripe_count=1 "
    # In the first minutes the compiler uses as much processor time as the requests. With less
    # inlining it uses a third less, and the compiled code is as fast.
    "-XX:FreqInlineSize=150 -XX:InlineSmallCode=1200"
)
_FIRST_HEAP_MB = 512
# Up to this heap size, the maximum by default, the parallel collector is used. It takes the least
# time: with G1, rows of many columns cost a fifth more. Its pauses are short, because memtables are
# outside of the heap. The shorter pauses of G1 only matter in larger heaps.
_SMALL_HEAP_MB = 4096
# Nodes on one machine need no delays to find each other. This makes a start 8 s shorter.
_LOCAL_FLAGS = (
    "-Dcassandra.skip_wait_for_gossip_to_settle=0 -Dcassandra.ring_delay_ms=1000 "
    "-Dcassandra.superuser_setup_delay_ms=0 -Dcassandra.shutdown_announce_in_ms=0 "
    # By default twice the ring delay. A starting node that is silent for half of it is removed
    # from the list of nodes; a server that does this while it starts itself can hang for ever:
    # three threads of it wait for each other. So it is what it is without a changed ring delay.
    "-Dcassandra.gossip_quarantine_delay_ms=60000"
)


@dataclass(frozen=True)
class Node:
    """A Cassandra node of the local cluster."""

    number: int
    """Number of the node; the first one is 1."""
    directory: Path
    """Directory of the node: absolute and without symbolic links, so that its process can be
    identified by the command line."""
    settings: ClusterSettings
    replaced: bool = False
    """Whether this start copies the data that the node has lost from the other nodes."""
    archive: Path | None = None
    """File to which Java writes the classes of this server when it ends; None = Java uses the
    archive that is there, if there is one."""

    @property
    def address(self) -> str:
        """Address on which the node listens."""
        return self.settings.address(self.number)

    @property
    def config(self) -> Path:
        """Path of the node's cassandra.yaml."""
        return self.directory / "cassandra.yaml"

    @property
    def security(self) -> Security:
        """The login files of the cluster."""
        return Security(self.directory.parent, self.settings)

    def answers(self) -> bool:
        """Return whether the node answers CQL requests, even if no user can log in yet."""
        context = self.security.context() if self.settings.secure else None
        return answers_cql(self.address, self.settings.port, context=context)

    def lets_in(self) -> bool:
        """Return whether programs can use the node: it answers and accepts their login, if any.

        The user of a new cluster is created a moment after the node answers.
        """
        return self.security.lets_in(self.address) if self.settings.secure else self.answers()

    @property
    def log(self) -> Path:
        """Path of Cassandra's log; older logs are in the same folder."""
        return self.directory / "logs" / "system.log"

    @property
    def console(self) -> Path:
        """Path of the output of the Java virtual machine itself."""
        return self.directory / "logs" / "console.log"

    @property
    def pid_file(self) -> Path:
        """Path of the file with the pid of the last start."""
        return self.directory / "pid"

    @property
    def replacing_file(self) -> Path:
        """Path of a file that is there while the node has only a part of its data."""
        return self.directory / "replacing"

    @property
    def is_being_replaced(self) -> bool:
        """Whether the node gets its data from the others, or an interrupted replacement did."""
        return self.replacing_file.exists()

    def keyspace_bytes(self) -> dict[str, int]:
        """Return the size on disk of each keyspace of users, bytes, by name.

        What was written last is missing: it is only in the commit log and in memory.
        """
        folders = sorted((self.directory / "data").glob("*/"))
        return {
            folder.name: size_of(folder)
            for folder in folders
            if not folder.name.startswith("system")
        }

    def hint_bytes(self) -> int:
        """Return the size of the writes that wait on this node for nodes that were away, bytes."""
        return size_of(self.directory / "hints")

    def write_config(self) -> None:
        """Make the node's directory, readable by its owner only, and write its configuration.

        The node must not be running: its folder for temporary files is deleted.
        """
        self.directory.parent.mkdir(parents=True, exist_ok=True)
        # Other users of the machine must not read data or logs, also if the folder existed before.
        for folder in (self.directory, self.directory / "logs"):
            folder.mkdir(mode=0o700, exist_ok=True)
            folder.chmod(0o700)
        # Native libraries are unpacked there at each start, and remain if the server is killed.
        shutil.rmtree(self.directory / "tmp", ignore_errors=True)
        (self.directory / "tmp").mkdir()
        write_private(self.config, self.render_yaml())  # it may name a password

    def render_yaml(self) -> str:
        """Return the text of the node's cassandra.yaml: the common part and the node's values."""
        settings = self.settings
        numbers = set(range(1, settings.nodes + 1))
        if self.replaced:  # a seed would not copy data from other nodes
            numbers.remove(self.number)
        seeds = ",".join(f"{settings.address(n)}:{settings.storage_port}" for n in sorted(numbers))
        seed_provider = "org.apache.cassandra.locator.SimpleSeedProvider"
        values = {
            "cluster_name": settings.cluster_name,
            "initial_token": (self.number - 1) * (_RING // settings.nodes) - (_RING >> 1),
            "listen_address": self.address,
            "rpc_address": self.address,
            "storage_port": settings.storage_port,
            "native_transport_port": settings.port,
            "seed_provider": [{"class_name": seed_provider, "parameters": [{"seeds": seeds}]}],
            "memtable_heap_space": f"{settings.java_heap_mb * 3 // 16}MiB",
            "memtable_offheap_space": f"{max(128, settings.java_heap_mb // 4)}MiB",
        }
        if self.replaced:
            values["auto_bootstrap"] = True
        if settings.secure:
            values.update(self.security.yaml())
        common = server_file("cassandra.yaml").read_text(encoding="utf-8")
        note = "# Written at every start of the local Cassandra; changes here are lost.\n"
        # JSON is valid YAML.
        return note + common + "".join(f"{k}: {json.dumps(value)}\n" for k, value in values.items())

    def command(self, java: str, jars: Path) -> list[str]:
        """Return the command line of the node's server.

        Args:
            java: Path of Java.
            jars: Directory of Cassandra's jars.
        """
        heap = self.settings.java_heap_mb
        # A default heap grows with the load, because a robot's computer has other uses for a
        # quarter of its memory. A heap that the user chose is allocated, or refused, at once.
        first = heap if self.settings.heap_mb else min(heap, _FIRST_HEAP_MB)
        arguments = [java, f"-Xms{first}M", f"-Xmx{heap}M"]
        # Half of the heap, as in bin/cassandra: the tries of the memtables use direct memory, too.
        arguments.append(f"-XX:MaxDirectMemorySize={max(512, heap // 2)}M")
        arguments.append("-XX:+UseParallelGC" if heap <= _SMALL_HEAP_MB else "-XX:+UseG1GC")
        arguments += _JVM_FLAGS.split() + _LOCAL_FLAGS.split()
        if self.replaced:
            arguments.append(f"-Dcassandra.replace_address_first_boot={self.address}")
        if self.archive is not None:  # Java makes no archive with an agent, but uses it with one
            arguments.append(f"-XX:ArchiveClassesAtExit={self.archive}")
        else:
            arguments += [f"-javaagent:{agent}" for agent in sorted(jars.glob("jamm-*.jar"))[:1]]
            if archive := find_archive(java, jars):
                arguments.append(f"-XX:SharedArchiveFile={archive}")
        arguments += module_options()
        return [
            *arguments,
            f"-Djava.io.tmpdir={self.directory / 'tmp'}",
            f"-XX:ErrorFile={self.directory / 'logs' / 'java_error.log'}",
            f"-Dcassandra.config={self.config.as_uri()}",
            f"-Dcassandra.storagedir={self.directory}",
            f"-Dcassandra.logdir={self.directory / 'logs'}",
            f"-Dlogback.configurationFile={server_file('logback.xml').as_uri()}",
            "-cp",
            str(jars / "*"),
            "org.apache.cassandra.service.CassandraDaemon",
        ]


def archive_name(java: str) -> str:
    """Return the beginning of the name of the archive of Cassandra's classes for a `java`."""
    program = Path(java).resolve()
    program_state = f"{program} {program.stat().st_size} {program.stat().st_mtime_ns}"
    return f"classes-{hashlib.sha256(program_state.encode()).hexdigest()[:16]}"


def find_archive(java: str, jars: Path) -> Path | None:
    """Return the archive of Cassandra's classes for a `java`; None = it was not made.

    Its name ends with its size, because Java crashes with one that was cut short.
    """
    for path in jars.glob(f"{archive_name(java)}-*.jsa"):
        if path.stem.endswith(f"-{path.stat().st_size}"):
            return path
    return None


def nodes_of(directory: Path, settings: ClusterSettings, archive: Path | None = None) -> list[Node]:
    """Return all nodes of the cluster of a directory, running or not; archive: see Node."""
    numbers = range(1, settings.nodes + 1)
    return [Node(n, directory / f"node{n}", settings, archive=archive) for n in numbers]


@dataclass(frozen=True)
class NodeStatus:
    """The status of a node at one moment."""

    node: Node
    pid: int
    """Pid of the server; 0 = it is not running."""
    answers: bool
    """Whether programs can use the node: it answers CQL and accepts their login, if any."""
    memory_bytes: int = 0
    """Resident memory of the server, bytes; 0 = it is not running."""


def size_of(directory: Path) -> int:
    """Return the size of all files below a directory, bytes. Files may be deleted meanwhile."""
    total = 0
    for path in directory.rglob("*"):
        try:
            total += path.stat().st_size if path.is_file() else 0
        except OSError:
            continue
    return total


# $0 is a mount point over which / is mounted. The mount is private: other processes do not see it.
_COVER = 'mount --make-private "$0" && mount --rbind / "$0" && exec chroot "$0" "$@"'


def with_visible_root(command: list[str], directory: Path) -> list[str]:
    """Return a command whose process can see the mount point of a directory.

    In a chroot this mount point may be missing in /proc/mounts. Then the result is a command that
    mounts / in a private namespace first.
    """
    mounts = mount_points()
    if mount_point_of(directory) in mounts or os.geteuid() != 0:
        return command
    cover = next(filter(os.path.isdir, mounts), None)
    unshare = ["unshare", "--mount", "--propagation", "unchanged"]
    return [*unshare, "sh", "-c", _COVER, cover, *command] if cover else command


def mount_points() -> list[str]:
    """Return the mount points that this process can see."""
    lines = Path("/proc/mounts").read_text(encoding="utf-8", errors="surrogateescape")
    # A blank in a name is written as \040.
    return [line.split(" ")[1].replace("\\040", " ") for line in lines.splitlines()]


def mount_point_of(directory: Path) -> str:
    """Return the mount point of a directory's file system, found by device numbers as in Java."""
    return next(str(path) for path in (directory, *directory.parents) if path.is_mount())
