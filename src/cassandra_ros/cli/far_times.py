# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Times of options, and the check whether they lie far outside of what is stored."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Iterable

from cassandra_ros.cli.parsers import error_line
from cassandra_ros.errors import InvalidKey, InvalidOption

if TYPE_CHECKING:
    from cassandra_ros.messages.stamps import Stamp
    from cassandra_ros.topics.catalog import Catalog


def read_time(option: str, text: str | None) -> Stamp | None:
    """Return the time in the text of an option; None = the option is missing.

    Args:
        option: Name of the option without --, for the error text.
        text: Its text.

    Raises:
        InvalidOption: The text is not a time.
    """
    from cassandra_ros.messages.stamps import Stamp, written_time_ns

    if text is None:
        return None
    try:
        # A Stamp: as a key, an integer of nanoseconds that looks like seconds is refused.
        return Stamp.from_ns(written_time_ns(text))
    except InvalidKey as exc:
        raise InvalidOption(f"--{option} {exc}") from exc


def check_times(options: argparse.Namespace, catalogs: Iterable[Catalog]) -> None:
    """Warn on stderr of times that lie far outside of the stored messages, if any.

    Args:
        options: The parsed options. ``time_options``, which a parser sets as a default, lists those
            that are times as for ``read_time``; without it nothing is checked.
        catalogs: The topics of the keyspaces that are read.

    Raises:
        InvalidOption: A number was meant as ms or us, as the times that are stored show, or a text
            is not a time.
    """
    from cassandra_ros.topics.overview.stored_ends import (
        far_outside,
        stored_ends,
        widest,
        wrong_unit,
    )

    texts = {name: getattr(options, name) for name in getattr(options, "time_options", ())}
    times = {name: read_time(name, text) for name, text in texts.items()}
    has_times = any(time is not None for time in times.values())
    ends = widest(map(stored_ends, catalogs)) if has_times else None
    for name, time in times.items():
        if time is None or ends is None:
            continue
        typed = f"--{name} {texts[name]}"
        reason = wrong_unit(texts[name], time.ns, ends)
        if reason:
            raise InvalidOption(f"{typed} {reason}")
        reason = far_outside(name, time.ns, ends)
        if reason and not getattr(options, "quiet", False):
            print(error_line("cassandra_bag", f"{typed} {reason}"), file=sys.stderr)
