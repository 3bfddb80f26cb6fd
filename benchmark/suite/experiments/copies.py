# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Copy a topic into another keyspace: beside export and import, and beside writing it."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

from cassandra_ros import Replicator, RosCassandra
from cassandra_ros.files.bag.exporter import export_bag
from cassandra_ros.files.bag.importer import import_bag
from suite.contenders import FORMAT_NAMES
from suite.contenders.store import folder_bag
from suite.context import Context, measure
from suite.messages import KINDS, NAMES, Batch

COPIED = ("imu", "scan", "image")


def run(context: Context) -> None:
    """Measure some kinds in each format."""
    for kind in (kind for kind in COPIED if kind in context.size.counts):
        batch = KINDS[kind](context.size.counts[kind])
        context.say(f" {NAMES[kind]}: {len(batch):,} messages, {batch.total_bytes / 1e6:,.1f} MB")
        with context.new_folder(kind) as folder:
            for form in FORMAT_NAMES:
                with context.part(f"{kind}, {form}"):
                    _Rounds(context, batch, folder, form).run()


class _Rounds:
    """The rounds of one kind and format; the first only warms up."""

    def __init__(self, context: Context, batch: Batch, folder: Path, form: str) -> None:
        self.context, self.batch, self.folder, self.form = context, batch, folder, form
        self._samples: dict[tuple[str, str], list[float]] = {}

    def run(self) -> None:
        """Run them all, and note the samples."""
        server, form = self.context.server, self.form
        keyspace = f"{server.keyspace}_robot_{self.batch.kind}_{form}"
        with RosCassandra(server.host, server.port, keyspace=keyspace) as robot:
            import_bag(robot, folder_bag(self.batch, self.folder), format=form)
            for number in range(-self.context.size.warm_ups, self.context.size.rounds):
                self._one(number, "verbatim", lambda home: self._copy(robot, home))
                self._one(number, "export and import", lambda home: self._carry(robot, home))
                self._one(number, "import", lambda home: self._import(home))
        server.drop(keyspace)
        kind = self.batch.kind
        for (what, unit), values in self._samples.items():
            self.context.add(what, form, values, unit, kind=kind)

    def _one(self, number: int, name: str, work: Callable[[RosCassandra], int]) -> None:
        server, count = self.context.server, len(self.batch)
        keyspace = f"{server.keyspace}_home"
        with RosCassandra(server.host, server.port, keyspace=keyspace) as home:
            home.catalog.keyspace.side_tables.make()
            costs, sent = measure(server, lambda: work(home))
            found = sum(info.count for info in home.info())
            assert found == count, f"{found:,} of {count:,} stored"
        server.drop(keyspace)
        if number < 0:
            return
        self._samples.setdefault((name, "msg/s"), []).append(count / costs.seconds)
        cpu = costs.client_cpu / count * 1e6
        self._samples.setdefault((f"{name} client cpu", "µs/msg"), []).append(cpu)
        if sent:
            share = sent / self.batch.total_bytes
            self._samples.setdefault((f"{name} sent", "of wire bytes"), []).append(share)

    def _copy(self, robot: RosCassandra, home: RosCassandra) -> int:
        replicator = Replicator(robot, home)
        report = replicator.copy()
        assert report.complete, report
        return replicator.sent_bytes

    def _carry(self, robot: RosCassandra, home: RosCassandra) -> int:
        path = self.folder / "carried.bag"
        export_bag(robot, path, force=True)
        import_bag(home, path, format=self.form)
        return path.stat().st_size

    def _import(self, home: RosCassandra) -> int:
        import_bag(home, folder_bag(self.batch, self.folder), format=self.form)
        return 0
