# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""nearestMessages: each message of one topic with the nearest one of another."""

from __future__ import annotations

from decimal import Decimal
from itertools import count
from types import SimpleNamespace

import genpy
import pytest
from geometry_msgs.msg import PointStamped
from hypothesis import example, given
from hypothesis import strategies as st
from std_msgs.msg import Header, UInt32

from cassandra_ros.errors import InvalidKey, InvalidOption, TopicNotFound
from cassandra_ros.topics.catalog import nearest_pairs

SEC = 10**9
T0 = 1_500_000_000 * SEC

# Few values, so that many are equal; a gap between them.
TIMES = st.lists(st.one_of(st.integers(0, 12), st.integers(40, 46)), max_size=30).map(sorted)


def rows(times):
    return [SimpleNamespace(t=t, number=number) for number, t in enumerate(times)]


def brute(first, second, tolerance):
    """The partner of each row of the first, looked for among all."""
    for row in first:
        near = [other for other in second if abs(other.t - row.t) <= tolerance]
        near.sort(key=lambda other: (abs(other.t - row.t), other.t, other.number))
        yield row, near[0] if near else None


@given(TIMES, TIMES, st.integers(0, 50))
@example([5], [], 50)
@example([], [5], 50)
@example([5, 5, 6], [4, 4, 6, 6], 1)
def test_pairs_are_those_of_brute_force(times_a, times_b, tolerance):
    first, second = rows(times_a), rows(times_b)
    wanted = list(brute(first, second, tolerance))
    assert list(nearest_pairs(iter(first), iter(second), tolerance, unpaired=True)) == wanted
    pairs = [pair for pair in wanted if pair[1] is not None]
    assert list(nearest_pairs(iter(first), iter(second), tolerance)) == pairs


def test_no_more_is_read_than_a_pair_needs():
    taken = [0, 0]

    def endless(which, step):
        for n in count():
            taken[which] = n + 1
            yield SimpleNamespace(t=n * step)

    pairs = nearest_pairs(endless(0, 10), endless(1, 1), 0)
    for n in range(100):
        row, partner = next(pairs)
        assert (row.t, partner.t) == (10 * n, 10 * n)
        assert taken == [n + 1, 10 * n + 2]


def test_what_comes_after_the_last_partner_is_not_read():
    first = iter(rows(range(100)))
    assert len(list(nearest_pairs(first, iter(rows([3])), 5))) == 9
    assert next(first).t == 10


@pytest.fixture
def filmed(rosCas):
    """Images (numbers) at 0, 1, ... 9 s, poses each 0.3 s from 2 s on, of two robots at 5 s."""
    images, poses = rosCas.addTopic("/image"), rosCas.addTopic("/pose")
    for number in range(10):
        images.addData(UInt32(data=number), key=T0 + number * SEC)
    for number in range(12):
        poses.addData(pose(number), key=T0 + 2 * SEC + number * 3 * SEC // 10)
    poses.addData(pose(99), key=T0 + 5 * SEC, nodeID="r1")
    return rosCas


def pose(number):
    return PointStamped(header=Header(seq=number))


def numbers(pairs):
    return [(a.message().data, None if b is None else b.message().header.seq) for a, b in pairs]


def test_an_image_with_its_pose(filmed):
    near = filmed.nearestMessages("/image", "/pose", 0.15)
    assert numbers(near) == [(2, 0), (3, 3), (4, 7), (5, 10)]
    rows_of = next(filmed.nearestMessages("image", "pose", 0.15))
    assert [row.topic for row in rows_of] == ["/image", "/pose"]
    # At 5 s there are poses of both; without a nodeID the first in the order of nodes is taken.
    mine = filmed.nearestMessages("/image", "/pose", 0.15, nodeID="")
    assert numbers(mine) == numbers(filmed.nearestMessages("/image", "/pose", 0.15))
    assert numbers(filmed.nearestMessages("/image", "/pose", 9, nodeID="r1")) == []


def test_those_without_a_partner(filmed):
    pairs = filmed.nearestMessages("/image", "/pose", 0.15, unpaired=True)
    assert numbers(pairs) == [
        *((0, None), (1, None), (2, 0), (3, 3), (4, 7), (5, 10)),
        *((6, None), (7, None), (8, None), (9, None)),
    ]


def test_the_tolerance_is_included(filmed):
    for length in (1, 1.0, Decimal(1), genpy.Duration(1)):
        assert numbers(filmed.nearestMessages("/image", "/pose", length))[0] == (1, 0)
    assert numbers(filmed.nearestMessages("/image", "/pose", 0.999999999))[0] == (2, 0)
    assert numbers(filmed.nearestMessages("/image", "/pose", 0)) == [(2, 0), (5, 10)]
    for wrong in (-0.1, genpy.Duration(-1), "1", None, True, float("nan"), float("inf")):
        with pytest.raises(InvalidKey):
            filmed.nearestMessages("/image", "/pose", wrong)


def test_partners_may_lie_outside_of_the_range(filmed):
    near = filmed.nearestMessages("/image", "/pose", 0.15, T0 + 3 * SEC, T0 + 4 * SEC)
    assert numbers(near) == [(3, 3), (4, 7)]
    assert numbers(filmed.nearestMessages("/image", "/pose", 9, to_key=T0)) == [(0, 0)]


def test_conditions_choose_messages_and_partners(filmed):
    conditions = {"/pose": "header.seq IN (0, 4)", "image": ("data > ?", [1])}
    near = filmed.nearestMessages("/image", "/pose", 1, where=conditions)
    assert numbers(near) == [(2, 0), (3, 4), (4, 4)]
    near = filmed.nearestMessages("/image", "/image", 1, where={"/image": "data = 7"})
    assert numbers_alike(near) == [(7, 7)]
    filmed.addTopic("/other", msg_type="std_msgs/UInt32")
    with pytest.raises(InvalidOption, match="not among"):
        filmed.nearestMessages("/image", "/pose", 1, where={"/other": "data = 1"})
    with pytest.raises(TopicNotFound):
        filmed.nearestMessages("/image", "/nowhere", 1)


def numbers_alike(pairs):
    return [tuple(row.message().data for row in pair) for pair in pairs]
