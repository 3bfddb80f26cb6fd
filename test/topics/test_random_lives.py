# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Random lives of topics agree with a model: a dictionary of what each topic must hold.

Topics are added, written, imported, renamed, converted, indexed, truncated, dropped and made again,
and messages are removed from them. After each step everything that is stored is read.
"""

from __future__ import annotations

import random

import genpy
import pytest
from bag.truth import string_connection, string_wire
from std_msgs.msg import String
from suites import examples

from cassandra_ros.errors import CassandraRosError
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.metadata import FORMAT_NAMES
from cassandra_ros.store.tables import replacement

SEC = 10**9
T0 = 1_600_000_000 * SEC
NAMES = ("/a", "/b", "/c/d", "/e f")
NODES = ("", "r1", "r2")
SLOTS = 40
"""Number of different stamps, half a minute apart: many messages share one."""
STEPS = 25


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Clients of these tests read the comments anew at once."""
    monkeypatch.setattr(replacement, "SETTLE_SEC", 0.05)
    monkeypatch.setattr("cassandra_ros.store.tables.schema.CACHE_SEC", 0.03)


class Life:
    """One keyspace and the model of it: topic -> identity of a message -> (time, node, text).

    Args:
        rosCas: Connected to an empty keyspace.
        folder: Where bags are written.
        seed: Of what happens.
    """

    def __init__(self, rosCas, folder, seed):
        self.rosCas, self.folder = rosCas, folder
        self.random = random.Random(seed)
        self.model = {}
        self.indexed = set()
        self.bags = []
        self.number = 0
        self.log = []

    def step(self):
        kinds = [
            *[self.add] * 4,
            *[self.write] * 4,
            *[self.import_new] * 2,
            self.import_again,
            self.rename,
            *[self.convert] * 2,
            *[self.remove] * 3,
            self.truncate,
            self.index,
            self.unindex,
            self.drop,
        ]
        step = self.random.choice(kinds)
        self.log.append(step.__name__)
        step()

    def _text(self):
        self.number += 1
        return self.random.choice((f"n{self.number}", f"n{self.number} " + "long " * 300))

    def _time(self):
        return T0 + self.random.randrange(SLOTS) * 30 * SEC

    def _known(self):
        return self.random.choice(sorted(self.model)) if self.model else None

    def _note(self, topic, identity, t_ns, node, text):
        self.log[-1] += f" {topic}"
        self.model.setdefault(topic, {})[identity] = (t_ns, node, text)

    def add(self):
        name, node, t_ns, text = (
            self.random.choice(NAMES),
            self.random.choice(NODES),
            self._time(),
            self._text(),
        )
        if name not in self.model:
            form = self.random.choice(list(FORMAT_NAMES))
            self.log[-1] += f" as {form}"
            self.rosCas.addTopic(name, format=form)
        key = genpy.Time(t_ns // SEC, t_ns % SEC)
        self.rosCas.getTopic(name).addData(String(text), key=key, nodeID=node)
        self._note(name, self.number, t_ns, node, text)

    def write(self):
        name, node, form = (
            self.random.choice(NAMES),
            self.random.choice(NODES),
            self.random.choice(list(FORMAT_NAMES)),
        )
        with self.rosCas.messageWriter(nodeID=node, format=form) as writer:
            handle = writer.connect(string_connection(name))
            for counter in range(self.random.choice((1, 20))):
                t_ns, text = self._time(), self._text()
                writer.write(handle, t_ns, counter, string_wire(text))
                self._note(name, self.number, t_ns, node, text)

    def import_new(self):
        path, messages = self.folder / f"{len(self.bags)}.bag", []
        with BagWriter(path) as writer:
            names = self.random.sample(NAMES, 2)
            numbers = [writer.connection(string_connection(name)) for name in names]
            for place in range(self.random.choice((2, 30))):
                turn, t_ns, text = self.random.randrange(2), self._time(), self._text()
                writer.write(numbers[turn], t_ns, string_wire(text))
                messages.append((names[turn], (path.name, place), t_ns, text))
        self.bags.append((path, messages))
        self._import(path, messages, self.random.choice(list(FORMAT_NAMES)))

    def import_again(self):
        if self.bags:
            # Its rows stay in the format that they have: another one is refused.
            self._import(*self.random.choice(self.bags), None)

    def _import(self, path, messages, form):
        node = "r1"  # for another robot it would be another import
        import_bag(self.rosCas, path, nodeID=node, format=form)
        for name, identity, t_ns, text in messages:
            self._note(name, identity, t_ns, node, text)

    def rename(self):
        name, free = self._known(), sorted({"/g", *NAMES} - set(self.model))
        if name and free:
            new = self.random.choice(free)
            self.log[-1] += f" {name} {new}"
            self.rosCas.renameTopic(name, new)
            self.model[new] = self.model.pop(name)
            if name in self.indexed:
                self.indexed = self.indexed - {name} | {new}

    def convert(self):
        name, form = self._known(), self.random.choice(list(FORMAT_NAMES))
        if name and self.model[name]:
            self.log[-1] += f" {name} {form}"
            self.rosCas.convertTopic(name, form)

    def remove(self):
        name, node = self._known(), self.random.choice((None, *NODES))
        first, last = sorted((self._time(), self._time()))
        if name:
            self.log[-1] += f" {name} {node} {first} {last}"
            self.rosCas.getTopic(name).removeData(first, last, nodeID=node)
            self.model[name] = {
                identity: (t_ns, whose, text)
                for identity, (t_ns, whose, text) in self.model[name].items()
                if not (first <= t_ns <= last and node in (None, whose))
            }

    def truncate(self):
        name = self._known()
        if name:
            self.log[-1] += f" {name}"
            self.rosCas.truncateTopic(name)
            self.model[name] = {}

    def index(self):
        name = self._known()
        topic = name and self.rosCas.getTopic(name)
        # Blocks are found by their zones; a topic without a table has no field yet.
        if topic and topic.tables and not any(table.packed for table in topic.tables):
            self.log[-1] += f" {name}"
            topic.createIndex("data")
            self.indexed.add(name)

    def unindex(self):
        for name in sorted(self.indexed)[:1]:
            topic = self.rosCas.getTopic(name)
            if topic.hasIndex("data"):
                topic.removeIndex("data")
            self.indexed.discard(name)

    def drop(self):
        name = self._known()
        if name:
            self.log[-1] += f" {name}"
            self.rosCas.removeTopic(name)
            del self.model[name]
            self.indexed.discard(name)

    def check(self):
        """Compare all that is stored with the model."""
        assert {topic.name for topic in self.rosCas.getAllTopics()} == set(self.model), self.log
        told = dict.fromkeys(self.model, 0)
        for info in self.rosCas.info():
            told[info.topic] += info.count
        for name, messages in self.model.items():
            topic, wanted = self.rosCas.getTopic(name), sorted(messages.values())
            rows = list(topic.rows())
            assert [row.t for row in rows] == [t_ns for t_ns, _, _ in wanted], (name, self.log)
            stored = sorted((row.t, row.node, row.wire[4:].decode()) for row in rows)
            assert stored == wanted, (name, self.log)
            assert told[name] == topic.countTopicData() == len(wanted), (name, self.log)
            self._check_answers(name, topic, wanted)

    def _check_answers(self, name, topic, wanted):
        if not wanted:
            return
        first, last = sorted((self._time(), self._time()))
        within = [each for each in wanted if first <= each[0] <= last]
        assert topic.countTopicData(first, last) == len(within), (name, self.log)
        text, node = self.random.choice(wanted)[2], self.random.choice(NODES)
        statement = f'SELECT data FROM "{name}" WHERE '
        found = self.rosCas.executeCQL(statement + "data = ?", [text])
        assert found == [(each[2],) for each in wanted if each[2] == text], (name, self.log)
        found = self.rosCas.executeCQL(statement + "NODE = ?", [node])
        assert sorted(found) == sorted((e[2],) for e in wanted if e[1] == node), (name, self.log)


@pytest.mark.suite("all", "a search over lives of a topic")
@pytest.mark.search
def test_random_lives_agree_with_the_model(fresh, tmp_path, record_property):
    lives = examples(4)
    for seed in range(lives):
        folder = tmp_path / str(seed)
        folder.mkdir()
        with fresh() as rosCas:
            life = Life(rosCas, folder, seed)
            for _ in range(STEPS):
                try:
                    life.step()
                except CassandraRosError as exc:
                    raise AssertionError((seed, life.log)) from exc
                life.check()
    record_property("told", f"{lives} random lives of {STEPS} steps agreed with the model")
