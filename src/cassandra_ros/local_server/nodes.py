# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The files and the command line of one node of the local cluster."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from cassandra_ros.local_server.cluster_settings import Settings
from cassandra_ros.local_server.cql import answers_cql
from cassandra_ros.local_server.jars import server_file
from cassandra_ros.local_server.server_security import Security, write_private

_RING = 1 << 64

_OPENS = (
    "java.base/java.lang.module java.base/jdk.internal.loader java.base/jdk.internal.ref "
    "java.base/jdk.internal.reflect java.base/jdk.internal.math java.base/jdk.internal.module "
    "java.base/jdk.internal.util.jar java.base/sun.nio.ch java.base/java.io "
    "java.base/java.lang.reflect java.base/java.lang java.base/java.util java.base/java.nio "
    "jdk.management/com.sun.management.internal"
)
_EXPORTS = (
    "java.base/jdk.internal.misc java.base/java.lang.ref "
    "java.management.rmi/com.sun.jmx.remote.internal.rmi "
    "java.management/com.sun.jmx.remote.security java.rmi/sun.rmi.registry "
    "java.rmi/sun.rmi.server java.sql/java.sql jdk.unsupported/sun.misc"
)
# What bin/cassandra sets for Java 17, less what only large heaps want. Neither JMX port is set,
# so JMX is off: a SIGTERM drains without it.
_JVM_FLAGS = (
    "-Xss256k -XX:+UseThreadPriorities "
    "-XX:+PerfDisableSharedMem -XX:+ExitOnOutOfMemoryError -Djava.net.preferIPv4Stack=true "
    "-Dchronicle.analytics.disable=true -Djdk.attach.allowAttachSelf=true "
    "-Dio.netty.tryReflectionSetAccessible=true -Dio.netty.allocator.useCacheForAllThreads=true "
    "-Dio.netty.allocator.maxOrder=11 -Dcassandra-foreground=yes "
    # What a table holds of the heap, with or without rows, are its metrics; for few cores one
    # copy of their counters is enough: 0.26 MiB a table instead of 0.35.
    "-Dcassandra.dehr_stripe_count=1 "
    # In the first minutes the compiler takes as much of the processor as the rows. With less put
    # into one method it takes a third less, and what it makes is as fast.
    "-XX:FreqInlineSize=150 -XX:InlineSmallCode=1200"
)
_FIRST_HEAP_MB = 512
# Up to here, which is all that a node takes unasked, the parallel collector is used: it costs the
# least time, with G1 rows of many columns cost a fifth more. What waits to be written lies outside
# of the heap, so its pauses stay short; the shorter ones of G1 only matter in larger heaps.
_SMALL_HEAP_MB = 4096
# Nodes on one machine need no time to hear of each other: 8 s less a start.
_LOCAL_FLAGS = (
    "-Dcassandra.skip_wait_for_gossip_to_settle=0 -Dcassandra.ring_delay_ms=1000 "
    "-Dcassandra.superuser_setup_delay_ms=0 -Dcassandra.shutdown_announce_in_ms=0"
)


@dataclass(frozen=True)
class Node:
    """One node: its number from 1 on, and where it lives."""

    number: int
    directory: Path
    """Absolute and free of links, so that a process can be known by its command line."""
    settings: Settings
    jmx_port: int = 0
    """Port for commands (JMX) of a node that replaces one whose data are lost; 0 = closed."""

    @property
    def address(self) -> str:
        """Where it listens."""
        return self.settings.address(self.number)

    @property
    def config(self) -> Path:
        """Its cassandra.yaml."""
        return self.directory / "cassandra.yaml"

    @property
    def security(self) -> Security:
        """The files of the cluster's login."""
        return Security(self.directory.parent, self.settings)

    def answers(self) -> bool:
        """Tell whether it answers CQL requests."""
        context = self.security.context() if self.settings.secure else None
        return answers_cql(self.address, self.settings.port, context=context)

    def lets_in(self) -> bool:
        """Tell whether programs can use it: it answers, and where it asks for a login takes theirs.

        The user of a new cluster is made a moment after it answers.
        """
        return self.security.lets_in(self.address) if self.settings.secure else self.answers()

    @property
    def log(self) -> Path:
        """What Cassandra logs; older parts are beside it."""
        return self.directory / "logs" / "system.log"

    @property
    def console(self) -> Path:
        """What the Java machine itself prints."""
        return self.directory / "logs" / "console.log"

    @property
    def pid_file(self) -> Path:
        """Names the process of the last start."""
        return self.directory / "pid"

    def write_config(self) -> None:
        """Make the node's directory, for its user alone, and write its configuration."""
        self.directory.parent.mkdir(parents=True, exist_ok=True)
        # Other users of the machine must not read data or logs, whose messages tell of both; also
        # where somebody made the folder before.
        for folder in (self.directory, self.directory / "logs"):
            folder.mkdir(mode=0o700, exist_ok=True)
            folder.chmod(0o700)
        # Libraries unpack themselves there at every start and stay when the server is killed.
        shutil.rmtree(self.directory / "tmp", ignore_errors=True)
        (self.directory / "tmp").mkdir()
        write_private(self.config, self.render_yaml())  # it may name a password

    def render_yaml(self) -> str:
        """Return the text of the node's cassandra.yaml: the common part, and its own values."""
        settings = self.settings
        numbers = set(range(1, settings.nodes + 1))
        if self.jmx_port:  # a seed does not fetch data
            numbers.remove(self.number)
        seeds = ",".join(f"{settings.address(n)}:{settings.storage_port}" for n in sorted(numbers))
        seed_provider = "org.apache.cassandra.locator.SimpleSeedProvider"
        own = {
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
        if self.jmx_port:
            own["auto_bootstrap"] = True
        if settings.secure:
            own.update(self.security.yaml())
        common = server_file("cassandra.yaml").read_text(encoding="utf-8")
        note = "# Written at every start of the local Cassandra; changes here are lost.\n"
        # What is JSON is YAML.
        return note + common + "".join(f"{k}: {json.dumps(value)}\n" for k, value in own.items())

    def command(self, java: str, jars: Path) -> list[str]:
        """Return the command line of the node's server."""
        heap = self.settings.java_heap_mb
        # One that nobody named grows with the work: a robot's computer has other things to do
        # with a quarter of its memory. One that is named is taken at once, or refused at once.
        first = heap if self.settings.heap_mb else min(heap, _FIRST_HEAP_MB)
        arguments = [java, f"-Xms{first}M", f"-Xmx{heap}M"]
        # Half of the heap, as bin/cassandra: the tries of the memtables lie there, too.
        arguments.append(f"-XX:MaxDirectMemorySize={max(512, heap // 2)}M")
        arguments.append("-XX:+UseParallelGC" if heap <= _SMALL_HEAP_MB else "-XX:+UseG1GC")
        arguments += _JVM_FLAGS.split() + _LOCAL_FLAGS.split()
        if self.jmx_port:
            arguments.append(f"-Dcassandra.replace_address_first_boot={self.address}")
            arguments.append(f"-Dcassandra.jmx.local.port={self.jmx_port}")
        arguments += [f"-javaagent:{agent}" for agent in sorted(jars.glob("jamm-*.jar"))[:1]]
        arguments += _doors()
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

    def repair_command(self, java: str, jars: Path) -> list[str]:
        """Return the command line that compares all data of the node with the other copies."""
        words = [java, "-Xmx128M", f"-Duser.home={self.directory / 'tmp'}", "-cp", str(jars / "*")]
        words += [*_doors(), "org.apache.cassandra.tools.NodeTool", "-h", "127.0.0.1"]
        return [*words, "-p", str(self.jmx_port), "repair", "-full"]


def _doors() -> list[str]:
    """Return the options that let Cassandra's classes use packages of Java itself."""
    found = []
    for option, packages in (("--add-exports", _EXPORTS), ("--add-opens", _OPENS)):
        for package in packages.split():
            found += [option, f"{package}=ALL-UNNAMED"]
    return found


@dataclass(frozen=True)
class NodeStatus:
    """What is known of one node at one moment."""

    node: Node
    pid: int
    """0 when it does not run."""
    answers: bool
    """It answers CQL requests, and takes the login of the programs where it asks for one."""


# $0 is a mount point that is covered, privately: nothing that is mounted here reaches others.
_COVER = 'mount --make-private "$0" && mount --rbind / "$0" && exec chroot "$0" "$@"'


def with_visible_root(command: list[str], directory: Path) -> list[str]:
    """Return the command, or one that first makes visible where the directory is mounted."""
    mounts = mount_points()
    if mount_point_of(directory) in mounts or os.geteuid() != 0:
        return command
    cover = next(filter(os.path.isdir, mounts), None)
    unshare = ["unshare", "--mount", "--propagation", "unchanged"]
    return [*unshare, "sh", "-c", _COVER, cover, *command] if cover else command


def mount_points() -> list[str]:
    """Return the mount points that this process can see."""
    lines = Path("/proc/mounts").read_text(encoding="utf-8", errors="surrogateescape")
    # A blank in a name stands there as \040.
    return [line.split(" ")[1].replace("\\040", " ") for line in lines.splitlines()]


def mount_point_of(directory: Path) -> str:
    """Return where the file system of a folder begins, as Java finds it: by device numbers."""
    return next(str(path) for path in (directory, *directory.parents) if path.is_mount())
