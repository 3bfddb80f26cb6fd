# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Let Java find its file system in a chroot.

Cassandra asks for the free space of its directories. Java looks their mount point up in
/proc/mounts, and a chroot whose root is an ordinary folder (a build root, say) is not listed there:
"Mount point not found". Root can cure it for one process: in a mount namespace of its own the root
becomes a mount.
"""

from __future__ import annotations

import os
from pathlib import Path

# $0 is a mount point that is covered, privately: nothing that is mounted here reaches others.
_COVER = 'mount --make-private "$0" && mount --rbind / "$0" && exec chroot "$0" "$@"'


def with_visible_root(command: list[str], directory: Path) -> list[str]:
    """Return the command, or one that first makes the directory's mount point visible.

    Args:
        command: A program and its arguments.
        directory: Absolute path of an existing folder on whose file system it works.
    """
    mounts = mount_points()
    if mount_point_of(directory) in mounts or os.geteuid() != 0:
        return command
    covers = [mount for mount in mounts if os.path.isdir(mount)]
    if not covers:
        return command
    unshare = ["unshare", "--mount", "--propagation", "unchanged"]
    return [*unshare, "sh", "-c", _COVER, covers[0], *command]


def mount_points() -> list[str]:
    """Return the mount points that this process can see."""
    try:
        lines = Path("/proc/mounts").read_text(encoding="utf-8", errors="surrogateescape")
    except OSError:
        return []
    # A blank in a name stands there as \040.
    return [line.split(" ")[1].replace("\\040", " ") for line in lines.splitlines()]


def mount_point_of(directory: Path) -> str:
    """Return where the file system of a folder begins, as Java finds it: by device numbers."""
    device = directory.stat().st_dev
    while directory != directory.parent and directory.parent.stat().st_dev == device:
        directory = directory.parent
    return str(directory)
