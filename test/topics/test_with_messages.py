# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages are made of many rows at once, in order, and what is wrong is told at its turn."""

from __future__ import annotations

from itertools import islice

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from std_msgs.msg import Header, String

from cassandra_ros.errors import ConnectionFailed, CorruptMessage, StoreUnavailable
from cassandra_ros.messages.classes import deserialize, serialize
from cassandra_ros.topics.stored_row import MADE_SINGLY_BYTES, MAX_ROWS, with_messages

CLASSES = (Header, String)
DAMAGED, CUT = "damaged", "cut"


class Row:
    """What with_messages knows of a row."""

    chunked = False

    def __init__(self, number, kind):
        self.kind = kind
        self.cls = CLASSES[kind == "other"]
        text = f"{number}" + "x" * (MADE_SINGLY_BYTES if kind == "large" else 0)
        self.sent = Header(seq=number, frame_id=text) if self.cls is Header else String(text)
        wire = serialize(self.sent)
        self._wire = wire[:-1] if kind == CUT else wire
        self.size = len(wire)

    @property
    def wire(self):
        if self.kind == DAMAGED:
            raise CorruptMessage("damaged")
        return self._wire

    def message_class(self):
        return self.cls

    def message(self):
        return deserialize(self.cls, self.wire)


class Open:
    def require_open(self):
        pass


KINDS = st.sampled_from(["one"] * 30 + ["other"] * 10 + ["large", DAMAGED, CUT])


@given(st.lists(KINDS, max_size=400), st.booleans())
@example(["one", "large", "large"] + ["one"] * 9, False)
def test_each_row_comes_with_its_message_up_to_one_that_is_damaged(kinds, fails):
    rows = [Row(number, kind) for number, kind in enumerate(kinds)]
    taken = []

    def source():
        for row in rows:
            taken.append(row)
            yield row
        if fails:
            raise StoreUnavailable("away")

    found = []
    wrong = next((n for n, kind in enumerate(kinds) if kind in (DAMAGED, CUT)), None)

    def read():
        for pair in with_messages(Open(), source()):
            found.append(pair)
            assert len(taken) <= len(found) + min(len(found), MAX_ROWS)

    if wrong is not None or fails:
        with pytest.raises(StoreUnavailable if wrong is None else CorruptMessage):
            read()
    else:
        read()
    assert [message for _, message in found] == [row.sent for row in rows[:wrong]]
    assert [row for row, _ in found] == rows[:wrong]


def test_no_more_after_the_store_was_closed():
    class Closing:
        given = 0

        def require_open(self):
            self.given += 1
            if self.given > 70:
                raise ConnectionFailed("closed")

    rows = (Row(number, "one") for number in range(200))
    pairs = with_messages(Closing(), rows)
    assert len(list(islice(pairs, 70))) == 70
    with pytest.raises(ConnectionFailed):
        next(pairs)
