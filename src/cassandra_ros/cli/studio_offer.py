# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Download Foxglove Studio for the viewer's page Look, and offer to do so at the first start."""

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
"""Name of the empty file that marks that the user does not want the Studio."""


def install(folder: Path) -> None:
    """Download the Studio if it is missing, and print its folder.

    Raises:
        DownloadFailed: It cannot be downloaded or stored.
    """
    fetched = install_studio(folder, _say)
    print(f"Studio {STUDIO_VERSION} {'is now' if fetched else 'was already'} in {folder}")


def offer(program: str, folder: Path) -> None:
    """If the Studio is missing, ask the user once whether to download it, or print how to do so.

    The caller starts the viewer in any case; a failed download is only reported.
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
        with suppress(OSError):  # if the answer cannot be stored, the next start asks again
            declined.parent.mkdir(parents=True, exist_ok=True)
            declined.touch()
    print(f"Look needs the Studio, all else works without it: {COMMAND}", file=sys.stderr)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
