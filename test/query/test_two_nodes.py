# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Two robots record the same topics at the same times: asked together and apart, deleted apart."""

from __future__ import annotations

import pytest
from geometry_msgs.msg import PointStamped, TransformStamped
from query.brute_force import canonical
from query.kinds import T0
from suites import sparing
from tf2_msgs.msg import TFMessage

from cassandra_ros import Stamp
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.query.plan.pushdown import PLANS
from cassandra_ros.read import Read, Whose
from cassandra_ros.topics.query_result import Condition

SECOND = 10**9
ROBOTS = ("husky", "turtle")
COUNT = 60


class Fleet:
    """What two robots recorded: every second message of the one has a stamp of the other."""

    def __init__(self, store, format):
        self.store = store
        self.messages = {"/point": [], "/tf": []}
        for number, robot in enumerate(ROBOTS):
            with store.messageWriter(writer_id=number + 1, format=format, nodeID=robot) as writer:
                for n in range(COUNT):
                    t = T0 + n * 5 * SECOND + (number if n % 2 else 0)
                    self._write(writer, "/point", t, robot, n, self._point(robot, n))
                    self._write(writer, "/tf", t, robot, n, self._transforms(robot, n))

    def _write(self, writer, topic, t, robot, n, message):
        header = {"type": message._type, "md5sum": message._md5sum}
        header["message_definition"] = message._full_text
        handle = writer.connect(live_connection(topic, header), bucket_ns=60 * SECOND)
        writer.write(handle, t, n, serialize(message))
        self.messages[topic].append((t, robot, message))

    @staticmethod
    def _point(robot, n):
        message = PointStamped()
        message.header.frame_id = robot
        message.point.x = float(n % 10)
        return message

    @staticmethod
    def _transforms(robot, n):
        found = [TransformStamped(child_frame_id=f"{robot}/{name}") for name in ("base", "arm")]
        found[0].transform.translation.x = n / 10
        return TFMessage(found)

    def expected(self, topic, test=lambda t, robot, message: True, robots=ROBOTS):
        """Return the (time, robot, message) that satisfy a test, in the order of reading."""
        kept = [m for m in self.messages[topic] if m[1] in robots and test(*m)]
        return sorted(kept, key=lambda found: found[:2])

    def keys(self, topic, test=lambda t, robot, message: True, robots=ROBOTS):
        return [(t, robot) for t, robot, _ in self.expected(topic, test, robots)]

    def ask(self, statement, params=(), nodeID=None, **options):
        result = self.store.statements.select(statement, params, node=nodeID, **options)
        return [tuple(map(canonical, row)) for row in result]


@pytest.fixture(params=sparing(["ros", "binary"], ["ros"], "campaign"))
def fleet(request, rosCas):
    made = Fleet(rosCas, request.param)
    rosCas.getTopic("point").createIndex("point.x")
    rosCas.getTopic("tf").createIndex("transforms.child_frame_id")
    return made


def test_together_and_apart(fleet):
    both = fleet.keys("/point")
    assert len({t for t, _ in both}) < len(both) == 2 * COUNT
    assert fleet.ask("select KEY, NODE from point") == both
    assert fleet.ask("select KEY, NODE from point order by KEY desc") == both[::-1]
    for robot in ROBOTS:
        own = fleet.keys("/point", robots=[robot])
        assert fleet.ask("select KEY, NODE from point", nodeID=robot) == own
        assert fleet.ask("select KEY, NODE from point where NODE = ?", [robot]) == own
        assert fleet.ask(f"select KEY, NODE from point where NODE like '{robot[0]}%'") == own
        others = fleet.ask(f"select KEY, NODE from point where not NODE = '{robot}'")
        assert others == [key for key in both if key not in own]
        assert [r.t for r in fleet.store.readMessages(["point"], nodeID=robot)] == [
            t for t, _ in own
        ]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_conditions(fleet):
    for plan in PLANS:
        check_conditions(fleet, plan)


def check_conditions(fleet, plan):
    for robots, options in ((ROBOTS, {}), *(([r], {"nodeID": r}) for r in ROBOTS)):
        expected = fleet.keys("/point", lambda t, robot, m: m.point.x == 3, robots)
        text = "select KEY, NODE from point where point.x = 3"
        assert fleet.ask(text, plan=plan, **options) == expected
        assert len(expected) == len(robots) * COUNT / 10
        expected = [
            (t, robot, canonical(f.transform.translation.x))
            for t, robot, m in fleet.expected("/tf", robots=robots)
            for f in m.transforms
            if f.child_frame_id == "husky/base" and t < T0 + 130 * SECOND
        ]
        assert bool(expected) == ("husky" in robots)
        text = (
            "select KEY, NODE, transforms.transform.translation.x from tf "
            f"where transforms.child_frame_id = 'husky/base' and KEY < {T0 + 130 * SECOND}"
        )
        assert fleet.ask(text, plan=plan, **options) == expected
    # The condition tells them apart by itself.
    either = "(NODE = 'husky' and point.x = 3) or (NODE = 'turtle' and point.x = 4)"
    expected = fleet.keys("/point", lambda t, r, m: m.point.x == {"husky": 3, "turtle": 4}[r])
    assert fleet.ask(f"select KEY, NODE from point where {either}", plan=plan) == expected


@pytest.mark.suite("all", "make test asks others of its kind")
def test_counts(fleet):
    topic = fleet.store.getTopic("point")
    assert fleet.ask("select count(*) from point") == [(2 * COUNT,)]
    assert topic.countTopicData() == 2 * COUNT
    half = T0 + COUNT // 2 * 5 * SECOND
    for robot in ROBOTS:
        early = len(fleet.keys("/point", lambda t, robot, m: t < half, [robot]))
        assert topic.countTopicData(nodeID=robot) == COUNT
        for text, params in (
            ("select count(*) from point where NODE = ? and KEY < ?", [robot, half]),
            ("select count(KEY) from point where header.frame_id = ? and KEY < ?", [robot, half]),
        ):
            assert fleet.ask(text, params) == [(early,)]
        assert fleet.ask("select count(*) from point where KEY < ?", [half], nodeID=robot) == [
            (early,)
        ]
    text = "select min(NODE), max(NODE), min(KEY), max(KEY), sum(point.x) from point"
    times = [t for t, _ in fleet.keys("/point")]
    total = sum(m.point.x for _, _, m in fleet.expected("/point"))
    assert fleet.ask(text) == [(*ROBOTS, min(times), max(times), canonical(total))]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_deleted_apart(fleet):
    topic = fleet.store.getTopic("point")
    low, high = T0 + 100 * SECOND, T0 + 200 * SECOND
    gone = fleet.keys("/point", lambda t, robot, m: low <= t <= high, ["husky"])
    ends = (Stamp.from_ns(low), Stamp.from_ns(high))
    assert topic.removeData(*ends, nodeID="husky") == len(gone) > 10
    # A bare time that both have, of one of them; and of the two.
    shared = T0 + 250 * SECOND
    assert topic.removeData(Stamp.from_ns(shared), nodeID="turtle") == 1
    gone.append((shared, "turtle"))
    first = Stamp.from_ns(T0)
    assert topic.removeData(first) == 2
    gone += [(T0, robot) for robot in ROBOTS]
    left = [key for key in fleet.keys("/point") if key not in gone]
    assert fleet.ask("select KEY, NODE from point") == left
    for plan in PLANS:
        threes = fleet.keys("/point", lambda t, robot, m: m.point.x == 0)
        found = fleet.ask("select KEY, NODE from point where point.x = 0", plan=plan)
        assert found == [key for key in threes if key not in gone]
    assert topic.countTopicData() == len(left)
    for robot in ROBOTS:
        own = [key for key in left if key[1] == robot]
        assert topic.countTopicData(nodeID=robot) == len(own)
        rows = Condition("point.x >= 0").rows(topic, Read(whose=Whose.of(robot)))
        assert [(row.t, row.node) for row in rows] == own
    # The other topic is as it was.
    assert fleet.store.getTopic("tf").countTopicData() == 2 * COUNT
    assert topic.removeData(Stamp.from_ns(0), Stamp.from_ns(high * 2), nodeID="nobody") == 0
