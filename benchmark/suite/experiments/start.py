# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How long a person waits: starts of programs and of Cassandra, and the making of tables."""

from __future__ import annotations

import resource
import subprocess
import time
import xmlrpc.client
from pathlib import Path
from typing import Sequence

import psutil

from cassandra_ros import RosCassandra
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.local_server import LocalCluster, free_port
from cassandra_ros.topics.message_writer import Asked
from suite.context import Context, Costs, measure
from suite.experiments.live import roscore
from suite.messages import imu

ROOT = Path(__file__).resolve().parents[3]
PROGRAMS = ROOT / ".ws/devel/lib/cassandra_ros"
BAGS = ROOT / "examples/data"
SMALL_BAG = BAGS / "turtlesim_tf.bag"
HUSKY_BAG = BAGS / "husky_gps_data.bag"
TOPIC = "/never_published"
TOGETHER = 24
"""Tables that are made together, as many as the Husky's bag has topics."""
ALONE = 5
"""Tables that are made one by one at each step."""
PATIENCE_SEC = 120.0


def run(context: Context) -> None:
    """Measure programs, tables, the local Cassandra and make setup."""
    for what in (_programs, _subscribed, _import, _side_tables, _topic_tables):
        with context.part(what.__name__.strip("_")):
            what(context)
    for what in (_local_cassandra, _make_setup):
        if context.size.starts:
            with context.part(what.__name__.strip("_")):
                what(context)


def _run(command: Sequence[object], folder: Path, cwd: Path | None = None) -> Costs:
    """Run a program to its end; raise with its output if it fails."""
    log = folder / "program.log"
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    with log.open("w") as output:
        done = subprocess.run(
            list(map(str, command)),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            cwd=cwd,
            check=False,
        )
    seconds, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(f"{command}: status {done.returncode}: {log.read_text()[-500:]}")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Costs(seconds, cpu, None)


def _add(context: Context, name: str, costs: Sequence[Costs], kind: str = "") -> None:
    """Note what several runs of one thing took."""
    context.add("wall", name, [one.seconds for one in costs], "s", kind=kind)
    context.add("client cpu", name, [one.client_cpu for one in costs], "s", kind=kind)
    server = [one.server_cpu for one in costs if one.server_cpu is not None]
    if server:
        context.add("server cpu", name, server, "s", kind=kind)


def _store_options(context: Context, keyspace: str) -> list[str]:
    server = context.server
    return ["--host", server.host, "--port", str(server.port), "--keyspace", keyspace]


def _programs(context: Context) -> None:
    """Start programs in turn, those of rosbag among them."""
    keyspace = f"{context.server.keyspace}_small"
    with RosCassandra(context.server.host, context.server.port, keyspace=keyspace) as store:
        import_bag(store, SMALL_BAG)
    bag, here = [PROGRAMS / "cassandra_bag"], _store_options(context, keyspace)
    statement = "SELECT count(*) FROM /turtle1/pose"
    commands: dict[str, list[object]] = {
        "rosbag --help": ["rosbag", "--help"],
        "cassandra_bag --help": [*bag, "--help"],
        "recorder --help": [PROGRAMS / "recorder", "--help"],
        "rosbag info": ["rosbag", "info", SMALL_BAG],
        "cassandra_bag info --all": [*bag, "info", "--all", *here[:4]],
        "cassandra_bag info": [*bag, "info", *here],
        "cassandra_bag query": [*bag, "query", statement, *here],
    }
    costs: dict[str, list[Costs]] = {name: [] for name in commands}
    for number in range(1 + context.size.program_runs):
        for name, command in commands.items():
            # The first round brings their files into memory.
            costs[name] += [_run(command, context.folder)] * bool(number)
    context.server.drop(keyspace)
    for name, each in costs.items():
        _add(context, name, each)


def _subscribed(context: Context) -> None:
    """Start recorders; look at the master for their subscription."""
    recorder = [PROGRAMS / "recorder", *_store_options(context, context.server.keyspace)]
    context.server.store.catalog.keyspace.side_tables.make()
    bag = context.folder / "never.bag"
    commands: dict[str, list[object]] = {
        "rosbag record": ["rosbag", "record", "-q", "-O", bag, TOPIC],
        "recorder": [*recorder, TOPIC],
    }
    with roscore(context) as env:
        costs: dict[str, list[Costs]] = {name: [] for name in commands}
        for number in range(1 + context.size.program_runs):
            for name, command in commands.items():
                one = _until_subscribed(context, command, env)
                costs[name] += [one] * bool(number)
    for name, each in costs.items():
        _add(context, f"{name}, until it is subscribed", each)


def _until_subscribed(context: Context, command: Sequence[object], env: dict[str, str]) -> Costs:
    master, start = xmlrpc.client.ServerProxy(env["ROS_MASTER_URI"]), time.perf_counter()
    log = context.folder / "recorder.log"
    with log.open("w") as output:
        child = subprocess.Popen(
            list(map(str, command)),
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
    try:
        _await_subscriber(master, start, child, log, there=True)
        seconds, main = time.perf_counter() - start, psutil.Process(child.pid)
        processes = [main, *main.children(recursive=True)]
        times = [one.cpu_times() for one in processes]
        for one in processes[::-1][:1]:  # rosbag is a Python program that starts another
            one.send_signal(2)
        child.wait(PATIENCE_SEC)
    finally:
        if child.poll() is None:
            child.kill()
            child.wait()
    _await_subscriber(master, time.perf_counter(), None, log, there=False)
    return Costs(seconds, sum(one.user + one.system for one in times), None)


def _await_subscriber(
    master: xmlrpc.client.ServerProxy,
    start: float,
    child: subprocess.Popen[bytes] | None,
    log: Path,
    there: bool,
) -> None:
    while True:
        _, _, (_, subscribers, _) = master.getSystemState("/benchmark")
        if there == any(topic == TOPIC for topic, _ in subscribers):
            return
        if child is not None and child.poll() is not None:
            raise RuntimeError(f"it ended: {log.read_text()[-500:]}")
        if time.perf_counter() - start > PATIENCE_SEC:
            raise TimeoutError(f"it does not subscribe or end: {log.read_text()[-500:]}")
        time.sleep(0.01)


def _import(context: Context) -> None:
    """Import the Husky's bag by the command into new keyspaces."""
    server, costs = context.server, []
    for number in range(context.size.program_runs):
        keyspace = f"{server.keyspace}_husky_{number}"
        command = [PROGRAMS / "cassandra_bag", "import", "-q", HUSKY_BAG]
        before = server.cpu()
        one = _run([*command, *_store_options(context, keyspace)], context.folder)
        after = server.cpu()
        one.server_cpu = None if before is None or after is None else after - before
        costs.append(one)
        server.drop(keyspace)
    # The first import warms the server up.
    _add(context, "cassandra_bag import, Husky", costs[1:] or costs)


def _side_tables(context: Context) -> None:
    """Make keyspaces with their side tables."""
    server, costs = context.server, []
    for number in range(1 + context.size.program_runs):
        keyspace = f"{server.keyspace}_new_{number}"
        with RosCassandra(server.host, server.port) as store:

            def make(store: RosCassandra = store, keyspace: str = keyspace) -> None:
                store.connectToKeyspace(keyspace)
                store.catalog.keyspace.side_tables.make()

            costs.append(measure(server, make)[0])
        server.drop(keyspace)
    _add(context, "new keyspace, side tables", costs[1:])


def _topic_tables(context: Context) -> None:
    """Make tables of topics in one keyspace, some together, others one by one."""
    server, made = context.server, 0
    keyspace, batch = f"{server.keyspace}_topics", imu(1)
    with RosCassandra(server.host, server.port, keyspace=keyspace) as store:
        with store.messageWriter() as writer:
            for step in context.size.table_steps:
                alone = range(step - ALONE, step)
                while made < alone.start:
                    names = range(made, min(made + TOGETHER, alone.start))
                    asked = [Asked(batch.first(1, f"/topic_{n}").connection) for n in names]
                    cost, _ = measure(server, lambda asked=asked: writer.make_tables(asked))
                    made = names.stop
                    _add_table(context, "together", step, cost, len(names))
                for number in alone:
                    name = f"/topic_{number}"
                    cost, _ = measure(
                        server,
                        lambda name=name: store.addTopic(name, msg_type="sensor_msgs/Imu"),
                    )
                    _add_table(context, "one by one", step, cost, 1)
                made = alone.stop
            found = len(store.getAllTopics())
            assert found == made, f"{found} topics of {made}"
    server.drop(keyspace)


def _add_table(context: Context, way: str, step: int, cost: Costs, tables: int) -> None:
    context.add("table", way, cost.seconds / tables * 1e3, "ms", x=step)
    context.add("table, client cpu", way, cost.client_cpu / tables * 1e3, "ms", x=step)
    if cost.server_cpu is not None:
        context.add("table, server cpu", way, cost.server_cpu / tables * 1e3, "ms", x=step)


def _local_cassandra(context: Context) -> None:
    """Start and stop a local Cassandra by its command; the first start does not count."""
    program = PROGRAMS / "local_cassandra"
    with context.new_folder("local_cassandra") as folder:
        where = ["--dir", folder / "data"]
        costs = []
        for number in range(1 + context.size.starts):
            port = ["--port", free_port()] if not number else []
            one = _run([program, "start", *where, *port], context.folder)
            (status,) = LocalCluster(folder / "data").status()
            used = psutil.Process(status.pid).cpu_times()
            one.server_cpu = used.user + used.system
            _run([program, "stop", *where], context.folder)
            costs.append(one)
    _add(context, "local_cassandra start", costs[1:])


def _make_setup(context: Context) -> None:
    """Run make setup, which finds everything there."""
    costs = [_run(["make", "setup"], context.folder, ROOT) for _ in range(1 + context.size.starts)]
    _add(context, "make setup", costs[1:])
