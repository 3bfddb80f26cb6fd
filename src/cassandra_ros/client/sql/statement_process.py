# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The process in which statements of others run, see statement_processes.py.

It has a connection to the store of its own. It reads frames from standard input and answers on
standard output, and ends when its input ends.
"""

from __future__ import annotations

import json
import logging
import os
import queue
import resource
import shutil
import signal
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, BinaryIO, Iterator

from cassandra_ros.client.sql.duck_database import TOO_LARGE
from cassandra_ros.client.sql.process_frames import (
    ASK,
    BATCH,
    COLUMNS,
    END,
    ERROR,
    FATAL,
    HEAD,
    MAX_FRAME_BYTES,
    PLAN,
    STOP,
    STOPPED,
    error_values,
    frame,
    json_frame,
)
from cassandra_ros.client.sql.sql_result import SqlResult
from cassandra_ros.client.sql.sql_statement import load_parser
from cassandra_ros.errors import AnswerTooLarge, CassandraRosError, MissingDependency
from cassandra_ros.installation import optional_module
from cassandra_ros.query.arrays.arrow_types import load_arrow
from cassandra_ros.query.tree.json_values import from_json
from cassandra_ros.read import Whose
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.topics.catalog import Catalog

MORE_BYTES = 1 << 30
"""Maximum memory of a statement beside that of the idle process, bytes of addresses."""
SPILL_BYTES = 2 * 10**9
"""Maximum size of what a statement puts on disk, bytes."""
KEPT_BYTES = 10**9
"""Free space of the disk below which a statement puts nothing on it, bytes."""
_PIECE_BYTES = 4 << 20
"""Usual maximum size of a frame with rows, bytes."""
_END_SEC = 2.0
"""Maximum time until the process ends when its input has ended, s."""
_NICE = 10
"""Priority of statements, as nice: beside a program of usual priority that uses the same processor
they get a tenth of it. With the lowest, 19, they would get a seventieth, and a robot whose
processors are all busy would answer none in time."""
_TRIES = 20
"""Maximum number of tries to give the session this priority, each 0.1 s after the one before."""
_log = logging.getLogger(__name__)


class _Stopped(Exception):
    """The program does not wait for the answer any more."""


@dataclass
class _Mail:
    """What the thread that reads standard input has read. The main thread takes it."""

    stopped: threading.Event = field(default_factory=threading.Event)
    """Set by STOP, and by the end of the input. The next statement clears it: the program asks for
    one only when the answer before has ended."""
    requests: queue.SimpleQueue[dict[str, Any] | None] = field(default_factory=queue.SimpleQueue)
    """Statements; None = the input has ended."""


def read_frame(file: BinaryIO) -> tuple[bytes, bytes] | None:
    """Read a frame, its kind and content; None = the end."""
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    kind, size = HEAD.unpack(head)
    return kind, file.read(size)


def _read_mail(file: BinaryIO, mail: _Mail) -> None:
    """Read frames until the input ends, on a thread; then the process has _END_SEC left."""
    while (received := read_frame(file)) is not None:
        kind, content = received
        if kind == ASK:
            mail.stopped.clear()
            mail.requests.put(json.loads(content))
        elif kind == STOP:
            mail.stopped.set()
    mail.stopped.set()
    mail.requests.put(None)
    ending = threading.Timer(_END_SEC, os._exit, [1])  # DuckDB may not notice that it is stopped
    ending.daemon = True
    ending.start()


class _Answerer:
    """Answers statements, one after the other, all on the main thread.

    Args:
        hello: What the program said first, see HELLO.
        out: Takes the frames.
        mail: What the program says later.
    """

    def __init__(self, hello: dict[str, Any], out: BinaryIO, mail: _Mail) -> None:
        self._store = hello["store"]
        self._folder = hello["folder"]
        self._out = out
        self._mail = mail
        self._cassandra: Cassandra | None = None
        self._catalogs: dict[str, Catalog] = {}
        try:
            self._connect()
        except CassandraRosError as exc:  # told when there is a statement
            _log.debug("no connection yet: %s", exc)

    def _connect(self) -> Cassandra:
        """Return the connection; the first one fixes how much memory the process may use."""
        if self._cassandra is None:
            self._cassandra = Cassandra(**self._store)
            _limit(_address_bytes() + MORE_BYTES, resource.RLIMIT_AS)
        return self._cassandra

    def answer(self, request: dict[str, Any]) -> bool:
        """Answer a statement; return whether this process may run another one."""
        try:
            for content in self._frames(request):
                self._send(content)
        except BrokenPipeError:
            return False  # the program has ended
        except _Stopped:
            self._send(frame(STOPPED, b""))
        except (MemoryError, AnswerTooLarge) as exc:
            if isinstance(exc, MemoryError):
                exc = AnswerTooLarge(TOO_LARGE)
            self._send(json_frame(FATAL, error_values(exc)))
            return False  # memory that is in pieces may be too little for the next one
        except Exception as exc:  # noqa: BLE001 - the program raises it
            values = error_values(exc)
            if not values["error"]:
                _log.exception("a statement failed")
            self._send(json_frame(ERROR, values))
        return True

    def _frames(self, request: dict[str, Any]) -> Iterator[bytes]:
        """Yield the frames of the answer to a statement, see ``Statement`` and ``_values``."""
        writers = request["writers"]
        whose = Whose(
            None if request["nodes"] is None else tuple(request["nodes"]),
            None if writers is None else frozenset(writers),
        )
        params = [from_json(text, f"params[{n}]") for n, text in enumerate(request["params"])]
        spill = max(0, min(SPILL_BYTES, self._free_bytes() - KEPT_BYTES))
        result = SqlResult(
            self._catalog(request["keyspace"]),
            request["text"],
            params,
            whose,
            folder=self._folder,
            spill=spill,
            watch=self._look,
        )
        yield json_frame(COLUMNS, {"columns": result.columns})
        if request["plan"]:
            yield json_frame(PLAN, {"text": str(result.explain())})
        else:
            for batch in result.batches():
                yield from self._pieces(batch)
        yield json_frame(END, {"hints": result.hints})

    def _catalog(self, keyspace: str) -> Catalog:
        if keyspace not in self._catalogs:
            self._catalogs[keyspace] = Catalog(self._connect(), keyspace, None)
        return self._catalogs[keyspace]

    def _look(self) -> None:
        """Raise an error if the program has stopped the statement, or its disk is nearly full."""
        if self._mail.stopped.is_set():
            raise _Stopped
        if self._free_bytes() < KEPT_BYTES and has_files(self._folder):
            raise AnswerTooLarge(
                f"the statement was stopped: its disk has less than {KEPT_BYTES // 10**9} GB free; "
                "group its rows, or bound what it reads by WHERE"
            )

    def _free_bytes(self) -> int:
        return shutil.disk_usage(self._folder).free

    def _pieces(self, batch: Any) -> Iterator[bytes]:
        """Yield the frames of a batch, which is divided if it is large."""
        arrow, middle = load_arrow("sql"), batch.num_rows // 2
        if middle and batch.nbytes > _PIECE_BYTES:
            yield from self._pieces(batch.slice(0, middle))
            yield from self._pieces(batch.slice(middle))
            return
        sink = arrow.BufferOutputStream()
        with arrow.ipc.new_stream(sink, batch.schema) as writer:
            writer.write_batch(batch)
        content = sink.getvalue()
        if content.size > MAX_FRAME_BYTES:
            raise AnswerTooLarge(
                f"a row of the answer has {content.size} bytes, of at most {MAX_FRAME_BYTES}: "
                "select fewer columns, or a part of a long text or array"
            )
        yield frame(BATCH, content.to_pybytes())

    def _send(self, content: bytes) -> None:
        self._out.write(content)
        self._out.flush()

    def close(self) -> None:
        """Close the connection."""
        if self._cassandra is not None:
            self._cassandra.close()


def has_files(folder: str) -> bool:
    """Return whether a folder, or one in it, has a file: DuckDB makes its folder in any case."""
    return any(files for _, _, files in os.walk(folder))


def _limit(most: int, what: int) -> None:
    """Set a limit of this process, one of RLIMIT_…, to ``most`` or to the hard limit below it."""
    _, hard = resource.getrlimit(what)
    resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _address_bytes() -> int:
    """Return the size of the addresses that this process uses, bytes."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[0]) * resource.getpagesize()


def _yield_processor() -> None:
    """Take a low priority, among the processes of this session and among sessions."""
    # Linux has a priority for each thread; later ones take that of the thread that starts them.
    for thread in os.listdir("/proc/self/task"):
        with suppress(ProcessLookupError):  # it has ended
            os.setpriority(os.PRIO_PROCESS, int(thread), _NICE)
    # Linux weighs sessions against each other, unless it was built or started without that.
    with suppress(OSError):
        for _ in range(_TRIES):
            try:
                with open("/proc/self/autogroup", "w", encoding="ascii") as group:
                    group.write(str(_NICE))
                return
            except BlockingIOError:  # users other than root do so ten times a second at most
                time.sleep(0.1)


def main() -> int:
    """Answer statements until the input ends; return the exit status."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program
    out, mail = os.fdopen(os.dup(1), "wb"), _Mail()
    os.dup2(2, 1)  # what a library prints is not a frame
    source = sys.stdin.buffer
    hello = read_frame(source)
    if hello is None:
        return 0
    threading.Thread(target=_read_mail, args=[source, mail], daemon=True).start()
    with suppress(MissingDependency):  # told when there is a statement
        load_parser()
        load_arrow("sql")
        optional_module("duckdb", "sql")
    _limit(0, resource.RLIMIT_CORE)
    _limit(SPILL_BYTES, resource.RLIMIT_FSIZE)
    answerer = _Answerer(json.loads(hello[1]), out, mail)
    _yield_processor()  # not before: the start counts in the time of the first statement
    while (request := mail.requests.get()) is not None:
        if not answerer.answer(request):
            break
    answerer.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
