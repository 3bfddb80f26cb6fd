# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A client as a process of its own: does what each line of its stdin says, answers with a line."""

from __future__ import annotations

import json
import sys
import threading
import time

from std_msgs.msg import String

from cassandra_ros import RosCassandra
from cassandra_ros.errors import CassandraRosError
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of

T0 = 1_500_000_000 * 10**9
STEP_NS = 2_000_000
VALUES = ("a", "b", "", "grün", "x" * 2000)


class Writing:
    """Message after message on a thread, number by number, until it is stopped."""

    PAUSE_SEC = 0.001

    def __init__(self, rosCas, topic):
        self.rosCas, self.topic = rosCas, topic
        self.written = []
        """[number, time when it was begun, time when it was taken, table or '', error or '']"""
        self.failure = ""
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        try:
            while not self._stopping.wait(self.PAUSE_SEC):
                self.one()
        except BaseException as exc:  # noqa: BLE001 - handed to the test, which fails by it
            self.failure = f"{type(exc).__name__}: {exc}"

    def one(self):
        number, begun, table, error = len(self.written), time.time_ns(), "", ""
        try:
            table = self.put(T0 + number * STEP_NS, number)
        except CassandraRosError as exc:
            error = f"{type(exc).__name__}: {exc}"
        self.written.append([number, begun, time.time_ns(), table, error])

    def stop(self):
        self._stopping.set()
        self._thread.join()


class ByAddData(Writing):
    def put(self, t, number):
        return self.rosCas.getTopic(self.topic).addData(String(data=str(number)), key=t).table

    def end(self):
        self.stop()
        for _ in range(50):
            self.one()
        return {"written": self.written, "failure": self.failure}


class ByWriter(Writing):
    """Flushes nothing but what it is told to; linger and patience are the defaults."""

    def __init__(self, rosCas, topic):
        self.losses = []
        self.writer = rosCas.messageWriter(on_loss=lambda *loss: self.losses.append(loss))
        self.handle = self.writer.connect(api_connection(topic, definition_of(String), "/w"))
        super().__init__(rosCas, topic)

    def text(self, number):
        return str(number)

    def put(self, t, number):
        self.writer.write(self.handle, t, number, serialize(String(data=self.text(number))))
        return ""

    def end(self):
        self.stop()
        self.writer.flush()
        flushed, lost = len(self.written), sum(count for _, count, _ in self.losses)
        for _ in range(500):
            self.one()
        self.writer.close()
        stats = self.writer.stats()[self.topic]
        return {
            **{"written": self.written, "failure": self.failure},
            **{"flushed": flushed, "lost_before": lost},
            "lost": sum(count for _, count, _ in self.losses),
            "causes": sorted({type(error).__name__ for *_, error in self.losses}),
            "ours": all(isinstance(error, CassandraRosError) for *_, error in self.losses),
            **{"stats_stored": stats.stored, "stats_lost": stats.lost},
        }


class ByValues(ByWriter):
    """Texts that come again and again; some an index cannot hold.

    Seldom enough that a busy machine fills an index faster than there is more to fill.
    """

    PAUSE_SEC = 0.004

    def text(self, number):
        return VALUES[number % len(VALUES)]


def index(rosCas, topic, field, verb="createIndex", stop_at=0):
    """Make or remove an index; stand still when it has told so often how far it is."""
    told = 0

    def progress(done, total):
        nonlocal told
        told += 1
        print(json.dumps({"done": done, "total": total}), flush=True)
        if told == stop_at:
            sys.stdin.readline()

    try:
        if verb == "removeIndex":
            return {"removed": rosCas.getTopic(topic).removeIndex(field)}
        return {"filled": rosCas.getTopic(topic).createIndex(field, progress)}
    except CassandraRosError as exc:
        return {"error": f"{type(exc).__name__}: {exc}"}


def make(rosCas, topic, text):
    try:
        return {"table": rosCas.addTopic(topic).addData(String(data=text)).table}
    except Exception as exc:  # noqa: BLE001 - handed to the test, which fails by it
        return {"error": f"{type(exc).__name__}: {exc}"}


def main(host, port, keyspace):
    with RosCassandra(host, int(port), keyspace=keyspace) as rosCas:
        print("ready", flush=True)
        writing = None
        for line in sys.stdin:
            verb, *words = json.loads(line)
            if verb == "make":
                answer = make(rosCas, *words)
            elif verb == "write":
                kinds = {"addData": ByAddData, "messageWriter": ByWriter, "values": ByValues}
                writing = kinds[words[0]](rosCas, words[1])
                answer = {}
            elif verb == "index":
                answer = index(rosCas, *words)
            else:
                answer = writing.end()
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
