# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Answers are handed on whole and in order, in whatever pieces they come."""

from __future__ import annotations

import struct

from hypothesis import given
from hypothesis import strategies as st

from cassandra_ros.store.connection.protocol import WIDE_ROW_BYTES, BufferedConnection, RawPage


class Connection(BufferedConnection):
    """A connection without a server."""

    def __init__(self):
        self.told = []

    def process_msg(self, header, body):
        self.told.append((header.version, header.flags, header.stream, header.opcode, body))


@given(st.lists(st.binary(max_size=40), max_size=6), st.lists(st.integers(0, 200)), st.integers(0))
def test_answers_come_whole(bodies, cuts, extra):
    sent = [(4, 0, n - 1, 8, body) for n, body in enumerate(bodies)]
    head = struct.Struct(">BBhBi")
    data = b"".join(head.pack(0x84, *told[1:4], len(told[4])) + told[4] for told in sent)
    data += head.pack(0x84, 0, 7, 8, 100)[: extra % 10]
    connection = Connection()
    at = 0
    for cut in [*sorted(min(cut, len(data)) for cut in cuts), len(data)]:
        if at < cut:
            connection._iobuf.write(data[at:cut])
            connection.process_io_buffer()
        at = cut
    assert connection.told == sent


def test_who_speaks_something_else_is_no_server():
    connection, failed = Connection(), []
    connection.defunct = failed.append
    connection._iobuf.write(b"HTTP/1.1 400 Bad Request\r\n")
    connection.process_io_buffer()
    assert len(failed) == 1


def test_an_answer_that_breaks_off_closes_the_connection():
    connection, closed = Connection(), []
    connection.close = lambda: closed.append(True)
    whole = struct.pack(">BBhBi", 0x84, 0, 0, 8, 4) + b"body"
    connection._iobuf.write(whole + whole[:-1])
    connection.process_io_buffer()
    assert not closed
    connection._iobuf.write(b"")
    connection.process_io_buffer()
    assert closed
    assert len(connection.told) == 1


def test_wide_rows_are_cut_as_others():
    values = [b"a" * WIDE_ROW_BYTES, None, b"", b"b" * WIDE_ROW_BYTES]
    sized = [struct.pack(">i", -1 if v is None else len(v)) + (v or b"") for v in values]
    pages = [RawPage(b"head" + struct.pack(">i", 2) + b"".join(sized), 4, 2, list) for _ in "ab"]
    rows = [(values[0], None), (b"", values[3])]
    assert list(pages[0]) == list(pages[0].views()) == rows
    assert list(pages[1].views()) == rows
    assert pages[1][-1] == rows[-1]
    assert list(pages[1]) == rows


def test_few_rows_are_cut_as_others():
    sized = b"".join(struct.pack(">i", len(v)) + v for v in (b"a", b"bc", b"d", b""))
    page = RawPage(struct.pack(">i", 2) + sized, 0, 2, list)
    assert list(page.views()) == list(page) == [(b"a", b"bc"), (b"d", b"")]
