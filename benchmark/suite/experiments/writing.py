# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Write each kind of message by each contender, and read it back as objects and as arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable

import numpy as np

from suite.contenders import Contender, all_contenders, folder_bag, verify
from suite.contenders.store import Store, StoreImport
from suite.context import Context, Costs, measure, rotated
from suite.messages import KINDS, LARGE, NAMES, Batch

ARRAYS = {
    "paper": ["c", "d"],
    "imu": ["linear_acceleration.x", "linear_acceleration.y", "orientation_covariance"],
    "scan": ["ranges"],
}
"""Fields that are read as arrays."""


def run(context: Context) -> None:
    """Measure every kind."""
    for kind, count in context.size.counts.items():
        batch = KINDS[kind](count)
        context.say(f" {NAMES[kind]}: {count:,} messages, {batch.total_bytes / 1e6:,.1f} MB")
        with context.new_folder(kind) as folder:
            _Rounds(context, batch, folder).run()


class _Rounds:
    """The rounds of one kind; the first only warms up, and verifies."""

    def __init__(self, context: Context, batch: Batch, folder: Path) -> None:
        self.context, self.batch, self.folder = context, batch, folder
        self._failed: list[str] = []
        self._samples: dict[Any, list[float]] = {}
        size = context.size
        rounds = size.long_rounds if batch.kind in ("scan", *LARGE) else size.rounds
        self._numbers = range(-size.warm_ups, rounds)

    def run(self) -> None:
        """Run them all, and note the samples."""
        makers = all_contenders(self.context.server)
        folder_bag(self.batch, self.folder)
        for number in self._numbers:
            for name in rotated(list(makers), number + 1):
                if name in self._failed:
                    continue
                self._failed.append(name)
                with self.context.part(f"{self.batch.kind}, {name}"):
                    self._one(makers[name](self.batch, self.folder), number)
                    self._failed.remove(name)
        for (what, name, unit), values in self._samples.items():
            self.context.add(what, name, values, unit, kind=self.batch.kind)

    def _one(self, contender: Contender, number: int) -> None:
        count, server = len(self.batch), self.context.server
        contender.open()
        try:
            costs, _ = measure(server, lambda: _write(contender, count))
            self._note(number, "write", contender, costs)
            # What the other way of writing has written is read in the same way.
            alone = type(contender) is not StoreImport and "objects" not in contender.name
            if number in (self._numbers[0], self._numbers[-1]):
                verify(contender, self.batch)
            if alone:
                costs, read = measure(server, lambda: sum(1 for _ in contender.objects()))
                assert read == count, f"{read:,} of {count:,} read"
                self._note(number, "read", contender, costs)
                self._arrays(contender, number)
        finally:
            contender.discard()

    def _arrays(self, contender: Contender, number: int) -> None:
        fields = ARRAYS.get(self.batch.kind)
        if fields is None:
            return
        costs, found = measure(self.context.server, lambda: read_arrays(contender, fields))
        if number == self._numbers[0]:
            wanted = [gather(self.batch.objects(), name) for name in fields]
            for name, mine, theirs in zip(fields, found, wanted):
                assert np.array_equal(np.stack(mine), np.stack(theirs)), f"{name} differs"
        self._note(number, "arrays", contender, costs)

    def _note(self, number: int, what: str, contender: Contender, costs: Costs) -> None:
        if number < 0:
            return
        count, name = len(self.batch), contender.name
        rates: dict[str, float | None] = {
            f"{what}|msg/s": count / costs.seconds,
            f"{what} MB|MB/s": self.batch.total_bytes / 1e6 / costs.seconds,
            f"{what} client cpu|µs/msg": costs.client_cpu / count * 1e6,
        }
        if isinstance(contender, Store) or name == "bare driver":
            server = costs.server_cpu
            rates[f"{what} server cpu|µs/msg"] = None if server is None else server / count * 1e6
        for label, value in rates.items():
            if value is not None:
                of, _, unit = label.partition("|")
                self._samples.setdefault((of, name, unit), []).append(value)


def _write(contender: Contender, count: int) -> None:
    contender.extend(0, count)
    contender.finish()


def read_arrays(contender: Contender, fields: list[str]) -> list[Any]:
    """Read fields of all messages as numpy arrays, in the way that the contender offers."""
    if isinstance(contender, Store):
        found = contender.topic.getArrays(fields)
        return [found[name] for name in fields]
    columns: list[list[Any]] = [[] for _ in fields]
    getters = [getter(name) for name in fields]
    for msg in contender.objects():
        for column, get in zip(columns, getters):
            column.append(get(msg))
    return [np.array(column) for column in columns]


def getter(name: str) -> Callable[[Any], Any]:
    """Return what reads a field of a message, as 'a.b'."""
    first, _, rest = name.partition(".")
    if not rest:
        return lambda msg: getattr(msg, first)
    inner = getter(rest)
    return lambda msg: inner(getattr(msg, first))


def gather(objects: Any, name: str) -> Any:
    """Return a field of message objects as an array."""
    get = getter(name)
    return np.array([get(msg) for msg in objects])
