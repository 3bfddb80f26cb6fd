# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Files that are made from stored messages and kept on disk while clients request them.

A file has a key that identifies its content. Requests for the same key share one file, also while
it is being written; writing ends when no request waits for the file any more. The total size is
bounded: the files whose last request is the oldest are deleted first.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Callable, Iterator

from cassandra_ros.errors import CassandraRosError, InvalidOption, StoreUnavailable
from cassandra_ros.files.bag.message_file import MessageProgress
from cassandra_ros.own_files import lock_own, own_folder

Write = Callable[[Path, MessageProgress], None]
"""Function that writes a file at a path and reports its progress: messages and bytes written."""
_PREFIX = "cassandra_ros_viewer_"
_LOCK = "lock"
_AT_ONCE = 4
"""Maximum number of files that are written at the same time; others wait."""
_LOOK_BYTES = 1 << 22
"""Size of written messages between two checks of the size of a file, bytes."""
_LOOK_SEC = 0.2
"""Interval at which a request that waits for a file checks whether its client is connected, s."""
_KEPT_SEC = 10.0
"""Minimum time that a finished file is kept after the last request for it, s."""
_ORPHAN_SEC = 60.0
"""Age above which an unlocked folder of another viewer is removed, s."""
_PATIENCE_SEC = 2.0
"""Maximum time that the end waits for files that are being written, s."""
_FILE_READ_BYTES = 1 << 18
"""Size of the chunks in which a file is read while it is written, bytes."""


class _AbandonedError(Exception):
    """No request waits for the file any more."""


class CacheEntry:
    """A file that exists or is being written.

    Attributes:
        path: Path of the file.
        key, request: Identity of content and request, see DownloadCache.lease.
    """

    def __init__(self, path: Path, key: str, request: str) -> None:
        self.path, self.key, self.request = path, key, request
        self.done = threading.Event()
        self.error: Exception | None = StoreUnavailable("the file could not be written")
        self.waiting = 0
        self.abandoned = False
        self.bytes = 0
        self.used = time.monotonic()

    @property
    def ready(self) -> bool:
        """Whether the file is complete."""
        return self.done.is_set() and self.error is None

    def measure(self) -> int:
        """Return the present size of the file, bytes."""
        for path in (_active(self.path), self.path):
            with suppress(OSError):
                self.bytes = path.stat().st_size
                break
        return self.bytes

    def wait(self, gone: threading.Event) -> Path:
        """Wait until the file is complete; return its path.

        Args:
            gone: Set when the client has disconnected.

        Raises:
            StoreUnavailable: The client has disconnected, or the store does not answer.
            CassandraRosError: The error that ended the writing.
        """
        while not self.done.wait(_LOOK_SEC):
            if gone.is_set():
                raise StoreUnavailable(f"the client does not wait for {self.path.name} any more")
        if self.error is not None:
            raise self.error
        return self.path

    def follow(self, gone: threading.Event) -> Iterator[bytes]:
        """Yield the bytes of the file while it is written from its beginning to its end.

        Arguments and errors are those of ``wait``; an error may come after the first bytes.
        """
        stream: IO[bytes] | None = None
        try:
            while not gone.is_set():
                done = self.done.is_set()  # checked first: bytes read after it are complete
                stream = stream or _open_any(self.path)
                chunk = stream.read(_FILE_READ_BYTES) if stream is not None else b""
                if chunk:
                    yield chunk
                elif done and self.error is not None:
                    raise self.error
                elif done:
                    return
                else:
                    self.done.wait(_LOOK_SEC / 4)
        finally:
            if stream is not None:
                stream.close()


class DownloadCache:
    """Keeps the files of one viewer; see above. Safe between threads.

    Args:
        folder: Where its own folder is made; None = the temporary folder.
        most_bytes: What its files take together, at most.
        most_waiting: How many may wait for files at the same time.
    """

    def __init__(self, folder: Path | None, most_bytes: int, most_waiting: int) -> None:
        base = folder or Path(tempfile.gettempdir())
        try:
            base.mkdir(parents=True, exist_ok=True)
            _remove_orphans(base)
            self._folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=base))
            self._lock = lock_own(self._folder / _LOCK)
        except OSError as exc:
            raise InvalidOption(f"no files can be kept in {base}: {exc.strerror}") from exc
        self._most_bytes = most_bytes
        self._most_waiting = most_waiting
        self._entries: dict[str, CacheEntry] = {}
        self._mutex = threading.Lock()
        self._turns = threading.Semaphore(_AT_ONCE)
        self._threads: set[threading.Thread] = set()

    def latest(self, request: str) -> CacheEntry | None:
        """Return the newest complete file of a request, even if its content is old; or None."""
        with self._mutex:
            self._forget_missing()
            entries = [e for e in self._entries.values() if e.request == request and e.ready]
            if not entries:
                return None
            entries[-1].used = time.monotonic()
            return entries[-1]

    def _forget_missing(self) -> None:
        """Forget files that a cleaner of temporary files has removed."""
        for key, entry in list(self._entries.items()):
            if entry.ready and not entry.path.exists():
                del self._entries[key]

    @contextmanager
    def lease(self, key: str, request: str, name: str, write: Write) -> Iterator[CacheEntry]:
        """Use a file, which the first request for it has written; at the end stop waiting for it.

        Args:
            key: Identity of the content: hexadecimal digits.
            request: Identity of the request, whose content may change.
            name: Name of the file, with its ending.
            write: Writes the file; called on another thread.

        Raises:
            StoreUnavailable: Too many requests wait for files.
        """
        with self._mutex:
            self._forget_missing()
            entry = self._entries.get(key)
            if entry is None or entry.abandoned:
                waiting = sum(e.waiting for e in self._entries.values() if not e.done.is_set())
                if waiting >= self._most_waiting:
                    raise StoreUnavailable(
                        f"{waiting} requests wait for files already: ask again later"
                    )
                entry = self._begin(key, request, name, write)
            entry.waiting += 1
            entry.used = time.monotonic()
        try:
            yield entry
        finally:
            with self._mutex:
                entry.waiting -= 1
                # The request may have waited long, and opens the file now.
                entry.used = time.monotonic()
                if not entry.waiting and not entry.done.is_set():
                    entry.abandoned = True

    def _begin(self, key: str, request: str, name: str, write: Write) -> CacheEntry:
        try:
            # A cleaner of temporary files may have removed it.
            own_folder(self._folder)
            folder = Path(tempfile.mkdtemp(prefix=f"{key[:16]}_", dir=self._folder))
        except OSError as exc:
            raise StoreUnavailable(
                f"no file can be kept in {self._folder}: {exc.strerror}"
            ) from exc
        entry = self._entries[key] = CacheEntry(folder / name, key, request)
        thread = threading.Thread(
            target=self._write, args=(entry, write), name=f"cache {name}", daemon=True
        )
        self._threads.add(thread)
        thread.start()
        return entry

    def _write(self, entry: CacheEntry, write: Write) -> None:
        looked = 0

        def progress(messages: int, size: int) -> None:
            nonlocal looked
            looked += size
            if entry.abandoned:
                raise _AbandonedError
            if looked >= _LOOK_BYTES:
                looked = 0
                self._make_room(entry)

        try:
            with self._turns:
                if not entry.abandoned:
                    write(entry.path, progress)
                    self._make_room(entry)
                    entry.error = None
        except _AbandonedError:
            pass
        except (CassandraRosError, OSError) as exc:
            entry.error = exc
        finally:
            with self._mutex:
                # A complete file stays although no request waits, unless another entry replaced it.
                replaced = self._entries.get(entry.key) is not entry
                entry.abandoned = replaced or entry.error is not None
                if entry.abandoned:
                    self._drop(entry)
                self._threads.discard(threading.current_thread())
                entry.done.set()

    def _make_room(self, entry: CacheEntry) -> None:
        """Remove old files until this one fits into the maximum size."""
        entry_bytes = entry.measure()
        if entry_bytes > self._most_bytes:
            raise InvalidOption(
                f"the file is larger than the {self._most_bytes} bytes that the viewer keeps on "
                "disk: ask for less time or fewer topics, or start the viewer with a larger "
                "--cache-size"
            )
        with self._mutex:
            others = [e for e in self._entries.values() if e is not entry]
            taken = entry_bytes + sum(e.bytes for e in others)
            for old in sorted(others, key=lambda e: e.used):
                if taken <= self._most_bytes:
                    return
                if old.ready and not old.waiting and time.monotonic() - old.used > _KEPT_SEC:
                    taken -= old.bytes
                    self._drop(old)
        if taken > self._most_bytes:
            raise StoreUnavailable(
                "the viewer's files use all of their space on disk: ask again later"
            )

    def _drop(self, entry: CacheEntry) -> None:
        if self._entries.get(entry.key) is entry:
            del self._entries[entry.key]
        shutil.rmtree(entry.path.parent, ignore_errors=True)

    def close(self) -> None:
        """End the writing and remove all files; a second call does nothing.

        A writer that searches for messages that satisfy a condition ends when it finds the next
        one, or when the store is closed.
        """
        with self._mutex:
            threads = list(self._threads)
            for entry in self._entries.values():
                entry.abandoned = True
        patience = time.monotonic() + _PATIENCE_SEC
        for thread in threads:
            thread.join(max(0.0, patience - time.monotonic()))
        shutil.rmtree(self._folder, ignore_errors=True)
        lock, self._lock = self._lock, -1
        if lock >= 0:
            os.close(lock)


def _active(path: Path) -> Path:
    """Return the path of a file until it is complete, see FileWriter."""
    return path.with_name(path.name + ".active")


def _open_any(path: Path) -> IO[bytes] | None:
    for candidate in (_active(path), path):
        with suppress(FileNotFoundError):
            return candidate.open("rb")
    return None


def _remove_orphans(base: Path) -> None:
    """Remove the folders of viewers that were killed: their locks are free."""
    for path in base.glob(f"{_PREFIX}*/{_LOCK}"):
        with suppress(OSError):
            state = path.lstat()
            # Not those of other users, also as root.
            if state.st_uid != os.geteuid() or time.time() - state.st_mtime < _ORPHAN_SEC:
                continue
            lock = lock_own(path)
            try:
                shutil.rmtree(path.parent, ignore_errors=True)
            finally:
                os.close(lock)
