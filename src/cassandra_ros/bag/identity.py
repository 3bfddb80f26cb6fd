# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Who wrote the rows of an imported bag: a writer id that follows from the bag's content.

A repeated import gets the same id and so overwrites its own rows; another bag, or the same bag
for another node, gets another id. Name, place, compression and chunking of the file do not count.
"""

from __future__ import annotations

import hashlib
from itertools import chain, takewhile
from struct import Struct
from typing import Callable

from cassandra_ros.bag.reader import BagReader, RawMessage
from cassandra_ros.keys import WRITER_BITS

SAMPLE = 1000
"""Messages that count at each end of the bag."""

_SUMMARY = Struct("<QQQ")
_MESSAGE = Struct("<IQQ")


def bagWriterId(
    reader: BagReader, nodeID: str = "", on_sample: Callable[[RawMessage], None] | None = None
) -> int:
    """Compute the writer id of a bag's import.

    Reads at most the chunks that hold the first and the last 1,000 messages.

    Args:
        reader: The bag.
        nodeID: The node for which it is imported.
        on_sample: Called with each message that is read for it.

    Returns:
        An int in [1, 2**31 - 1].

    Raises:
        BagError: A chunk is damaged.
    """
    digest = hashlib.sha256(b"cassandra_ros bag 1")
    _addText(digest, nodeID.encode("utf-8", "surrogateescape"))
    rank = {}
    for place, (number, connection) in enumerate(reader.connections.items()):
        rank[number] = place
        _addText(digest, connection.topic.encode("utf-8"))
        _addText(digest, connection.header)
    digest.update(_SUMMARY.pack(reader.message_count, reader.start_ns, reader.end_ns))
    first = takewhile(lambda message: message.position < SAMPLE, reader.messages())
    last = reader.messages(start=max(0, reader.message_count - SAMPLE))
    for message in chain(first, last):
        digest.update(_MESSAGE.pack(rank[message.number], message.t_ns, len(message.data)))
        digest.update(message.data)
        if on_sample is not None:
            on_sample(message)
    largest: int = 2**WRITER_BITS - 1
    return int.from_bytes(digest.digest(), "little") % largest + 1


def _addText(digest: hashlib._Hash, text: bytes) -> None:
    digest.update(len(text).to_bytes(8, "little"))
    digest.update(text)
