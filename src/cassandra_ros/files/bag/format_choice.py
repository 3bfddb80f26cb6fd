# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The format in which an import stores a new topic, if the user names none: ``packed`` or ``ros``.

It follows from the file alone. doc/formats.md has the measurements behind the constants.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from cassandra_ros.files.bag.size_estimate import TopicSample, format_size
from cassandra_ros.messages.formats.table import FALLBACK_FORMAT
from cassandra_ros.metadata import DEFAULT_FORMAT
from cassandra_ros.store.blocks.block_builder import ALONE_BYTES

CHOICE_MESSAGES = 1000
"""Maximum number of messages of a topic that are compressed for the choice: nearly a full block."""
MIN_MESSAGES = 100
"""Minimum number of messages of a packed topic. Fewer take less disk than the table's own files."""
MIN_HZ = 9.0
"""Minimum rate of a packed topic, messages/s: 10 Hz, of which some may be missing. A recorder that
goes on with the topic fills a block for half a second: with fewer messages it would take up to
three times the disk of ``ros``."""
MIN_SAVED = 0.25
"""Minimum share of the disk of ``ros`` that ``packed`` saves. For less it is not worth to give up
columns that other programs can read, indexes, and the faster lookup of single messages."""
STORED_BEFORE = "stored before"
UNUSABLE = "unusable definition"


class FormatChoice(NamedTuple):
    """A storage format, and the reason for it in a few words; '' = the user named it."""

    format: str
    why: str = ""


def choose_format(sample: TopicSample) -> FormatChoice:
    """Choose the format of a topic by its first messages and its mean rate in a file.

    It is ``packed`` from 100 messages on, at 9 messages a second or more, of at most 64 KiB each,
    if this saves a quarter of the disk that ``ros`` takes.
    """
    if sample.definition is None:
        return FormatChoice(FALLBACK_FORMAT, UNUSABLE)
    few = too_few(sample)
    if few:
        return FormatChoice(DEFAULT_FORMAT, few)
    wires = sample.wires[:CHOICE_MESSAGES]
    sample = replace(sample, wires=wires, nbytes=sum(len(wire) for _, wire in wires), mean_bytes=0)
    if sample.message_bytes > ALONE_BYTES:
        return FormatChoice(DEFAULT_FORMAT, f"messages over {ALONE_BYTES >> 10} KiB")
    rows, blocks = (format_size(sample, name, math.inf) for name in (DEFAULT_FORMAT, "packed"))
    saved = 1 - blocks.disk / rows.disk if rows and blocks else 0.0
    what = f"{sample.rate_hz:.0f}/s of {sample.message_bytes:.0f} B"
    if saved < MIN_SAVED:
        return FormatChoice(DEFAULT_FORMAT, f"{what}: packed saves {max(saved, 0):.0%}")
    return FormatChoice("packed", f"{what}: saves {saved:.0%}")


def too_few(sample: TopicSample) -> str:
    """Return the reason for which a topic has too few messages to be packed; '' = it has enough."""
    if sample.count < MIN_MESSAGES:
        return "few messages"
    rate_hz = sample.rate_hz or 0.0
    return "" if rate_hz >= MIN_HZ else f"low rate: {rate_hz:.3g}/s"
