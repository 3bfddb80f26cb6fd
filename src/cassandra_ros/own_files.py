# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Files and folders at places where another user of the machine may have made one of that name.

Opening never waits (for the writer of a FIFO) and never follows a symbolic link at the last name.
Root may lock the files of everybody: it could become each of them.
"""

from __future__ import annotations

import errno
import fcntl
import os
import pwd
import stat
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Iterator

_NO_FILE = (errno.ELOOP, errno.ENXIO)
"""Errors of opening a symbolic link, and a FIFO or a socket."""


def open_regular(path: Path, flags: int = os.O_RDONLY) -> int:
    """Open an ordinary file, of any user; return its descriptor. Close it.

    Args:
        path: The file.
        flags: Flags of os.open. A file that is created is for its owner alone (mode 600).

    Raises:
        OSError: It cannot be opened, or is a symbolic link, a FIFO, a socket or a device.
    """
    try:
        descriptor = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o600)
    except OSError as exc:
        if exc.errno in _NO_FILE:
            raise _refusal(path, "it is not an ordinary file") from exc
        raise
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise _refusal(path, "it is not an ordinary file")
    return descriptor


def open_own(path: Path, flags: int) -> int:
    """Open an ordinary file of our own, and make it one for its owner alone (mode 600).

    Arguments and result are those of open_regular.

    Raises:
        OSError: As for open_regular, or the file belongs to another user or has a second name.
    """
    descriptor = open_regular(path, flags)
    state = os.fstat(descriptor)
    try:
        _check_owner(path, state)
        if state.st_nlink > 1:  # a hard link to a file that has another purpose
            raise _refusal(path, "it has a second name")
        if state.st_mode & 0o077:
            with suppress(PermissionError):  # FAT has no modes
                os.fchmod(descriptor, 0o600)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def lock_own(path: Path) -> int:
    """Lock a file of our own, which is made if it is missing; return its descriptor.

    The lock ends when the descriptor is closed, or the process ends.

    Raises:
        BlockingIOError: Another process holds the lock.
        OSError: As for open_own, or the disk has no locks.
    """
    descriptor = open_own(path, os.O_RDWR | os.O_CREAT)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def lock_holder(path: Path) -> int:
    """Return the pid of the process that holds the lock of a file; 0 = it is not known."""
    try:
        state = os.stat(path)
        lines = Path("/proc/locks").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    place = f"{os.major(state.st_dev):02x}:{os.minor(state.st_dev):02x}:{state.st_ino}"
    for words in map(str.split, lines):
        # "1: FLOCK ADVISORY WRITE 1234 fe:01:5678 0 EOF"; "1: -> FLOCK …" waits for it.
        if words[1] == "FLOCK" and words[5] == place:
            return max(0, int(words[4]))
    return 0


def own_folder(path: Path) -> None:
    """Make a folder that only its owner can use (mode 700), or check and mend one that is there.

    Raises:
        OSError: It cannot be made, is not a folder, or it or a link to it belongs to another user
            (also for root).
    """
    with suppress(FileExistsError):
        path.mkdir(mode=0o700)
    state = path.lstat()
    if stat.S_ISLNK(state.st_mode) and state.st_uid == os.geteuid():
        state = path.stat()  # our own link, to a larger disk
    if not stat.S_ISDIR(state.st_mode):
        raise _refusal(path, "it is not a folder")
    _check_owner(path, state, root_may=False)
    if state.st_mode & 0o077:
        path.chmod(0o700)


@contextmanager
def whole_file(
    path: Path, draft: Path | None = None, *, private: bool = False, sync: bool = True
) -> Iterator[BinaryIO]:
    """Write a file that gets its name only when it is complete.

    An error, also one in the block, leaves what has the name as it was, and deletes the draft.

    Args:
        path: The file.
        draft: Its name until it is complete, in the same folder; None = PATH.active. What has this
            name is deleted first.
        private: Whether only its owner can read it at any moment; else as the umask says.
        sync: Whether it survives a power cut once it has its name.

    Raises:
        OSError: It cannot be written, or what has the draft's name cannot be deleted, as a file of
            another user in /tmp.
    """
    draft = path.with_name(f"{path.name}.active") if draft is None else draft
    draft.unlink(missing_ok=True)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
    number = os.open(draft, flags, 0o600 if private else 0o666)
    try:  # from here on the draft is ours to delete
        with open(number, "wb") as file:
            yield file
            if sync:
                file.flush()
                os.fsync(file.fileno())
        os.replace(draft, path)
    except BaseException:
        with suppress(OSError):
            draft.unlink()
        raise


def _check_owner(path: Path, state: os.stat_result, *, root_may: bool = True) -> None:
    """Raise OSError if a file is not ours; with ``root_may`` every file counts as root's."""
    user = os.geteuid()
    if user != state.st_uid and not (root_may and user == 0):
        try:
            name = pwd.getpwuid(state.st_uid).pw_name
        except KeyError:
            name = str(state.st_uid)
        raise _refusal(path, f"it belongs to the user {name}")


def _refusal(path: Path, reason: str) -> OSError:
    # Not EACCES: that is a file of which the system does not tell us more.
    return OSError(errno.EINVAL, reason, str(path))
