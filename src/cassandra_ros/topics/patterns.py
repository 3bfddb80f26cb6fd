# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Selection of topics by regular expressions, which match whole names, as in rosbag."""

from __future__ import annotations

import re
from typing import AbstractSet, Iterable

from cassandra_ros.errors import InvalidOption, TopicNotFound


def compiled(option: str, text: str) -> re.Pattern[str]:
    """Compile the regular expression of an option; raises InvalidOption if it is not valid."""
    try:
        return re.compile(text, re.DOTALL)
    except (re.error, OverflowError, RecursionError, TypeError) as exc:
        raise InvalidOption(f"{option} {text!r:.80} is not a regular expression: {exc}") from exc


def matching(
    option: str, expressions: Iterable[str], names: AbstractSet[str], where: str
) -> set[str]:
    """Return the names that one of the expressions matches in full.

    Args:
        option: Name of the option, for error texts.
        where: The place that holds the names, for error texts: 'keyspace ros'.

    Raises:
        InvalidOption: An expression is not valid.
        TopicNotFound: An expression matches no name.
    """
    names_matching: set[str] = set()
    for text in expressions:
        pattern = compiled(option, text)
        matches = {name for name in names if pattern.fullmatch(name)}
        if not matches:
            raise TopicNotFound(
                f"no topic in {where} matches {text!r:.80}: an expression must match the whole "
                f"name, as '/camera/.*'; it has {len(names)} topics"
            )
        names_matching |= matches
    return names_matching
