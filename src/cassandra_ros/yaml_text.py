# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""YAML texts with rules or settings, which a user has written."""

from __future__ import annotations

import difflib
from contextlib import contextmanager
from typing import Collection, Iterable, Iterator

import yaml

from cassandra_ros.errors import CassandraRosError, InvalidOption

MAX_CONFIG_BYTES = 1 << 20
"""Maximum length of a file of rules or settings, characters."""


@contextmanager
def yaml_content(text: str, source: str) -> Iterator[object]:
    """Give the content of a YAML text; an error of its use within the context names ``source``.

    Raises:
        InvalidOption: The text cannot be read, or its content cannot be used.
    """
    try:
        if len(text) > MAX_CONFIG_BYTES:
            raise InvalidOption(f"it is longer than {MAX_CONFIG_BYTES} characters")
        yield yaml.safe_load(text)
    except (yaml.YAMLError, CassandraRosError, RecursionError) as exc:
        raise InvalidOption(f"{source} cannot be used: {exc}") from exc


def check_keys(number: int, entry: Iterable[object], keys: Collection[str]) -> None:
    """Raise InvalidOption if the entry with this number has a key that is not one of ``keys``."""
    for name in entry:
        if name not in keys:
            near = difflib.get_close_matches(str(name), keys, n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(keys)}"
            raise InvalidOption(f"entry {number} has an unknown key {name!r:.80}; {hint}")
