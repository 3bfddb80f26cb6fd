# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""LIMIT and pages that end inside a message's elements, at the last element, and after it."""

from __future__ import annotations

import pytest
from geometry_msgs.msg import TransformStamped
from suites import sparing
from tf2_msgs.msg import TFMessage

from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.topics.query_result import read_cursor

FORMATS = ("packed", "ros", "binary")
T0 = 1_400_000_000 * 10**9
COUNTS = (2, 0, 3, 1, 0, 2, 4, 0)
"""Number of elements of each message."""
TIMES = tuple(T0 + n * 10**9 for n in (0, 1, 2, 2, 3, 4, 4, 5))
"""ns; of two messages that have the same one the first is of node a."""
NODES = ("a", "a", "a", "b", "b", "a", "b", "a")
ROWS = [(n, f"{n}.{i}") for n, count in enumerate(COUNTS) for i in range(count)]
"""Number of its message and text of each element, in the order of time."""
COLUMNS = "select KEY, transforms.child_frame_id from"
SOME = "where transforms.child_frame_id not in ('0.1', '2.0', '6.1', '6.3')"
KEPT = [row for row in ROWS if row[1] not in ("0.1", "2.0", "6.1", "6.3")]


def fill(store, format):
    """Write the messages to a topic that is called as their format."""
    definition = definition_of(TFMessage)
    for node in "ab":
        with store.messageWriter(nodeID=node, format=format) as writer:
            handle = writer.connect(api_connection(f"/{format}", definition, "/x"))
            for n, count in enumerate(COUNTS):
                message = TFMessage(
                    [TransformStamped(child_frame_id=f"{n}.{i}") for i in range(count)]
                )
                if NODES[n] == node:
                    writer.write(handle, TIMES[n], n, serialize(message))


@pytest.fixture(scope="module")
def store(fresh):
    with fresh() as made:
        for format in FORMATS:
            fill(made, format)
        yield made


def ordered(rows, reverse):
    """Return rows as ORDER BY KEY DESC gives them: a message's elements keep their order."""
    return sorted(rows, key=lambda row: -row[0]) if reverse else rows


def told(rows):
    return [(TIMES[n], text) for n, text in rows]


def ask(store, statement, **options):
    """Return the rows of a statement, its cursor, and how many messages were read for them."""
    with store.statements.select(statement, **options) as result:
        rows = [(key.ns, text) for key, text in result]
        return rows, result.cursor, result.read


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("format", FORMATS)
def test_limits_at_every_element(store, format, reverse):
    """Each LIMIT returns its number of rows and reads no further message; the next page goes on."""
    every = ordered(ROWS, reverse)
    order = " order by KEY desc" if reverse else ""
    places = [n for n, _ in ordered([(n, "") for n in range(len(COUNTS))], reverse)]
    for limit in range(1, len(every) + 2):
        statement = f"{COLUMNS} {format}{order}"
        wanted = told(every[:limit])
        rows, _, read = ask(store, f"{statement} limit {limit}")
        assert rows == wanted
        page, cursor, _ = ask(store, statement, limit=limit)
        assert page == wanted
        assert page + ask(store, statement, after=cursor)[0] == told(every)
        if 0 < limit <= len(every):
            last = every[limit - 1][0]
            assert read == places.index(last) + 1
            given = sum(n == last for n, _ in every[:limit])
            # After a message's last element a page begins with the next message.
            assert read_cursor(cursor).skip == given % COUNTS[last]


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("format", sparing(FORMATS, kept=["packed"]))
@pytest.mark.parametrize(("where", "rows"), [("", ROWS), (SOME, KEPT)], ids=["all", "some"])
def test_pages_of_a_limit(store, format, reverse, where, rows):
    """Pages of each size give together what LIMIT leaves, at whichever element it ends."""
    order = " order by KEY desc" if reverse else ""
    every = told(ordered(rows, reverse))
    for size, limit in [(1, 6), (2, 4), (2, 5), (3, 6), (4, 7), (5, len(every)), (3, 99)]:
        statement = f"{COLUMNS} {format} {where}{order} limit {limit}"
        found, cursor = [], None
        while True:
            page, cursor, _ = ask(store, statement, limit=size, after=cursor)
            assert len(page) <= size
            found += page
            if len(page) < size:
                break
        assert found == every[:limit], (size, limit)


@pytest.mark.parametrize("reverse", [False, True])
@pytest.mark.parametrize("format", sparing(FORMATS, kept=["packed"]))
def test_a_page_behind_a_message_that_was_removed(fresh, format, reverse):
    """What was given of it is not left out of the next message."""
    with fresh() as store:
        fill(store, format)
        statement = f"{COLUMNS} {format}" + (" order by KEY desc" if reverse else "")
        every = ordered(ROWS, reverse)
        inside = 3  # 0.0, 0.1, 2.0; backwards 6.0, 6.1, 6.2
        page, cursor, _ = ask(store, statement, limit=inside)
        last = every[inside - 1][0]
        assert store.getTopic(format).removeData(TIMES[last], TIMES[last], nodeID=NODES[last]) == 1
        rest = [row for row in every[inside:] if row[0] != last]
        assert page + ask(store, statement, after=cursor)[0] == told(every[:inside] + rest)
