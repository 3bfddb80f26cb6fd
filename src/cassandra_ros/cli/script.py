# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run a program of the package; every file in scripts/ uses this module.

It reports an error, a missing Python package, Ctrl-C, and an output that takes nothing (a full
disk, a pipe without a reader) by a line of text and an exit status, if the program does not report
them itself.
"""

from __future__ import annotations

import contextlib
import errno
import importlib
import io
import logging
import os
import signal
import sys
from typing import NoReturn

from cassandra_ros.errors import DISK_FULL, CassandraRosError, cannot_write
from cassandra_ros.installation import explain_missing, is_needed
from cassandra_ros.printable import shown_lines

EXIT_INTERRUPTED = 128 + signal.SIGINT
_SIGNALLED = (EXIT_INTERRUPTED, 128 + signal.SIGTERM)
_UNWRITTEN = (*DISK_FULL, errno.EIO, errno.EROFS)
"""Errors of a disk that takes nothing."""


def run_script(module: str) -> None:
    """Import a module, call its `main() -> int` and end the process with this exit status."""
    program = module.rsplit(".", 1)[-1]
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A terminal that knows only ASCII gets other characters escaped.
            stream.reconfigure(errors="backslashreplace")
    try:
        status = _run(program, module)
        if sys.stdout is not None:  # it is None if the process was started without one
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of our output has ended (| head)
        _drop_unwritten()
        status = 128 + signal.SIGPIPE
    except OSError as exc:
        if exc.errno not in _UNWRITTEN:
            raise
        _drop_unwritten()
        status = f"{program}: {shown_lines(cannot_write(exc.filename or 'the output', exc))}"
    if isinstance(status, str):
        with contextlib.suppress(OSError):  # dropped below
            print(status, file=sys.stderr)
        status = 1
    _drop_unwritten()
    sys.exit(status)


def _run(program: str, module: str) -> int | str | None:
    """Return what sys.exit() is to be called with."""
    try:
        return int(importlib.import_module(module).main())
    except CassandraRosError as exc:
        return f"{program}: {shown_lines(str(exc))}"
    except ModuleNotFoundError as exc:
        if not is_needed(exc):
            raise
        return f"{program}: {explain_missing(exc)}"
    except KeyboardInterrupt:
        end_now(EXIT_INTERRUPTED)
    except SystemExit as exc:  # also after --help, whose text may not be written yet
        if exc.code in _SIGNALLED:
            end_now(int(exc.code or 0))
        return exc.code


def _drop_unwritten() -> None:
    """Drop what the standard streams do not take: Python would try to write it again at the end."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:  # it is None if the process was started without one
                stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def end_now(status: int) -> NoReturn:
    """End the process at once, without waiting for threads that connect to a silent store."""
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # the pipe or the stream is closed
            stream.flush()
    os._exit(status)
