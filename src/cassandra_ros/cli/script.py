# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Run a program of the package; every file in scripts/ uses this module.

It reports an error, a missing Python package, Ctrl-C and a closed pipe at the output by a line of
text and an exit status, if the program does not report them itself.
"""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import signal
import sys
from typing import NoReturn

from cassandra_ros.errors import CassandraRosError
from cassandra_ros.installation import explain_missing, is_needed
from cassandra_ros.printable import shown_lines

EXIT_INTERRUPTED = 128 + signal.SIGINT
_SIGNALLED = (EXIT_INTERRUPTED, 128 + signal.SIGTERM)


def run_script(module: str) -> None:
    """Import a module, call its `main() -> int` and end the process with this exit status."""
    try:
        status = importlib.import_module(module).main()
        sys.stdout.flush()
    except CassandraRosError as exc:
        status = f"{module.rsplit('.', 1)[-1]}: {shown_lines(str(exc))}"
    except ModuleNotFoundError as exc:
        if not is_needed(exc):
            raise
        status = f"{module.rsplit('.', 1)[-1]}: {explain_missing(exc)}"
    except KeyboardInterrupt:
        end_now(EXIT_INTERRUPTED)
    except SystemExit as exc:
        if exc.code in _SIGNALLED:
            end_now(exc.code)
        raise
    except BrokenPipeError:
        # The reader of our output has ended (| head). Do not flush anything more to it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 128 + signal.SIGPIPE
    sys.exit(status)


def end_now(status: int) -> NoReturn:
    """End the process at once, without waiting for threads that connect to a silent store."""
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # the pipe or the stream is closed
            stream.flush()
    os._exit(status)
