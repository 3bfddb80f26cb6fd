# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Faults of the Cassandra that a recorder writes to, and of the network before it."""

from __future__ import annotations

import contextlib
import os
import subprocess
import time
from pathlib import Path

from faults.proxy import Proxy
from faults.trial import TOPIC, Place, Skipped, Trial
from faults.world import Server, await_true

DISK_MB = 800
"""Size of the disk of Cassandra that becomes full, MB."""
NO_ROOM = "No space left on device"
SPOOL_DISK_MB = 64
"""Size of the disk of the spool that becomes full, MB."""


def store_killed(trial: Trial) -> None:
    """Cassandra is killed with SIGKILL and started again."""
    _, publisher = trial.record()
    publisher.await_share(0.3)
    trial.server.kill()
    publisher.await_share(0.2)
    trial.server.start()
    trial.await_normal()


def store_frozen(trial: Trial) -> None:
    """Cassandra is frozen with SIGSTOP for 60 s (short form: 15 s)."""
    _, publisher = trial.record()
    publisher.await_share(0.3)
    with trial.server.frozen():
        time.sleep(trial.seconds(15, 60))
    trial.await_normal()


def store_away_longer_than_the_buffer(trial: Trial) -> None:
    """Cassandra cannot be reached until the buffer of a recorder without spool has overflowed."""
    _away(trial, "--buffsize", "1", "--no-spool")


def store_away_with_a_spool(trial: Trial) -> None:
    """Cassandra cannot be reached, 5 topics begin meanwhile, and the recorder has its spool."""
    proxy, place = _proxied(trial)
    trial.topics, trial.step = 5, trial.messages // 10
    recorder = trial.start_recorder("-e", f"{TOPIC}_.*", "--buffsize", "1", place=place)
    recorder.await_text("services under")
    publisher = trial.publisher()
    publisher.await_share(0.2)
    proxy.cut()
    publisher.await_share(1.5)
    proxy.mend()
    trial.await_normal()


def store_away_longer_than_the_spool(trial: Trial) -> None:
    """Cassandra cannot be reached until a spool of a small size has overflowed."""
    _away(trial, "--buffsize", "1", "--spool-size", "100K")


def _away(trial: Trial, *options: str) -> None:
    proxy, place = _proxied(trial)
    _, publisher = trial.record(*options, place=place)
    publisher.await_share(0.2)
    proxy.cut()
    publisher.await_share(1.5)
    proxy.mend()
    trial.await_normal()


def store_away_at_the_end(trial: Trial) -> None:
    """Cassandra cannot be reached when the recorder ends; what it leaves is stored afterwards."""
    proxy, place = _proxied(trial)
    _, publisher = trial.record("--spool-size", "100K", place=place)
    publisher.await_share(0.2)
    proxy.cut()
    publisher.await_share(1.5)


def store_slow(trial: Trial) -> None:
    """Each answer of Cassandra takes 2 s, and a connection carries 1 MB/s."""
    proxy, place = _proxied(trial)
    _, publisher = trial.record(place=place)
    publisher.await_share(0.2)
    proxy.delay_sec, proxy.bytes_per_sec = 1.0, 1e6
    publisher.await_share(0.6)
    proxy.delay_sec, proxy.bytes_per_sec = 0.0, 0.0
    trial.await_normal()


def publisher_faster_than_the_store(trial: Trial) -> None:
    """A connection to Cassandra carries 50 kB/s, less than what is published."""
    proxy, place = _proxied(trial)
    _, publisher = trial.record("--buffsize", "1", place=place)
    publisher.await_share(0.1)
    proxy.bytes_per_sec = 50e3
    publisher.await_share(1.5)
    proxy.bytes_per_sec = 0.0
    trial.await_normal()


def connections_silent(trial: Trial) -> None:
    """All connections to Cassandra carry nothing any more without an end; new ones work."""
    proxy, place = _proxied(trial)
    _, publisher = trial.record(place=place)
    publisher.await_share(0.3)
    proxy.silence()
    trial.await_normal()


def network_silent(trial: Trial) -> None:
    """The network to Cassandra carries nothing for 30 s (short form: 10 s)."""
    proxy, place = _proxied(trial)
    _, publisher = trial.record(place=place)
    publisher.await_share(0.3)
    proxy.silence(new=True)
    time.sleep(trial.seconds(10, 30))
    proxy.end_silence()
    trial.await_normal()


def store_comes_late(trial: Trial) -> None:
    """The recorder is started with --wait before Cassandra can be reached."""
    proxy, place = _proxied(trial)
    proxy.cut()
    trial.recorder(TOPIC, "--wait", "600", place=place)
    trial.publisher().await_share(0.6)
    proxy.mend()
    trial.await_normal()


def disk_full(trial: Trial) -> None:
    """The disk of Cassandra is full; later there is room again, and it is stopped and started."""
    folder = small_disk(trial, DISK_MB)
    trial.server = Server(folder / "server")
    trial.open.callback(trial.server.stop)
    trial.server.start()
    _, publisher = trial.record("--min-space", "0")
    publisher.await_share(0.3)
    ballast = fill_disk(folder)
    log = trial.server.cluster.nodes[0].log
    await_true("Cassandra misses room", lambda: NO_ROOM in log.read_text(errors="replace"))
    publisher.await_share(0.4)
    ballast.unlink()
    trial.server.cluster.stop()
    trial.server.start()
    trial.await_normal()


def spool_disk_full(trial: Trial) -> None:
    """While Cassandra cannot be reached, the disk of the recorder's spool is full for some time."""
    folder = small_disk(trial, SPOOL_DISK_MB)
    proxy, place = _proxied(trial)
    options = ("--buffsize", "1", "--spool-dir", folder / "spool", "--min-space", "0")
    _, publisher = trial.record(*options, place=place)
    publisher.await_share(0.1)
    proxy.cut()
    publisher.await_share(0.2)
    ballast = fill_disk(folder)
    publisher.await_share(1.5)
    ballast.unlink()
    publisher.await_share(0.2)
    proxy.mend()
    trial.await_normal()


def small_disk(trial: Trial, megabytes: int) -> Path:
    """Mount a disk of some MB; return its folder."""
    if os.geteuid():
        raise Skipped("only root can mount a disk of a small size")
    folder = trial.folder / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "none", str(folder)]
    done = subprocess.run(mount, capture_output=True, text=True)
    if done.returncode:
        raise Skipped(f"a small disk cannot be mounted here: {done.stderr.strip()}")
    trial.open.callback(subprocess.run, ["umount", "--lazy", str(folder)], check=False)
    return folder


def fill_disk(folder: Path) -> Path:
    """Write a file that takes the rest of a disk; return it."""
    ballast = folder / "ballast"
    with open(ballast, "wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(1 << 16))
    return ballast


def _proxied(trial: Trial) -> tuple[Proxy, Place]:
    place = trial.place
    proxy = trial.open.enter_context(Proxy((place.host, place.port), ("127.0.0.1", 0)))
    return proxy, Place(proxy.host, proxy.port)


FAULTS = (
    store_killed,
    store_frozen,
    store_away_longer_than_the_buffer,
    store_away_with_a_spool,
    store_away_longer_than_the_spool,
    store_away_at_the_end,
    store_slow,
    publisher_faster_than_the_store,
    connections_silent,
    network_silent,
    store_comes_late,
    disk_full,
    spool_disk_full,
)
