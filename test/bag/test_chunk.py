# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages of a chunk, found all at once where the index tells the truth: as one by one."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.errors import BagError
from cassandra_ros.files.bag import format as bagformat
from cassandra_ros.files.bag.bag_reader import BagReader
from cassandra_ros.keys import SECOND_NS


def by_rosbag(number, t_ns, size):
    """Build what the C++ writer puts before the bytes of a message."""
    secs, nsecs = divmod(t_ns, SECOND_NS)
    fields = [(b"conn", number), (b"op", 2), (b"time", nsecs << 32 | secs)]
    header = bagformat.pack_fields(fields)
    return b"".join((bagformat.U32.pack(len(header)), header, bagformat.U32.pack(size)))


def other(number, t_ns, size):
    """Build the same in an order that no writer we know of has."""
    secs, nsecs = divmod(t_ns, SECOND_NS)
    fields = [(b"time", nsecs << 32 | secs), (b"op", 2), (b"conn", number)]
    header = bagformat.pack_fields(fields)
    return b"".join((bagformat.U32.pack(len(header)), header, bagformat.U32.pack(size)))


CONNECTION = bagformat.pack_record([(b"op", 7), (b"conn", 1), (b"topic", b"/a")], b"\1\0\0\0a=b")
messages = st.tuples(
    st.integers(0, 2**32 - 1), st.integers(0, 2**33 * SECOND_NS), st.binary(max_size=9)
)
changes = st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=2)


def result(content, offsets=None):
    try:
        return [column.tolist() for column in bagformat.find_messages(content, "here", offsets)]
    except BagError as exc:
        return str(exc)


@given(
    every=st.lists(messages, min_size=16, max_size=40),
    connections=st.sets(st.integers(0, 40)),
    head=st.sampled_from([bagformat.message_head, by_rosbag, other]),
    odd=st.integers(-100, 40),
    changed=changes,
    moved=st.one_of(st.just(()), st.tuples(st.integers(0, 15), st.integers(-80, 80))),
)
def test_what_the_index_says_changes_nothing(every, connections, head, odd, changed, moved):
    parts, offsets, at = [], [], 0
    for n, (number, t_ns, data) in enumerate(every):
        part = CONNECTION if n in connections else b""
        offsets.append(at + len(part))
        part += (other if n == odd else head)(number, min(t_ns, 2**32 * SECOND_NS - 1), len(data))
        parts.append(part + data)
        at += len(parts[-1])
    content = bytearray(b"".join(parts) + (CONNECTION if 40 in connections else b""))
    for place, value in changed:
        content[place % len(content)] = value
    if moved:
        offsets[moved[0]] += moved[1]
    offsets = np.sort(np.array(offsets, np.int64))
    assert result(bytes(content), offsets) == result(bytes(content))


def test_it_is_the_quick_way_that_reads_bags(bags, monkeypatch):
    taken, quick = [], bagformat._messages_at

    def counted(*args):
        taken.append(quick(*args))
        return taken[-1]

    monkeypatch.setattr(bagformat, "_messages_at", counted)
    for name in ("husky_gps_data", "turtlesim_tf"):
        with BagReader(bags / f"{name}.bag") as reader:
            assert sum(1 for _ in reader.messages()) == reader.message_count
    assert taken and all(found is not None for found in taken)
