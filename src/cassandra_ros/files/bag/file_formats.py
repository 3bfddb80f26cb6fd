# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Open a bag or an MCAP: the reader follows from the first bytes, the writer from the file name."""

from __future__ import annotations

import itertools
import logging
import os
from typing import Callable, Sequence

from cassandra_ros.errors import BagError
from cassandra_ros.files.bag import mcap_format
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.file_writer import FileWriter
from cassandra_ros.files.bag.identity import read_content
from cassandra_ros.files.bag.mcap_reader import ROSBAG2_METADATA, SQLITE_MAGIC, McapReader, refusal
from cassandra_ros.files.bag.mcap_writer import McapWriter
from cassandra_ros.files.bag.message_file import MessageFile
from cassandra_ros.store.tables.registry import Run

_log = logging.getLogger(__name__)
MCAP_ENDING = ".mcap"
_ENDINGS = (".bag", MCAP_ENDING)
_UNFINISHED = ".active"
"""What recorders, and FileWriter, append to the name of a file until it is closed."""


def files_of(
    path: str,
    recursive: bool = False,
    unfinished: bool = False,
    unreadable: Callable[[OSError], None] | None = None,
) -> list[str]:
    """Return the bags and MCAP files of a folder, sorted. For any other path, return the path.

    Args:
        recursive: Also list the files of subfolders; links to folders are not followed.
        unfinished: Also list files named *.active, which a recorder has not closed.
        unreadable: Called for each folder that cannot be listed; None = BagError. If it is given,
            [] may be returned.

    Raises:
        BagError: The folder holds no bag or MCAP file, or a folder cannot be listed.
    """
    if not os.path.isdir(path) or os.path.exists(os.path.join(path, ROSBAG2_METADATA)):
        return [path]
    suffixes = ("", _UNFINISHED) if unfinished else ("",)
    endings = tuple(ending + suffix for ending in _ENDINGS for suffix in suffixes)
    problems: list[OSError] = []
    folders = os.walk(path, onerror=problems.append)
    files = [
        os.path.join(folder, name)
        for folder, _, names in itertools.islice(folders, None if recursive else 1)
        for name in names
        if name.lower().endswith(endings)
    ]
    for exc in problems:
        if unreadable is None:
            raise BagError(f"folder {exc.filename} cannot be read: {exc.strerror}") from exc
        unreadable(exc)
    if not (files or problems):
        hint = "" if recursive else "; --recursive looks into its subfolders"
        raise BagError(f"folder {path} holds no bag or MCAP file ({', '.join(endings)}){hint}")
    return sorted(files)


def open_file(
    path: str | os.PathLike[str], salvage: bool = False, large_chunks: bool = False
) -> MessageFile:
    """Open a bag or an MCAP for reading. The name of the file does not matter.

    Args:
        salvage: Read the messages before the damage of a damaged file, and the chunks after it.
        large_chunks: Also read chunks of more than 256 MiB of content, and files that unpack to
            more than 1000 times their size. Only for files that you trust: a file that was made
            to do harm can fill the memory and the disk.

    Raises:
        BagError: The file is neither a bag nor an MCAP (for example a recording of rosbag2), or it
            cannot be read; see BagReader and McapReader.
    """
    name = os.fspath(path)
    if os.path.exists(os.path.join(name, ROSBAG2_METADATA)):
        raise refusal(name)
    try:
        with open(name, "rb") as file:
            magic = file.read(len(SQLITE_MAGIC))
    except OSError as exc:
        raise BagError(f"{name} cannot be read: {exc.strerror}") from exc
    if magic == SQLITE_MAGIC:
        raise refusal(name)
    if magic.startswith(mcap_format.MAGIC):
        return McapReader(name, salvage, large_chunks)
    return BagReader(name, salvage, large_chunks)


def make_file(path: str | os.PathLike[str], compression: str | None = None) -> FileWriter:
    """Create an MCAP if the name ends with .mcap, else a bag.

    Args:
        compression: 'none' or 'lz4', for a bag also 'bz2', for an MCAP also 'zstd'. None = the
            default of rosbag and mcap: 'none' for a bag, 'zstd' for an MCAP.

    Raises:
        BagError: The file cannot be created, or the format does not have this compression.
    """
    if os.fspath(path).lower().endswith(MCAP_ENDING):
        return McapWriter(path, compression or "zstd")
    return BagWriter(path, compression or "none")


def runs_of_content(runs: Sequence[Run], path: str) -> list[Run]:
    """Return the imports of a file by its content, under whatever name; [] = it was not imported.

    The file is read to its end. One that is not a bag, or damaged, is the content of no run.

    Args:
        runs: The runs among which the imports are searched.
        path: The file; for a path that is not a file there is no run.
    """
    if not any(run.kind == "import" for run in runs) or not os.path.isfile(path):
        return []
    _log.info("%s: no run has this path; it is read to find a run of its content", path)
    try:
        with open_file(path) as reader:
            content = read_content(reader)
    except BagError:
        return []
    return [run for run in runs if content.is_of(run)]
