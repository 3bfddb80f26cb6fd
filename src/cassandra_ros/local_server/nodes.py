# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The files and the command line of one node of the local cluster."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from cassandra_ros.local_server.settings import Settings

_RING = 1 << 64

_JAVA_BASE_OPENS = (
    "java.lang.module jdk.internal.loader jdk.internal.ref jdk.internal.reflect "
    "jdk.internal.math jdk.internal.module jdk.internal.util.jar sun.nio.ch java.io "
    "java.lang.reflect java.lang java.util java.nio"
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
    "-Dcassandra.dehr_stripe_count=1"
)
_FIRST_HEAP_MB = 512
# Up to here the parallel collector is used, which costs the least time; the shorter pauses of G1
# only matter in larger heaps.
_SMALL_HEAP_MB = 2048
# Nodes on one machine need no time to hear of each other: 8 s less a start.
_LOCAL_FLAGS = (
    "-Dcassandra.skip_wait_for_gossip_to_settle=0 -Dcassandra.ring_delay_ms=1000 "
    "-Dcassandra.superuser_setup_delay_ms=0 -Dcassandra.shutdown_announce_in_ms=0"
)

_YAML = """\
# Written at every start of the local Cassandra; changes here are lost.
cluster_name: {name}
partitioner: org.apache.cassandra.dht.Murmur3Partitioner
endpoint_snitch: SimpleSnitch
num_tokens: 1
initial_token: {token}
auto_bootstrap: false
listen_address: {address}
rpc_address: {address}
storage_port: {storage_port}
native_transport_port: {port}
seed_provider:
  - class_name: org.apache.cassandra.locator.SimpleSeedProvider
    parameters: [{{seeds: "{seeds}"}}]
# What is acknowledged must survive a kill -9 and a power cut. The periodic mode loses the last
# 100 ms even of a process that is only killed; with many writes in flight batch is as fast.
commitlog_sync: batch
# A flush that meets a table that is just being dropped fails with "Unknown CF", and the default
# (stop) then ends the node. With ignore it goes on, and what cannot be logged is not acknowledged.
commit_failure_policy: ignore
commitlog_disk_access_mode: legacy
commitlog_segment_size: 32MiB
commitlog_total_space: 512MiB
storage_compatibility_mode: NONE
sstable: {{selected_format: bti}}
memtable:
  configurations:
    trie: {{class_name: TrieMemtable}}
    default: {{inherits: trie}}
memtable_allocation_type: offheap_objects
memtable_heap_space: {memtable_heap_mb}MiB
memtable_offheap_space: {memtable_offheap_mb}MiB
file_cache_size: 64MiB
key_cache_size: 0MiB
concurrent_reads: 8
concurrent_writes: 16
concurrent_compactors: 1
native_transport_max_threads: 32
sai_options: {{segment_write_buffer_size: 64MiB}}
dynamic_snitch: false
auto_snapshot: false
hinted_handoff_enabled: true
write_request_timeout: 10000ms
read_request_timeout: 15000ms
range_request_timeout: 20000ms
request_timeout: 20000ms
"""

_LOGBACK = """\
<configuration>
  <appender name="FILE" class="ch.qos.logback.core.rolling.RollingFileAppender">
    <file>${cassandra.logdir}/system.log</file>
    <rollingPolicy class="ch.qos.logback.core.rolling.FixedWindowRollingPolicy">
      <fileNamePattern>${cassandra.logdir}/system.log.%i</fileNamePattern>
      <minIndex>1</minIndex>
      <maxIndex>3</maxIndex>
    </rollingPolicy>
    <triggeringPolicy class="ch.qos.logback.core.rolling.SizeBasedTriggeringPolicy">
      <maxFileSize>10MB</maxFileSize>
    </triggeringPolicy>
    <encoder>
      <pattern>%-5level [%thread] %date{ISO8601} %F:%L - %msg%n</pattern>
    </encoder>
  </appender>
  <root level="INFO">
    <appender-ref ref="FILE" />
  </root>
</configuration>
"""


@dataclass(frozen=True)
class Node:
    """One node: its number from 1 on, and where it lives."""

    number: int
    directory: Path
    """Absolute and free of links, so that a process can be known by its command line."""
    settings: Settings

    @property
    def address(self) -> str:
        """Where it listens."""
        return self.settings.address(self.number)

    @property
    def config(self) -> Path:
        """Its cassandra.yaml."""
        return self.directory / "cassandra.yaml"

    @property
    def log(self) -> Path:
        """What Cassandra logs; older parts are beside it."""
        return self.directory / "logs" / "system.log"

    @property
    def console(self) -> Path:
        """What the Java machine itself prints."""
        return self.directory / "logs" / "console.log"

    @property
    def temporary(self) -> Path:
        """Where Java keeps what it needs only while it runs."""
        return self.directory / "tmp"

    @property
    def pid_file(self) -> Path:
        """Names the process of the last start."""
        return self.directory / "pid"

    def write_config(self) -> None:
        """Make the node's directory and write its configuration."""
        (self.directory / "logs").mkdir(parents=True, exist_ok=True)
        # Libraries unpack themselves there at every start and stay when the server is killed.
        shutil.rmtree(self.temporary, ignore_errors=True)
        self.temporary.mkdir()
        self.config.write_text(self.render_yaml(), encoding="utf-8")
        (self.directory / "logback.xml").write_text(_LOGBACK, encoding="utf-8")

    def render_yaml(self) -> str:
        """Return the text of the node's cassandra.yaml."""
        settings = self.settings
        everybody = [settings.address(i + 1) for i in range(settings.nodes)]
        return _YAML.format(
            name=json.dumps(settings.cluster_name),
            token=(self.number - 1) * (_RING // settings.nodes) - (_RING >> 1),
            address=self.address,
            storage_port=settings.storage_port,
            port=settings.port,
            seeds=",".join(f"{address}:{settings.storage_port}" for address in everybody),
            memtable_heap_mb=settings.java_heap_mb * 3 // 16,
            memtable_offheap_mb=max(128, settings.java_heap_mb // 4),
        )

    def command(self, java: str, jars: Path) -> list[str]:
        """Return the command line of the node's server."""
        agents = sorted(jars.glob("jamm-*.jar"))
        heap = self.settings.java_heap_mb
        # One that nobody named grows with the work: a robot's computer has other things to do
        # with a quarter of its memory. One that is named is taken at once, or refused at once.
        first = heap if self.settings.heap_mb else min(heap, _FIRST_HEAP_MB)
        arguments = [java, f"-Xms{first}M", f"-Xmx{heap}M"]
        # Half of the heap, as bin/cassandra: the tries of the memtables lie there, too.
        arguments.append(f"-XX:MaxDirectMemorySize={max(512, heap // 2)}M")
        arguments.append("-XX:+UseParallelGC" if heap <= _SMALL_HEAP_MB else "-XX:+UseG1GC")
        arguments += _JVM_FLAGS.split() + _LOCAL_FLAGS.split()
        arguments += [f"-javaagent:{agent}" for agent in agents[:1]]
        for export in _EXPORTS.split():
            arguments += ["--add-exports", f"{export}=ALL-UNNAMED"]
        for package in _JAVA_BASE_OPENS.split():
            arguments += ["--add-opens", f"java.base/{package}=ALL-UNNAMED"]
        arguments += ["--add-opens", "jdk.management/com.sun.management.internal=ALL-UNNAMED"]
        return [
            *arguments,
            f"-Djava.io.tmpdir={self.temporary}",
            f"-XX:ErrorFile={self.directory / 'logs' / 'java_error.log'}",
            f"-Dcassandra.config={self.config.as_uri()}",
            f"-Dcassandra.storagedir={self.directory}",
            f"-Dcassandra.logdir={self.directory / 'logs'}",
            f"-Dlogback.configurationFile={(self.directory / 'logback.xml').as_uri()}",
            "-cp",
            str(jars / "*"),
            "org.apache.cassandra.service.CassandraDaemon",
        ]


@dataclass(frozen=True)
class NodeStatus:
    """What is known of one node at one moment."""

    node: Node
    pid: int
    """0 when it does not run."""
    answers: bool
    """It answers CQL requests."""


# $0 is a mount point that is covered, privately: nothing that is mounted here reaches others.
_COVER = 'mount --make-private "$0" && mount --rbind / "$0" && exec chroot "$0" "$@"'


def with_visible_root(command: list[str], directory: Path) -> list[str]:
    """Return the command, or one that first makes the directory's mount point visible.

    Args:
        command: A program and its arguments.
        directory: Absolute path of an existing folder on whose file system it works.
    """
    mounts = mount_points()
    if mount_point_of(directory) in mounts or os.geteuid() != 0:
        return command
    covers = [mount for mount in mounts if os.path.isdir(mount)]
    if not covers:
        return command
    unshare = ["unshare", "--mount", "--propagation", "unchanged"]
    return [*unshare, "sh", "-c", _COVER, covers[0], *command]


def mount_points() -> list[str]:
    """Return the mount points that this process can see."""
    try:
        lines = Path("/proc/mounts").read_text(encoding="utf-8", errors="surrogateescape")
    except OSError:
        return []
    # A blank in a name stands there as \040.
    return [line.split(" ")[1].replace("\\040", " ") for line in lines.splitlines()]


def mount_point_of(directory: Path) -> str:
    """Return where the file system of a folder begins, as Java finds it: by device numbers."""
    device = directory.stat().st_dev
    while directory != directory.parent and directory.parent.stat().st_dev == device:
        directory = directory.parent
    return str(directory)
