# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Options that several programs have."""

from __future__ import annotations

from cassandra_ros.arguments import check_pattern
from cassandra_ros.metadata import DEFAULT_FORMAT, FORMAT_NAMES
from cassandra_ros.option import Option
from cassandra_ros.quantities import byte_size


def _text_or_none(text: str) -> str | None:
    return text or None


EXCLUDE = Option(
    ("-x", "--exclude"),
    "leave out topics whose whole name matches this regular expression; may be repeated (default: "
    "leave out none)",
    metavar="EXCLUDE_REGEX",
    read=check_pattern,
)


def _format_option(of_new_topics: str) -> Option:
    """Return the option of the storage format; ``of_new_topics``: the default for new topics.

    Its value is None if it is missing or empty: launch files pass empty ones.
    """
    return Option(
        ("--format",),
        f"storage format: {', '.join(FORMAT_NAMES)} (default: the format that a topic has, for new "
        f"topics {of_new_topics}). A topic that is stored in another format gets a second table; "
        "'cassandra_bag convert' changes the format of what is stored",
        metavar="F",
        read=_text_or_none,
    )


FORMAT = _format_option(DEFAULT_FORMAT)
IMPORT_FORMAT = _format_option(f"packed or {DEFAULT_FORMAT}, as above")
MAX_SIZE = Option(
    ("--max-size",),
    "keep the topics of the store under this size, as 20G: what another store has is deleted, "
    "oldest first; above 80 % of what no other store has, /diagnostics warns (default: no maximum)",
    metavar="SIZE",
    read=byte_size,
    rare=True,
)
DROP_UNCOPIED = Option(
    ("--drop-uncopied",),
    "with --max-size: also delete what no other store has, as a loss, if there is no other way",
    rare=True,
)
