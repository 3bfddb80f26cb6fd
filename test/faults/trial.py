# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One fault on its way: publishers, recorders, verbs, and at the end its account."""

from __future__ import annotations

import contextlib
import json
import random
import sys
import time
import uuid
from dataclasses import dataclass, field
from pathlib import Path
from typing import Callable, Sequence

from cassandra import DriverException
from cassandra.cluster import NoHostAvailable

from faults.account import Store
from faults.numbered import Published, count_published, published_at
from faults.world import PROGRAMS, Failed, Program, Server, World, await_true, run_account

START_NS = 1_700_000_000 * 10**9
"""Time of the first message of a bag, ns."""
BAG_HZ = 1000
TOPIC = "/numbered"
VERB_SEC = 900.0
CURRENT_SEC = 1.5
"""Maximum age of the first message that a recorder which is not behind has not stored yet, s. It is
less than what the account takes for in flight."""


class Skipped(Exception):
    """A fault cannot be made on this machine; the text says why."""


@dataclass(frozen=True)
class Place:
    """Where a program finds the store."""

    host: str
    port: int


@dataclass
class Result:
    """The line of a fault in the table."""

    name: str
    messages: int
    """Number of messages of each publisher or bag."""
    short: bool
    """Whether it ran in the short form."""
    sums: dict = field(default_factory=dict)
    """What the account says."""
    normal_sec: float | None = None
    """Time from the end of the fault until a later message was stored, s; None = no recorder."""
    check: str = ""
    """First finding of cassandra_bag check; '' = there is no finding."""
    seconds: float = 0.0
    """Duration of the whole trial, s."""
    skipped: str = ""
    """Why it did not run; '' = it ran."""
    notes: list[str] = field(default_factory=list)

    @property
    def clean(self) -> bool:
        """Whether every message is accounted for, none twice, none changed, and check agrees."""
        wrong = [self.sums.get(name) for name in ("unaccounted", "doubled", "changed")]
        return bool(self.skipped) or (not any(wrong) and bool(self.sums) and not self.check)


class Trial:
    """One run of one fault, in a keyspace of its own.

    Args:
        world: Its surroundings.
        name: Name of the fault.
        messages: Number of messages of each publisher or bag.
        rate: Messages a second of each publisher.
        short: Whether the fault may last for seconds only.
    """

    def __init__(self, world: World, name: str, messages: int, rate: float, short: bool) -> None:
        self.world, self.messages, self.rate, self.short = world, messages, rate, short
        self.result = Result(name, messages, short)
        self.keyspace = f"f_{uuid.uuid4().hex[:12]}"
        self.folder = world.folder / self.keyspace
        self.folder.mkdir()
        self.random = random.Random()
        self._server: Server | None = None
        self.master = world.master
        self.robots = [""]
        self.topics, self.step = 1, 0
        """Number of topics, and of messages after which a further one begins, see topic_of."""
        self.kills: list[int] = []
        self.removed: list[tuple[int, int]] = []
        self.removed_count = 0
        self.gone_before_ns = 0
        self.told = 0
        self.open = contextlib.ExitStack()
        """What is closed after the account: proxies, servers of this trial."""
        self.at_end: list[Callable[[], None]] = []
        """What is done when publishers and recorders have ended, before the account."""
        self._enough = self.folder / "enough"
        """File that ends the publishers."""
        self._logs: list[Path] = []
        self._programs: list[Program] = []

    def __enter__(self) -> Trial:
        self._began = time.monotonic()
        return self

    def __exit__(self, *exc_info: object) -> None:
        for program in self._programs:
            if program.runs:
                program.kill()
        self.open.close()

    def seconds(self, short: float, long: float) -> float:
        """Return how long the fault lasts, s."""
        return short if self.short else long

    @property
    def server(self) -> Server:
        """The Cassandra of the trial; if none was chosen, the one of the world."""
        if self._server is None:
            self._server = self.world.server
        return self._server

    @server.setter
    def server(self, chosen: Server) -> None:
        self._server = chosen

    @property
    def place(self) -> Place:
        """The server without a proxy."""
        return Place(",".join(self.server.hosts), self.server.port)

    def run(self, *command: object, **env: str) -> Program:
        """Start a program; it is killed at the end if it still runs."""
        output = self.folder / f"{len(self._programs)}.log"
        own = {"ROS_MASTER_URI": self.master.uri, "ROS_HOME": str(self.folder / "ros")}
        program = Program(list(command), output, {**self.world.env, **own, **env})
        self._programs.append(program)
        return program

    def publisher(self, *, messages: int = 0, first: int = 0, **options: object) -> Publisher:
        """Start a publisher; it begins when it has a subscriber.

        Args:
            messages: Number of messages; 0 = those of the trial, and more until ``finish``.
            first: The first number.
            options: Further options of publisher.py.
        """
        log = self.folder / f"published_{len(self._logs)}.log"
        self._logs.append(log)
        ends = messages > 0
        if not ends:
            messages, options = self.messages, {"until": self._enough, **options}
        given = {"log": log, "first": first, "count": messages, "rate": self.rate, **options}
        given.update(topics=self.topics, step=self.step)
        words = [word for name, value in given.items() for word in (f"--{name}", value)]
        program = self.run(sys.executable, "-m", "faults.publisher", *words)
        return Publisher(program, log, messages, ends)

    def recorder(self, *options: object, place: Place | None = None, **env: str) -> Program:
        """Start a recorder and wait until it records."""
        program = self.start_recorder(*options, place=place, **env)
        program.await_text("recording 1 topic")
        return program

    def start_recorder(self, *options: object, place: Place | None = None, **env: str) -> Program:
        """Start a recorder; it does not record yet."""
        where = self._store_options(place or self.place, options)
        return self.run(PROGRAMS / "recorder", *where, *options, **env)

    def record(
        self, *options: object, place: Place | None = None, **env: str
    ) -> tuple[Program, Publisher]:
        """Start a recorder of the topic and its publisher; wait until a message is stored."""
        recorder = self.recorder(TOPIC, *options, place=place, **env)
        publisher = self.publisher()
        await_true("a message is stored", lambda: self._newest_ns() > 0)
        return recorder, publisher

    def verb(self, *words: object, place: Place | None = None) -> Program:
        """Start a verb of cassandra_bag."""
        verb, *others = words
        where = self._store_options(place or self.place, others)
        return self.run(PROGRAMS / "cassandra_bag", verb, *where, *others)

    def done(self, *words: object, status: int = 0, place: Place | None = None) -> str:
        """Run a verb of cassandra_bag to its end; return its output.

        Raises:
            Failed: It has another exit status.
        """
        program = self.verb(*words, place=place)
        if program.process.wait(VERB_SEC) != status:
            raise Failed(f"{words}: exit status {program.process.returncode}:\n{program.output}")
        return program.output

    def removed_by(self, output: str) -> None:
        """Note how many messages a verb with --json says that it has deleted."""
        answer, _ = json.JSONDecoder().raw_decode(output, output.index("{"))
        self.removed_count += sum(answer["deleted"].values())

    def bag(self, topics: int = 4) -> Path:
        """Write a bag of all messages, and its log."""
        path, log = self.folder / "numbered.bag", self.folder / "bag.log"
        self._logs.append(log)
        self.topics = topics
        words = [path, log, self.messages, topics, START_NS, BAG_HZ]
        writing = self.run(sys.executable, "-m", "faults.bag", *words)
        if writing.process.wait(VERB_SEC):
            raise Failed(f"the bag was not written:\n{writing.output}")
        return path

    def time_of(self, share: float) -> int:
        """Return the time between two messages of a bag, after a share of them, ns."""
        return START_NS + int(self.messages * share) * 10**9 // BAG_HZ - 1

    def store(self) -> Store:
        """Open the keyspace with the bare driver."""
        return Store(self.server.hosts, self.server.port, self.keyspace)

    def await_normal(self, since_ns: int | None = None) -> None:
        """Wait until a message is stored that was published after a time; note how long it took.

        Args:
            since_ns: The time, ns; default: now.
        """
        since = since_ns or time.time_ns()

        await_true(
            "a later message is stored", lambda: self._newest_ns() > since, self.seconds(120, 900)
        )
        self.result.normal_sec = round((time.time_ns() - since) / 1e9, 1)

    def await_current(self, publisher: Publisher) -> None:
        """Wait until what a publisher sent a moment ago is stored: a busy machine is behind."""

        def current() -> bool:
            try:
                with self.store() as store:
                    newest = store.newest_number(TOPIC)
            except (NoHostAvailable, DriverException):
                return False
            missing = publisher.line(newest + 1)
            return missing is None or time.time_ns() - missing.time_ns < CURRENT_SEC * 1e9

        await_true("what was published a moment ago is stored", current, VERB_SEC)

    def await_newer(self) -> None:
        """Wait until a message is stored that is later than all that are stored now."""
        newest = self._newest_ns()
        await_true("a later message is stored", lambda: self._newest_ns() > newest, 900)

    def _newest_ns(self) -> int:
        """Return the time of the newest stored message, ns; 0 while there is no answer."""
        try:
            with self.store() as store:
                return store.newest_ns(TOPIC)
        except (NoHostAvailable, DriverException):  # it is away, or the table is being made
            return 0

    def schema_is_locked(self) -> bool:
        """Return whether a program holds the schema lock of the keyspace."""
        try:
            with self.store() as store:
                return bool(list(store.select(f"SELECT owner FROM {self.keyspace}.cr_lock")))
        except (NoHostAvailable, DriverException):  # the table is not there yet
            return False

    def outlast_lock(self) -> None:
        """After a kill: in the short form, let the locks run out at once, not after 120 s."""
        if self.short:
            with contextlib.suppress(DriverException), self.store() as store:
                for (name,) in list(store.select(f"SELECT name FROM {self.keyspace}.cr_lock")):
                    cql = f"DELETE FROM {self.keyspace}.cr_lock WHERE name = '{name}' IF EXISTS"
                    list(store.select(cql))

    def note(self, text: str) -> None:
        """Add a note to the line of the fault."""
        self.result.notes.append(text)

    def finish(self) -> Result:
        """Let publishers and recorders end, make the account, run check; return the line."""
        self._enough.touch()
        for program in self._programs:
            if program.runs and "faults.publisher" in program.process.args:
                program.await_text("published", timeout_sec=VERB_SEC)
        recorders = [p for p in self._programs if str(PROGRAMS / "recorder") in p.process.args]
        for recorder in recorders:
            if recorder.runs:
                recorder.end()
        for work in self.at_end:
            work()
        self._drain()
        self.result.sums = run_account(self._case(), self.folder, self.world.env)
        self.result.check = self._findings()
        self.result.seconds = round(time.monotonic() - self._began, 1)
        if not self.result.clean:  # shown with the failure: the folder may be gone by then
            print("\n".join(recorder.output[-3000:] for recorder in recorders))
        self.drop(self.keyspace)
        return self.result

    def _drain(self) -> None:
        """Store what the recorders have left in the spool, as the next recorder would do.

        A recorder leaves messages there when the store is silent at its end, as it may be on a busy
        machine. The runs may be of the address of a proxy: their ids are named.
        """
        runs = json.loads(self.done("spool", "list", "--json"))
        if runs:
            self.note(f"{sum(run['messages'] for run in runs)} messages stayed in the spool")
            # It exits with 1 if messages were lost, which the account finds by itself.
            drain = self.verb("spool", "drain", *[run["id"] for run in runs])
            drain.process.wait(VERB_SEC)

    def _case(self) -> dict:
        return {
            "hosts": self.server.hosts,
            "port": self.server.port,
            "keyspace": self.keyspace,
            "topic": TOPIC,
            "topics": self.topics,
            "step": self.step,
            "logs": [str(path) for path in self._logs],
            "robots": self.robots,
            "kills": self.kills,
            "removed": self.removed,
            "removed_count": self.removed_count,
            "gone_before_ns": self.gone_before_ns,
            "told": self.told,
        }

    def _findings(self) -> str:
        program = self.verb("check")
        status = program.process.wait(VERB_SEC)
        return "" if not status else program.output.strip()[-2000:] or f"exit status {status}"

    def drop(self, keyspace: str, server: Server | None = None) -> None:
        """Drop a keyspace of a server of one node; server None = the one of the trial.

        Several nodes keep it: a drop fails in the middle where a node that was away still gets
        writes for it from the others, and its schema is another one then until it starts anew.
        """
        server = server or self.server
        if len(server.hosts) > 1:
            return
        store = Store(server.hosts, server.port, keyspace)
        with contextlib.suppress(DriverException), store:
            list(store.select(f"DROP KEYSPACE IF EXISTS {keyspace}"))

    def _store_options(self, place: Place, options: Sequence[object]) -> list[object]:
        """Return what names the store and the keyspace, but for what the options name."""
        named = {"--host": place.host, "--port": place.port, "--keyspace": self.keyspace}
        return [word for pair in named.items() if pair[0] not in options for word in pair]


class Publisher:
    """A publisher of numbered messages on its way."""

    def __init__(self, program: Program, log: Path, messages: int, ends: bool) -> None:
        self._program, self._log, self._messages, self._ends = program, log, messages, ends

    def await_share(self, share: float) -> None:
        """Wait until it has published a further share of its messages, or all if it ends then."""
        wanted = self.published + int(share * self._messages)
        if self._ends:
            wanted = min(wanted, self._messages)

        def reached() -> bool:
            if not self._program.runs:
                raise Failed(f"the publisher ended:\n{self._program.output[-3000:]}")
            return count_published(self._log) >= wanted

        await_true(f"{wanted} messages are published", reached, VERB_SEC)

    @property
    def published(self) -> int:
        """Number of messages published so far."""
        return count_published(self._log)

    def line(self, position: int) -> Published | None:
        """Return a line of its log, the first is 0; None if that is not published yet."""
        return published_at(self._log, position)
