# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where a result goes: to standard output, or to a file that is there only when it is complete."""

from __future__ import annotations

import io
import os
import sys
from contextlib import contextmanager
from typing import Any, Iterator

from cassandra_ros.errors import InvalidOption


@contextmanager
def open_output(path: str | None, force: bool, binary: bool = False) -> Iterator[Any]:
    """Open what a result is written to, as UTF-8.

    Args:
        path: A file, called PATH.active until all is written; None = standard output. What is no
            regular file (/dev/stdout, a pipe) is written to at once.
        force: Replace a file that exists.
        binary: Open it for bytes.

    Raises:
        InvalidOption: The file exists, or cannot be made.
    """
    if path is None:
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(encoding="utf-8")
        yield sys.stdout
        return
    special = os.path.exists(path) and not os.path.isfile(path)
    if os.path.exists(path) and not special and not force:
        raise InvalidOption(f"{path} exists; choose another name, or replace it with --force")
    active = path if special else f"{path}.active"
    try:
        stream: Any = (
            open(active, "wb") if binary else open(active, "w", encoding="utf-8", newline="")
        )
    except OSError as exc:
        raise InvalidOption(f"{path} cannot be written: {exc.strerror}") from exc
    try:
        with stream:
            yield stream
        if not special:
            os.replace(active, path)
    except BaseException:
        if not special:
            os.unlink(active)
        raise
