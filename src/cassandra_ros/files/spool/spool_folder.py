# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The folder of the spool: one folder for each run, with a lock and numbered files.

Several recorders may use one folder. Each run has its own folder in it, whose lock (flock) its
process holds: the system lets it go when the process ends, however it ends. A folder without a
living process is what an earlier one has left, and belongs to the first that locks it.

A file whose messages are stored is deleted. The folder notes that it was, so that a file which is
missing for another reason is told.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Iterator

from cassandra_ros.errors import SpoolError
from cassandra_ros.files.spool.spool_label import RunTotals, Totals
from cassandra_ros.installation import home_folder
from cassandra_ros.own_files import lock_own, own_folder
from cassandra_ros.store.tables.checksum import crc32

_log = logging.getLogger(__name__)

DEFAULT_BYTES = 2 << 30
"""Default maximum size of all files in the folder, bytes."""
_LOCK, _SETTLED = "lock", "settled"
"""Names of the file that is locked, and of the file with the notes of ``note_settled``: a line for
each, with a checksum and JSON."""
_SUFFIX = ".mcap"


def default_folder() -> Path:
    """Return the folder of the spool in the ROS home."""
    return home_folder() / "spool"


class RunFolder:
    """The files of one run, locked by this process until ``release`` or ``remove``.

    Args:
        path: The folder.
        lock: File descriptor of the lock. This object closes it, which ends the lock.
    """

    def __init__(self, path: Path, lock: int) -> None:
        self.path = path
        self._lock = lock
        self._next = 1 + max((int(file.stem) for file in self.files()), default=0)
        """Number of the next file."""
        self._unnoted: list[str] = []
        """Notes of ``note_settled`` that could not be written yet, because the disk was full."""

    def files(self) -> list[Path]:
        """Return the files with messages, in the order in which they were written."""
        return run_files(self.path)

    def is_empty(self) -> bool:
        """Return whether it has no file with messages; False if that is not known.

        The caller deletes an empty folder, so ``files``, which gives [] for a folder that cannot be
        read, is not asked.
        """
        try:
            return not any(path.suffix == _SUFFIX for path in self.path.iterdir())
        except OSError:
            return False

    def new_file(self) -> Path:
        """Return the path of the next file, another one at each call. The caller makes the file."""
        self._next += 1
        return self.file(self._next - 1)

    def file(self, number: int) -> Path:
        """Return the path of the file with a number."""
        return self.path / f"{number:06d}{_SUFFIX}"

    def delete_file(self, path: Path, totals: Totals) -> None:
        """Delete a file of which each message is stored, or told as lost, and note that it was.

        A file that cannot be deleted stays, with a warning.

        Args:
            totals: The messages of the run up to the end of this file.
        """
        self.note_settled(path, totals)
        try:
            path.unlink(missing_ok=True)
        except OSError as exc:
            _log.warning("%s stays, all its messages are stored: delete it (%s)", path, exc)
        if self._unnoted:  # the disk was full: now it has room
            self._write_notes()

    def note_settled(self, path: Path, totals: Totals) -> None:
        """Note that the messages of a file are accounted for, whether it is deleted or stays.

        Of a file that stays a reader stores the messages that are in it, and takes none as missing.
        If the disk is full, the note is written with the next one.

        Args:
            totals: The messages of the run up to the end of this file.
        """
        text = json.dumps({"file": int(path.stem), **asdict(RunTotals.of(totals))})
        # Each line begins anew: a full disk may have taken a part of the last one.
        self._unnoted.append(f"\n{crc32(text.encode()):08x} {text}\n")
        self._write_notes()

    def _write_notes(self) -> None:
        """Append the waiting notes to the file; they go on waiting if the disk is full."""
        with suppress(OSError), open(self.path / _SETTLED, "a", opener=open_private) as file:
            file.write("".join(self._unnoted))
            file.flush()
            # The file is deleted next: after a power cut it would seem to be missing.
            os.fsync(file.fileno())
            self._unnoted.clear()

    def settled(self) -> dict[int, Totals]:
        """Return the totals of each ``note_settled``, by the number of the file.

        Raises:
            SpoolError: The notes cannot be read. A damaged line is left out.
        """
        path = self.path / _SETTLED
        try:
            lines = path.read_bytes().splitlines()
        except FileNotFoundError:
            return {}
        except OSError as exc:
            raise SpoolError(
                f"{path}: {exc.strerror}; it says which files are stored: make it readable"
            ) from exc
        settled: dict[int, Totals] = {}
        for line in lines:
            crc, _, text = line.partition(b" ")
            if crc == f"{crc32(text):08x}".encode():
                values = json.loads(text)
                settled[values["file"]] = RunTotals(values["topics"]).totals()
        return settled

    def release(self) -> None:
        """Release the lock on the folder. A second call does nothing."""
        lock, self._lock = self._lock, -1
        if lock >= 0:
            os.close(lock)

    def remove(self) -> None:
        """Delete the folder with all files, and release the lock.

        Raises:
            SpoolError: Some of it cannot be deleted.
        """
        shutil.rmtree(self.path, ignore_errors=True)
        # Before the release: after it another process may make a folder of this name.
        is_left = self.path.exists()
        self.release()
        if is_left:
            raise SpoolError(f"{self.path} cannot be deleted; delete it by hand")


class SpoolFolder:
    """The folder of all recorders of a user on this machine.

    Args:
        path: The folder; it is made when it is first needed. None = that of the ROS home.
        max_bytes: Maximum size of all files in it, bytes.
    """

    def __init__(self, path: Path | None = None, max_bytes: int = DEFAULT_BYTES) -> None:
        self.path = path or default_folder()
        self.max_bytes = max_bytes

    def begin(self, writer: int) -> RunFolder:
        """Make and lock the folder of a run.

        Args:
            writer: Writer id of the run: the name of the folder.

        Raises:
            SpoolError: The folder cannot be made.
        """
        hidden, path = self.path / f".{writer}", self.path / str(writer)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            own_folder(self.path)
            hidden.mkdir(mode=0o700)
            lock = _lock_folder(hidden)
            # It gets its name when it is locked: before, ``left`` of another process would take it.
            hidden.rename(path)
        except OSError as exc:
            raise SpoolError(f"the spool {self.path} cannot be used: {exc}") from exc
        if lock is None:
            raise SpoolError(
                f"the spool {self.path} cannot be locked: another process has its lock"
            )
        return RunFolder(path, lock)

    def left(self) -> Iterator[RunFolder]:
        """Yield the folders of runs whose process has ended, locked; oldest first.

        The caller releases or removes each.
        """
        for path in self.runs():
            lock = None
            with suppress(OSError):
                lock = _lock_folder(path)
            if lock is not None:
                yield RunFolder(path, lock)

    def runs(self) -> list[Path]:
        """Return the folders of all runs, also of those that are recorded now; oldest first.

        One that another process deletes meanwhile is left out.
        """
        by_age: list[tuple[float, Path]] = []
        with suppress(OSError):
            for folder in self.path.iterdir():
                with suppress(OSError):
                    if folder.name.isdigit():
                        by_age.append((folder.stat().st_ctime, folder))
        return [folder for _, folder in sorted(by_age)]

    def nbytes(self) -> int:
        """Return the size of all files in it, bytes."""
        return sum(run_bytes(path) for path in self.runs())


def run_bytes(path: Path) -> int:
    """Return the size of the files of a run, bytes."""
    total = 0
    for file in run_files(path):
        with suppress(OSError):
            total += file.stat().st_size
    return total


def run_files(path: Path) -> list[Path]:
    """Return the files of a run with messages, in the order in which they were written."""
    try:
        files = [e for e in path.iterdir() if e.suffix == _SUFFIX and e.stem.isdigit()]
    except OSError:
        return []
    return sorted(files, key=lambda file: int(file.stem))


def _lock_folder(path: Path) -> int | None:
    """Lock a folder; return the file descriptor of the lock.

    Return None if another process holds it, or has deleted the folder meanwhile.

    Raises:
        OSError: The file of the lock cannot be made or locked.
    """
    try:
        descriptor = lock_own(path / _LOCK)
    except BlockingIOError:
        return None
    with suppress(OSError):
        # The file that we locked may have been deleted before: then the lock says nothing.
        if (path / _LOCK).stat().st_ino == os.fstat(descriptor).st_ino:
            return descriptor
    os.close(descriptor)
    return None


def open_private(path: str, flags: int) -> int:
    """Open a file, as an ``opener`` of open; a new one is for its owner alone (mode 600)."""
    return os.open(path, flags, 0o600)
