# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the faults of one run share: a Cassandra, a ROS master, programs of the package."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
import xmlrpc.client
from pathlib import Path
from typing import Callable, Iterator

from cassandra_ros.local_server import LocalCluster, free_port
from cassandra_ros.local_server.processes import spawn

ROOT = Path(__file__).resolve().parents[2]
WORKSPACE = Path(os.environ.get("CASSANDRA_ROS_TEST_WORKSPACE", ROOT / ".ws"))
PROGRAMS = WORKSPACE / "devel/lib/cassandra_ros"
POLL_SEC = 0.05
HEAP = "512M"
"""Java heap of a server of one node, unless another one is asked for."""


class Failed(Exception):
    """Something did not happen that the fault expects."""


def await_true(what: str, condition: Callable[[], object], timeout_sec: float = 180.0) -> None:
    """Wait until a condition holds.

    Raises:
        Failed: It does not hold after the timeout.
    """
    deadline = time.monotonic() + timeout_sec
    while not condition():
        if time.monotonic() > deadline:
            raise Failed(f"{what}: not after {timeout_sec:.0f} s")
        time.sleep(POLL_SEC)


class Program:
    """A process whose output is written to a file.

    Args:
        command: Its words.
        output: The file.
        env: Its environment.
    """

    def __init__(self, command: list[object], output: Path, env: dict[str, str]) -> None:
        self._path = output
        self.process = spawn([str(word) for word in command], output, env, die_with_us=True)

    @property
    def output(self) -> str:
        """What it has printed so far."""
        return self._path.read_text(encoding="utf-8", errors="replace")

    @property
    def runs(self) -> bool:
        """Whether it has not ended."""
        return self.process.poll() is None

    def await_text(self, text: str, count: int = 1, timeout_sec: float = 180.0) -> None:
        """Wait until it has printed a text so many times.

        Raises:
            Failed: It ended before, or the time is over.
        """

        def printed() -> bool:
            ended = not self.runs
            if self.output.count(text) >= count:
                return True
            if ended:
                raise Failed(f"{text!r} was never printed:\n{self.output[-3000:]}")
            return False

        await_true(f"{text!r} in the output", printed, timeout_sec)

    def kill(self) -> int:
        """Kill it with SIGKILL; return the time before that, ns."""
        now = time.time_ns()
        self.process.kill()
        self.process.wait()
        return now

    def end(self, number: int = signal.SIGINT, timeout_sec: float = 400.0) -> int:
        """Send it a signal and return its exit status.

        Raises:
            Failed: It does not end.
        """
        if self.runs:
            self.process.send_signal(number)
        try:
            return self.process.wait(timeout_sec)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise Failed(f"it did not end after a signal:\n{self.output[-3000:]}") from None


class Server:
    """A Cassandra of the faults alone, of one or three nodes.

    Args:
        folder: Where its data are.
        nodes: Number of nodes.
        host: Address of the first node.
        heap: Java heap of each node.
    """

    def __init__(
        self, folder: Path, *, nodes: int = 1, host: str = "127.0.0.1", heap: str = HEAP
    ) -> None:
        self.cluster = LocalCluster(folder, nodes=nodes, host=host, port=free_port(), heap=heap)

    @property
    def hosts(self) -> list[str]:
        """Addresses of the nodes."""
        return [node.address for node in self.cluster.nodes]

    @property
    def port(self) -> int:
        """CQL port of all nodes."""
        return self.cluster.settings.port

    def start(self) -> Server:
        """Start the nodes that do not run; return when they answer."""
        self.cluster.start(die_with_us=True)
        return self

    def signal(self, number: int, node: int = 1) -> None:
        """Send a signal to a node, which has number 1 to 3."""
        os.kill(self.cluster.status()[node - 1].pid, number)

    def kill(self, node: int = 1) -> None:
        """Kill a node with SIGKILL, and wait until it is gone."""
        self.signal(signal.SIGKILL, node)
        await_true("the node is gone", lambda: not self.cluster.status()[node - 1].pid)

    @contextlib.contextmanager
    def frozen(self, node: int = 1) -> Iterator[None]:
        """Freeze a node while the context is open."""
        self.signal(signal.SIGSTOP, node)
        try:
            yield
        finally:
            self.signal(signal.SIGCONT, node)

    def stop(self) -> None:
        """End all nodes at once; their data are not needed any more."""
        for status in self.cluster.status():
            if status.pid:
                os.kill(status.pid, signal.SIGCONT)
                os.kill(status.pid, signal.SIGKILL)


class World:
    """The surroundings of faults.

    Args:
        folder: Folder for everything that is written.
        env: Environment of a shell that has sourced the workspace.
        heap: Java heap of the server of one node.
    """

    def __init__(self, folder: Path, env: dict[str, str], heap: str = HEAP) -> None:
        self.folder, self.heap = folder, heap
        self.env = {name: value for name, value in env.items() if name != "ROS_HOSTNAME"}
        self.env.update(
            ROS_HOME=str(folder / "ros"),
            ROS_LOG_DIR=str(folder / "ros/log"),
            ROS_IP="127.0.0.1",
            PYTHONUNBUFFERED="1",
            PYTHONPATH=os.pathsep.join([str(ROOT / "test"), env.get("PYTHONPATH", "")]),
            CASSANDRA_ROS_CQLSHRC=os.devnull,
        )
        self._open = contextlib.ExitStack()
        self._server: Server | None = None
        self._cluster: Server | None = None
        self.master = self.start_master()
        self._open.callback(self.master.end)

    def __enter__(self) -> World:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._open.close()

    @property
    def server(self) -> Server:
        """A server of one node; it is started when it is first needed, or when it does not run."""
        if self._server is None:
            self._server = Server(self.folder / "server", heap=self.heap)
            self._open.callback(self._server.stop)
        return self._server.start()

    @property
    def cluster(self) -> Server:
        """A cluster of three nodes; the server of one node is stopped first."""
        if self._server is not None:
            self._server.stop()
        if self._cluster is None:
            self._cluster = Server(self.folder / "cluster", nodes=3, host="127.77.0.1", heap="320M")
            self._open.callback(self._cluster.stop)
        return self._cluster.start()

    def start_master(self, port: int = 0) -> Master:
        """Start a ROS master; 0 = at a free port."""
        return Master(port or free_port(), self)


class Master(Program):
    """A ROS master alone, without roscore's rosout."""

    def __init__(self, port: int, world: World) -> None:
        self.port = port
        self.uri = f"http://127.0.0.1:{port}"
        (world.folder / "ros/log").mkdir(parents=True, exist_ok=True)
        env = {**world.env, "ROS_MASTER_URI": self.uri}
        output = world.folder / f"master_{port}.log"
        super().__init__(["rosmaster", "--core", "-p", port], output, env)
        await_true("the ROS master answers", self._answers)

    def set_param(self, name: str, value: object) -> None:
        """Set a parameter on the parameter server."""
        xmlrpc.client.ServerProxy(self.uri).setParam("/faults", name, value)

    def _answers(self) -> bool:
        try:
            return bool(xmlrpc.client.ServerProxy(self.uri).getPid("/faults"))
        except OSError:
            return False


def run_account(case: dict, folder: Path, env: dict[str, str]) -> dict:
    """Run the account, a program of its own, and return what it prints."""
    path = folder / "case.json"
    path.write_text(json.dumps(case, indent=1), encoding="utf-8")
    command = [sys.executable, "-m", "faults.account", str(path)]
    done = subprocess.run(command, env=env, cwd=ROOT, capture_output=True, text=True, timeout=3600)
    if done.returncode:
        raise Failed(f"the account failed:\n{done.stderr[-3000:]}")
    return json.loads(done.stdout)
