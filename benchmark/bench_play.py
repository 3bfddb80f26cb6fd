# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Play the same messages by ``rosbag play`` and by our player, and compare how late they come.

One process listens to each, and notes when each message has arrived. Lateness of a message:
(arrival - stored time) - the smallest such difference of the run, so that the most punctual message
has 0. Measured in turn, with small messages and with images; then how many come a second where
nobody waits (-i).
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Mapping

import rosbag
from suite.contenders import folder_bag
from suite.messages import Batch, blob, imu
from suite.server import Server

from cassandra_ros.errors import CassandraRosError
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.local_server import free_port

ROOT = Path(__file__).resolve().parents[1]
PLAYER = ROOT / ".ws/devel/lib/cassandra_ros/player"
TOPIC = "/imu"
SETTLED_SEC = 2.0
"""A run has ended when nothing has come for so long after its player."""


def listen() -> None:
    """Be the listening process: print stamp and arrival of each message, ns, when asked to end."""
    import rospy

    from cassandra_ros.nodes.subscription import subscribe

    found: list[tuple[int, int]] = []
    ended = threading.Event()

    def count(topic: str, header: Mapping[str, str], wire: bytes) -> None:
        now = time.monotonic_ns()
        secs, nsecs = struct.unpack_from("<II", wire, 4)
        found.append((secs * 10**9 + nsecs, now))

    signal.signal(signal.SIGINT, lambda *args: ended.set())
    rospy.init_node("listener", anonymous=True, disable_signals=True)
    subscribe(TOPIC, count, tcp_nodelay=True)
    print("ready", flush=True)
    ended.wait()
    seen = -1
    while len(found) != seen:  # what is on its way still comes
        seen = len(found)
        time.sleep(SETTLED_SEC / 4)
    for stamp, arrival in found:
        print(stamp, arrival)


def arrivals(env: Mapping[str, str], command: list[str]) -> list[tuple[int, int]]:
    """Let a player play to one listener; return stamps and arrivals."""
    me = [sys.executable, __file__, "--listen"]
    listener = subprocess.Popen(me, env=dict(env), stdout=subprocess.PIPE, text=True)
    assert listener.stdout is not None
    while listener.stdout.readline() not in ("ready\n", ""):
        pass  # rospy may say first that the master is not there yet
    subprocess.run(
        command, env=dict(env), check=True, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    listener.send_signal(signal.SIGINT)
    found = [tuple(map(int, line.split())) for line in listener.stdout]
    listener.wait()
    return [(stamp, arrival) for stamp, arrival in found]


def lateness_ms(found: list[tuple[int, int]]) -> list[float]:
    """Return by how much each message came later than the most punctual one, sorted."""
    offsets = [arrival - stamp for stamp, arrival in found]
    return sorted((offset - min(offsets)) / 1e6 for offset in offsets)


def show(what: str, found: list[tuple[int, int]], sent: int) -> None:
    """Print the lateness of a run."""
    late = lateness_ms(found)
    print(
        f"  {what:12} {len(found):7,} of {sent:7,}   median {statistics.median(late):8.3f} ms   "
        f"95 % {late[int(len(late) * 0.95)]:8.3f} ms   max {late[-1]:8.3f} ms"
    )


def showRate(what: str, found: list[tuple[int, int]], sent: int, size: int) -> None:
    """Print how many messages came a second."""
    seconds = (found[-1][1] - found[0][1]) / 1e9
    rate = (len(found) - 1) / seconds
    print(
        f"  {what:12} {len(found):7,} of {sent:7,}   {rate:10,.0f} msg/s   "
        f"{rate * size / 1e6:8,.1f} MB/s"
    )


def compare(args: argparse.Namespace, env: Mapping[str, str], path: Path, server: Server) -> None:
    """Measure one bag, paced and not."""
    with rosbag.Bag(str(path)) as bag:
        sent = bag.get_message_count()
    size = path.stat().st_size // sent
    store = ["--host", server.host, "--port", str(server.port), "--keyspace", server.keyspace]
    wait = ["--wait-for-subscribers", "--queue", "100"]
    players = {
        "rosbag play": ["rosbag", "play", "-q", *wait, str(path)],
        "player": [str(PLAYER), "-q", *store, *wait],
    }
    for _ in range(args.rounds):
        for what, command in players.items():
            show(what, arrivals(env, command), sent)
    for what, command in players.items():
        showRate(f"{what} -i", arrivals(env, [*command, "-i"]), sent, size)


def run(args: argparse.Namespace, folder: Path, server: Server) -> None:
    """Make the bags, import them, measure."""
    env = dict(os.environ, ROS_MASTER_URI=f"http://127.0.0.1:{free_port()}")
    env.update(ROS_HOME=str(folder), ROS_LOG_DIR=str(folder))
    port = env["ROS_MASTER_URI"].rpartition(":")[2]
    master = subprocess.Popen(
        ["roscore", "-p", port], env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        small = imu(int(args.seconds * args.hz), args.hz)
        large = blob(int(args.seconds * 30), 2_000_000, 30)
        for batch, what in (
            (small, f"sensor_msgs/Imu, {args.hz:,}/s, {args.seconds:g} s"),
            (large, f"images of 2 MB, 30/s (60 MB/s), {args.seconds:g} s"),
        ):
            measure(args, env, batch.first(len(batch), TOPIC), folder / batch.kind, server, what)
    finally:
        master.send_signal(signal.SIGINT)
        master.wait()


def measure(
    args: argparse.Namespace,
    env: Mapping[str, str],
    batch: Batch,
    folder: Path,
    server: Server,
    what: str,
) -> None:
    """Import one bag and compare."""
    folder.mkdir()
    path = folder_bag(batch, folder)
    try:
        import_bag(server.store, path, format=args.format)
        print(f"{what}, format {args.format}; late by (arrival - time) - smallest of the run")
        compare(args, env, path, server)
    finally:
        server.store.removeTopic(TOPIC)


def main() -> int:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--host", help="a running Cassandra (default: one of our own)")
    parser.add_argument("--port", type=int, default=9042, help="its port (%(default)s)")
    parser.add_argument("--seconds", type=float, default=10, help="of each bag (%(default)s)")
    parser.add_argument("--hz", type=int, default=1000, help="of small messages (%(default)s)")
    parser.add_argument("--rounds", type=int, default=2, help="(%(default)s)")
    parser.add_argument("--format", default="binary", help="(%(default)s)")
    parser.add_argument("--listen", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.listen:
        listen()
        return 0
    address = f"{args.host}:{args.port}" if args.host else None
    with tempfile.TemporaryDirectory(prefix="cassandra_ros_bench_") as folder:
        server = Server(Path(folder) / "server", address)
        try:
            server.start()
            try:
                run(args, Path(folder), server)
            finally:
                server.end()
        except CassandraRosError as exc:
            print(f"playing: {exc}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
