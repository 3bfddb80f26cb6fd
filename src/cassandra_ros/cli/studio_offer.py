# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The Studio for the viewer's page Look: fetched when asked for, offered at the first start."""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

from cassandra_ros.cli.confirmation import person_reads, says_yes
from cassandra_ros.cli.parsers import error_line
from cassandra_ros.errors import DownloadFailed
from cassandra_ros.viewing.studio import STUDIO_VERSION, install_studio, studio_installed

COMMAND = "rosrun cassandra_ros viewer --install-studio"
_DECLINED = "declined"


def install(folder: Path) -> None:
    """Fetch the Studio where it is missing, and say where it is.

    Raises:
        DownloadFailed: It cannot be fetched or kept.
    """
    fetched = install_studio(folder, _say)
    print(f"Studio {STUDIO_VERSION} {'is now' if fetched else 'was already'} in {folder}")


def offer(program: str, folder: Path) -> None:
    """Ask a person once whether to fetch the Studio, where it is missing; else say how to.

    The viewer starts whatever the answer is, and whatever becomes of the download.
    """
    if studio_installed(folder):
        return
    declined = folder.parent / _DECLINED
    if person_reads() and not declined.exists():
        question = (
            "Look shows messages in Foxglove Studio, which is not here yet. Fetch it (37 MB)?"
        )
        if says_yes(question):
            try:
                install(folder)
            except DownloadFailed as exc:
                print(error_line(program, str(exc)), file=sys.stderr)
            return
        with suppress(OSError):  # who cannot keep the answer asks again
            declined.parent.mkdir(parents=True, exist_ok=True)
            declined.touch()
    print(f"Look needs the Studio, all else works without it: {COMMAND}", file=sys.stderr)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
