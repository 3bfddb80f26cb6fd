# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What explainCQL tells of packed topics: blocks that zones leave out, messages sifted out."""

from __future__ import annotations

import pytest
from std_msgs.msg import ColorRGBA, String

from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of

SEC = 10**9
T0 = 1_500_000_000 * SEC
BUCKETS, BLOCKS, EACH = 4, 10, 60


@pytest.fixture(scope="module")
def rosCas(fresh):
    """Colours in 4 buckets of 10 blocks of 60; r counts, g is r modulo 10. And some texts."""
    with fresh() as store:
        with store.messageWriter(format="packed") as writer:
            connection = api_connection("/c", definition_of(ColorRGBA), "/x")
            handle = writer.connect(connection, bucket_ns=SEC, span_ns=SEC // BLOCKS - 1)
            for n in range(BUCKETS * BLOCKS * EACH):
                wire = serialize(ColorRGBA(n, n % 10, n % 100, 0.5))
                writer.write(handle, T0 + n * SEC // (BLOCKS * EACH), n, wire)
            handle = writer.connect(api_connection("/s", definition_of(String), "/x"), SEC)
            for n, text in enumerate(["a" * 100, "b", "c" * 100 + "d", "ü" * 70]):
                writer.write(handle, T0 + n * SEC, n, serialize(String(text)))
        yield store


def explained(rosCas, condition):
    statement = f"select KEY, r from c where {condition}"
    found = rosCas.explainCQL(statement)
    client = list(rosCas.statements.select(statement, plan="client"))
    assert rosCas.executeCQL(statement) == client and found.rows_returned == len(client)
    return found


@pytest.mark.parametrize(
    ("condition", "blocks", "kept"),
    [
        ("r = 7", 1, 1),
        ("r = 7.5", 1, 0),
        ("r >= 2390", 1, 10),
        ("r in (3, 70, 650)", 3, 3),
        ("r between 55 and 64", 2, 10),
        ("r < 10 or r > 2390", 2, 19),
        ("r > 100 and r < 50", 0, 0),
        ("r <= 59 and not g = 3", 1, 60),
        ("r <= 59 and g != 3", 1, 54),
        ("g > 20", 0, 0),
    ],
)
def test_blocks_that_cannot_match_are_not_read(rosCas, condition, blocks, kept):
    found = explained(rosCas, condition)
    assert (found.blocks, found.unpacked) == (blocks, blocks * EACH), str(found)
    assert found.rows_read == kept and found.sifted == blocks * EACH - kept
    assert found.unread == BUCKETS * BLOCKS * EACH - blocks * EACH


def test_zones_that_let_most_through_are_asked_no_more(rosCas):
    found = explained(rosCas, "g = 3")
    assert found.whole and found.filtered and found.rows_read == 240
    assert found.unread == 0 and found.sifted == 2400 - 240


def test_what_zones_do_not_know_is_read(rosCas):
    found = explained(rosCas, "not r = 7")
    assert found.whole == BUCKETS and found.unread == found.sifted == 0


def test_the_text(rosCas):
    statement = "select KEY from c where r < 100 and not g = 3"
    assert str(rosCas.explainCQL(statement)) == (
        f"{statement}\n"
        "topic:         /c\n"
        "buckets:       4 of 4: 4 filtered by the server\n"
        "blocks:        2 of 120 messages unpacked, of which 20 were sifted out; "
        "not read: those of 2280 messages\n"
        "server:        r < 100 (zones)\n"
        "client alone:  NOT g = 3\n"
        "rows read:     100\n"
        "rows returned: 90"
    )


@pytest.mark.parametrize("wanted", ["a" * 100, "a" * 99, "b", "c" * 100 + "d", "ü" * 70, "z", ""])
@pytest.mark.parametrize("sign", ["=", "<", ">="])
def test_long_texts_are_found_by_how_they_begin(rosCas, wanted, sign):
    select = rosCas.statements.select
    statement = f"select data from s where data {sign} ?"
    found = [list(select(statement, [wanted], plan=plan)) for plan in ("client", "filter")]
    assert found[0] == found[1]
    if sign == "=" and len(wanted) > 99 or wanted == "b":
        assert found[0]
