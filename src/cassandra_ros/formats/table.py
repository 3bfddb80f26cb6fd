# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The table of formats. A new format is a file in this folder and a line here."""

from __future__ import annotations

from typing import Mapping

from cassandra_ros.errors import UnknownFormat
from cassandra_ros.formats.binary import CassandraTopic_binary
from cassandra_ros.formats.cassandra_topic_ import CassandraTopic_
from cassandra_ros.formats.json import CassandraTopic_json
from cassandra_ros.formats.packed import CassandraTopic_packed
from cassandra_ros.formats.ros import CassandraTopic_ros
from cassandra_ros.formats.string import CassandraTopic_string
from cassandra_ros.formats.yaml import CassandraTopic_yaml

FALLBACK_FORMAT = "binary"
"""Name of the format for topics whose definition is unusable: it needs no definition."""
DEFAULT_FORMAT = "ros"

FORMATS: Mapping[str, type[CassandraTopic_]] = {
    "binary": CassandraTopic_binary,
    "string": CassandraTopic_string,
    "yaml": CassandraTopic_yaml,
    "json": CassandraTopic_json,
    "ros": CassandraTopic_ros,
    "packed": CassandraTopic_packed,
}


def format_class(name: str) -> type[CassandraTopic_]:
    """Return the class of a format; UnknownFormat: no format has this name."""
    if not isinstance(name, str) or name not in FORMATS:
        raise UnknownFormat(f"there is no format {name!r:.80}; formats are: {', '.join(FORMATS)}")
    return FORMATS[name]
