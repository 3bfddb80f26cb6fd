# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages evenly spaced in time: the nearest to each time, each once, found without the others."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from std_msgs.msg import Int64

from cassandra_ros.errors import MessageNotFound
from cassandra_ros.topics.overview.time_sample import MessageChoice, nearest_rows, spaced_rows

TIMES = st.lists(st.integers(0, 60), max_size=12).map(sorted)
T = 10**18


@given(TIMES, TIMES)
def test_the_nearest_of_each_time(stored, wanted):
    rows = [SimpleNamespace(t=t, place=n) for n, t in enumerate(stored)]
    found = [row.t for row in nearest_rows(iter(rows), wanted)]
    nearest = [min(stored, key=lambda t: (abs(t - each), t)) for each in wanted] if stored else []
    assert found == nearest


def test_of_what_is_stored(rosCas):
    topic = rosCas.addTopic("/n", "binary", msg_type="std_msgs/Int64")
    for n in range(100):
        topic.addData(Int64(n), key=T + n * 10**9, nodeID="r")

    def numbers(count, every_sec=0, **chosen):
        rows = spaced_rows(rosCas.catalog, "n", MessageChoice(**chosen), count, every_sec * 10**9)
        return [row.message().data for row in rows]

    assert numbers(4) == [0, 33, 66, 99]
    assert numbers(1) == [0]
    assert numbers(100) == numbers(200) == list(range(100))
    assert numbers(30, 25) == [0, 25, 50, 75]
    assert numbers(2, 25) == [0, 25]
    assert numbers(3, start=T + 10**10, end=T + 2 * 10**10) == [10, 15, 20]
    assert numbers(3, where="data >= 50 AND data != 75", node="r") == [50, 74, 99]
    assert numbers(30, where="data IN (3, 4, 90)") == [3, 4, 90]
    assert numbers(2, where="data IN (3, 4, 90)") == [3, 90]
    assert numbers(2, writers=frozenset([topic.getRow(T).seq >> 32])) == [0, 99]
    for chosen in (
        {"where": "data > 1000"},
        {"node": "s"},
        {"end": T - 1},
        {"writers": frozenset()},
    ):
        with pytest.raises(MessageNotFound, match="topic /n has no such message"):
            numbers(3, **chosen)
    # Half an hour of silence has no message of its own.
    topic.addData(Int64(100), key=T + 1800 * 10**9)
    assert numbers(20) == [0, 95, 99, 100]
    names = rosCas.addTopic("/names", key_format="manual")
    for n, name in enumerate("abcd"):
        names.addData(Int64(n), key=name)
    rows = list(spaced_rows(rosCas.catalog, "/names", MessageChoice(), 2))
    assert [row.message().data for row in rows] == [0, 3]
    assert len(list(spaced_rows(rosCas.catalog, "/names", MessageChoice(), 4))) == 4
