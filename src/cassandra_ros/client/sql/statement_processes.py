# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements of others, which run in processes of their own.

DuckDB may end its process, use memory that it does not count, or not notice that it is interrupted.
In such a process that costs an answer, not the program.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, Iterator, Mapping, NamedTuple

from cassandra_ros.client.sql.duck_database import TOO_LARGE, SpillFolder
from cassandra_ros.client.sql.process_frames import (
    ASK,
    BATCH,
    END,
    ERROR,
    FATAL,
    HEAD,
    HELLO,
    LAST,
    MAX_FRAME_BYTES,
    PLAN,
    STOP,
    error_of,
    json_frame,
)
from cassandra_ros.client.sql.python_values import python_rows
from cassandra_ros.errors import AnswerTooLarge, CassandraRosError, InvalidQuery, StoreUnavailable
from cassandra_ros.query.arrays.arrow_types import load_arrow
from cassandra_ros.query.plan.pushdown import Watch
from cassandra_ros.read import Whose
from cassandra_ros.store.connection.cassandra import Cassandra

if TYPE_CHECKING:
    import pyarrow

STATEMENTS_AT_ONCE = 2
"""Maximum number of statements that run at the same time; the others wait."""
STATEMENT_SEC = 60.0
"""Maximum time of a statement, with its wait, s."""
_STOP_SEC = 1.0
"""Time that a statement has to end by itself before its process is killed, s."""
_LOOK_SEC = 0.05
"""Interval at which a waiting program looks whether its client is still there, s."""
_READ_BYTES = 1 << 20
_NO_MEMORY_STATUS = 127
"""Exit status of a process in which glibc found no memory for what each thread has of its own."""


class Statement(NamedTuple):
    """A statement in SQL as it is asked."""

    keyspace: str
    text: str
    whose: Whose
    params: tuple[str, ...] = ()
    """Values of its parameters, each as JSON."""
    plan: bool = False
    """Whether it is asked for the explanation in place of the rows."""


class _Ended(Exception):
    """The process has ended."""


class _Process:
    """One process; it runs one statement at a time. One thread uses it at a time. Close it.

    Args:
        store: Arguments with which it connects to the store.

    Raises:
        OSError: No process, or no folder for it, can be made.
    """

    def __init__(self, store: dict[str, Any]) -> None:
        self.is_free = True
        """Whether it has given its last answer whole, and takes another statement."""
        self._received = bytearray()
        """What was read of its output and is in no frame yet."""
        self._folder = SpillFolder()
        # In the terminal's group it would get the program's Ctrl-C.
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "cassandra_ros.client.sql.statement_process"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,
                # Each arena of glibc takes 64 MB of addresses, which are limited.
                env={
                    **os.environ,
                    "PYTHONPATH": os.pathsep.join(sys.path),
                    "MALLOC_ARENA_MAX": "2",
                },
            )
        except OSError:
            self._folder.close()
            raise
        if self._process.stdin is None or self._process.stdout is None:
            raise TypeError("a process with pipes")
        self._input, self._output = self._process.stdin, self._process.stdout.fileno()
        self._poll = select.poll()
        self._poll.register(self._output, select.POLLIN)
        with suppress(OSError):  # told by the first statement
            self.send(json_frame(HELLO, {"store": store, "folder": self._folder.path}))

    def send(self, content: bytes) -> None:
        """Send a frame; raises OSError if the process has ended."""
        self._input.write(content)
        self._input.flush()

    def frames(self, watch: Watch) -> Iterator[tuple[bytes, bytes]]:
        """Yield the frames of an answer, the last one as well; an exception of watch breaks it off.

        Raises:
            _Ended: The process has ended.
        """
        kind = b""
        while kind not in LAST:
            self._await(HEAD.size, watch)
            kind, size = HEAD.unpack_from(self._received)
            if size > MAX_FRAME_BYTES:
                raise _Ended
            self._await(HEAD.size + size, watch)
            content = bytes(self._received[HEAD.size : HEAD.size + size])
            del self._received[: HEAD.size + size]
            yield kind, content

    def _await(self, size: int, watch: Watch) -> None:
        """Read until ``size`` bytes are there; raises _Ended, or what the watch raises."""
        while len(self._received) < size:
            watch()
            if self._poll.poll(1000 * _LOOK_SEC):
                piece = os.read(self._output, min(_READ_BYTES, size - len(self._received)))
                if not piece:
                    raise _Ended
                self._received += piece

    def ask(self, values: Mapping[str, object], watch: Watch) -> Iterator[tuple[bytes, bytes]]:
        """Ask a statement, and yield the frames of its answer.

        Raises:
            _Ended, OSError: The process has ended.
        """
        self.is_free = False
        self.send(json_frame(ASK, values))
        for kind, content in self.frames(watch):
            self.is_free = kind in LAST and kind != FATAL
            yield kind, content

    def stop(self) -> None:
        """End what runs; if it does not end in time, the process is not free."""
        ends = time.monotonic() + _STOP_SEC

        def watch() -> None:
            if time.monotonic() > ends:
                raise _Ended

        with suppress(_Ended, OSError):
            self.send(json_frame(STOP, {}))
            for kind, _ in self.frames(watch):
                self.is_free = kind in LAST and kind != FATAL

    @property
    def is_running(self) -> bool:
        """Whether the process has not ended."""
        return self._process.poll() is None

    def end(self) -> int:
        """Wait a moment for the end of the process, kill it then, and return its exit status.

        -N = signal N ended it.
        """
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_STOP_SEC)
        self._process.kill()
        return self._process.wait()

    def close(self) -> None:
        """End the process, and delete its files. Can be repeated."""
        self._process.kill()
        self._process.wait()
        for file in (self._process.stdin, self._process.stdout):
            if file is not None:
                with suppress(OSError):  # what was not sent yet
                    file.close()
        self._folder.close()


class SqlAnswer:
    """The answer of a process to a statement. It can be read once, while its context is open.

    Args:
        frames: The frames of the answer; the first one is COLUMNS.

    Attributes:
        columns: Names of the columns.
        plan: The explanation; '' = the statement was asked for its rows.
        hints: Why no message was found, when all rows were read.
    """

    def __init__(self, frames: Iterator[tuple[bytes, bytes]]) -> None:
        self._frames = frames
        self.plan = ""
        self.hints: list[str] = []
        _, content = next(frames)
        self.columns: tuple[str, ...] = tuple(json.loads(content)["columns"])

    def batches(self) -> Iterator[pyarrow.RecordBatch]:
        """Yield the rows as record batches of pyarrow, while they are computed; at least one."""
        arrow = load_arrow("sql")
        for kind, content in self._frames:
            if kind == BATCH:
                yield from arrow.ipc.open_stream(content)
            else:
                self._take(kind, content)

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        for batch in self.batches():
            yield from python_rows(load_arrow("sql"), batch)

    def explanation(self) -> str:
        """Wait for the explanation, and return it."""
        for kind, content in self._frames:
            self._take(kind, content)
        return self.plan

    def _take(self, kind: bytes, content: bytes) -> None:
        if kind == PLAN:
            self.plan = json.loads(content)["text"]
        elif kind == END:
            self.hints = json.loads(content)["hints"]


class StatementProcesses:
    """The processes of a program for the statements of its clients. Thread-safe; close it.

    The first statement starts one. It is used again, and replaced when a statement has ended it.

    Args:
        cassandra: The connection of the program.
    """

    def __init__(self, cassandra: Cassandra) -> None:
        self._store = cassandra.arguments()
        self._turns = threading.BoundedSemaphore(STATEMENTS_AT_ONCE)
        self._lock = threading.Lock()
        self._idle: list[_Process] = []
        self._closed = False

    @contextmanager
    def answer(
        self, statement: Statement, watch: Watch, seconds: float = STATEMENT_SEC
    ) -> Iterator[SqlAnswer]:
        """Run a statement when it is its turn; what runs is stopped at the end of the context.

        Args:
            statement: The statement.
            watch: Called repeatedly meanwhile; an exception from it stops the statement.
            seconds: Maximum time, with the wait, s; at most STATEMENT_SEC.

        Raises:
            InvalidQuery: The statement is wrong, or it ended its process.
            AnswerTooLarge: It needs more time, memory or room on disk than it may use.
            StoreUnavailable: The process has ended by itself, or the program ends.
            OSError: No process can be started.
        """
        watch = _watch_with_limit(watch, min(seconds, STATEMENT_SEC))
        while not self._turns.acquire(timeout=_LOOK_SEC):
            watch()
        try:
            process = self._take()
            try:
                yield SqlAnswer(self._frames(process, statement, watch))
            finally:
                self._put(process)
        finally:
            self._turns.release()

    def _frames(
        self, process: _Process, statement: Statement, watch: Watch
    ) -> Iterator[tuple[bytes, bytes]]:
        """Yield the frames of an answer, except an error, which is raised."""
        try:
            for kind, content in process.ask(_values(statement), watch):
                if kind in (ERROR, FATAL):
                    raise error_of(json.loads(content))
                yield kind, content
        except (_Ended, OSError) as exc:
            raise _crash(statement.text, process.end()) from exc

    def _take(self) -> _Process:
        """Return an idle process, or a new one."""
        with self._lock:
            if self._closed:
                raise StoreUnavailable("the program ends")
            while self._idle:
                process = self._idle.pop()
                if process.is_running:
                    return process
                process.close()
        try:
            return _Process(self._store)
        except OSError as exc:
            raise StoreUnavailable(f"no process can be started for SQL: {exc}") from exc

    def _put(self, process: _Process) -> None:
        """Keep a process for the next statement, or start another one in its place.

        It starts now, so that the next statement does not wait for that.
        """
        if not process.is_free and process.is_running:
            process.stop()
        if not process.is_free:
            process.close()
        with self._lock:
            if self._closed:
                process.close()
            elif process.is_free:
                self._idle.append(process)
            else:
                with suppress(OSError):  # the next statement tries again, and tells it
                    self._idle.append(_Process(self._store))

    def close(self) -> None:
        """End the processes; those that run a statement end with it."""
        with self._lock:
            self._closed = True
            while self._idle:
                self._idle.pop().close()


def _values(statement: Statement) -> dict[str, object]:
    """Return a statement as values of JSON: its fields, but ``nodes`` and ``writers`` of whose."""
    nodes, writers = statement.whose
    values: dict[str, object] = statement._asdict()
    del values["whose"]
    return {**values, "nodes": nodes, "writers": writers and sorted(writers)}


def _watch_with_limit(watch: Watch, seconds: float) -> Watch:
    """Return a watch that also ends what takes longer than this."""
    ends = time.monotonic() + seconds

    def look() -> None:
        watch()
        if time.monotonic() > ends:
            raise AnswerTooLarge(
                f"the statement was stopped after {seconds:g} s, of at most {STATEMENT_SEC:g} s: "
                "bound what it reads by WHERE"
            )

    return look


def _crash(text: str, status: int) -> CassandraRosError:
    """Return the error of a process that ended with an exit status while it ran a statement."""
    if status == _NO_MEMORY_STATUS:
        return AnswerTooLarge(TOO_LARGE)
    if status >= 0:
        return StoreUnavailable(
            f"the process for this statement ended (exit status {status}): the standard error of "
            "this program says why"
        )
    name = signal.Signals(-status).name
    reason = f"this statement ended DuckDB ({name}): ask for it in another way"
    if status == -signal.SIGKILL:
        reason += ", or for less: the machine may lack memory"
    return InvalidQuery(text, 0, reason)
