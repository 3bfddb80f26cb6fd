# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which reader a file needs, by its first bytes, and which writer, by its name."""

from __future__ import annotations

import itertools
import os

from cassandra_ros.bag import mcap_format
from cassandra_ros.bag.bag_reader import BagReader
from cassandra_ros.bag.bag_writer import BagWriter
from cassandra_ros.bag.file_writer import FileWriter
from cassandra_ros.bag.mcap_reader import McapReader
from cassandra_ros.bag.mcap_writer import McapWriter
from cassandra_ros.bag.message_file import MessageFile
from cassandra_ros.bag.rosbag2 import METADATA, SQLITE_MAGIC, refusal
from cassandra_ros.errors import BagError

MCAP_ENDING = ".mcap"
_ENDINGS = (".bag", MCAP_ENDING)
_UNFINISHED = ".active"


def files_of(path: str, recursive: bool = False, unfinished: bool = False) -> list[str]:
    """List the bags and MCAP files of a folder, sorted; of anything else return the path itself.

    Args:
        recursive: Look into its subfolders, too; links to folders are not followed.
        unfinished: Also those that a recorder has not closed, called *.active.

    Raises:
        BagError: The folder holds no bag or MCAP file.
    """
    if not os.path.isdir(path) or os.path.exists(os.path.join(path, METADATA)):
        return [path]
    endings = tuple(
        ending + more for ending in _ENDINGS for more in ("", _UNFINISHED)[: 1 + unfinished]
    )
    found = [
        os.path.join(folder, name)
        for folder, _, names in itertools.islice(os.walk(path), None if recursive else 1)
        for name in names
        if name.lower().endswith(endings)
    ]
    if not found:
        hint = "" if recursive else "; --recursive looks into its subfolders"
        raise BagError(f"folder {path} holds no bag or MCAP file ({', '.join(endings)}){hint}")
    return sorted(found)


def open_file(
    path: str | os.PathLike[str], salvage: bool = False, large_chunks: bool = False
) -> MessageFile:
    """Open a bag or an MCAP for reading, whatever its name.

    Args:
        salvage: Read a damaged file up to the damage.
        large_chunks: Read also chunks of more than 256 MiB of content, and files that unpack to
            more than 1000 times their size. Only for files that you trust: one that was made for
            it can fill the memory and the disk.

    Raises:
        BagError: It is none of both, as what rosbag2 records, or cannot be read; see BagReader
            and McapReader.
    """
    name = os.fspath(path)
    if os.path.exists(os.path.join(name, METADATA)):
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
    """Begin to write an MCAP where the name ends with .mcap, else a bag.

    Args:
        compression: 'none', 'lz4', of a bag also 'bz2' and of an MCAP also 'zstd'; None = as
            rosbag and mcap do: 'none' in a bag, 'zstd' in an MCAP.

    Raises:
        BagError: The file cannot be made, or there is no such compression for it.
    """
    if os.fspath(path).lower().endswith(MCAP_ENDING):
        return McapWriter(path, compression or "zstd")
    return BagWriter(path, compression or "none")
