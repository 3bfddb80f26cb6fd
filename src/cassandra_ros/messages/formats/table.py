# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The table of formats. A new format is a file in this folder and its name in metadata.py.

The file FORMAT.py has the class CassandraTopic_FORMAT. It is imported when the format is used: a
program that only shows the names, as its help does, needs no numpy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from cassandra_ros.errors import UnknownFormat
from cassandra_ros.metadata import FORMAT_NAMES

if TYPE_CHECKING:
    from cassandra_ros.messages.formats.cassandra_topic_ import CassandraTopic_

FALLBACK_FORMAT = "binary"
"""Name of the format for topics whose definition is unusable: it needs no definition."""


def format_class(name: str) -> type[CassandraTopic_]:
    """Return the class of a format; UnknownFormat: no format has this name."""
    if not isinstance(name, str) or name not in FORMAT_NAMES:
        formats = ", ".join(FORMAT_NAMES)
        raise UnknownFormat(f"there is no format {name!r:.80}; formats are: {formats}")
    cls: type[CassandraTopic_] = getattr(
        import_module(f"cassandra_ros.messages.formats.{name}"), f"CassandraTopic_{name}"
    )
    return cls
