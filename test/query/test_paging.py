# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements give the same rows in the same order whatever the pages: ours, and the store's."""

from __future__ import annotations

import contextlib
import uuid

import pytest
from conftest import ROOT
from geometry_msgs.msg import TransformStamped
from query.brute_force import canonical
from query.kinds import T0, Stored
from std_msgs.msg import String
from suites import FURTHER, sparing
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra
from cassandra_ros.query.plan.pushdown import PLANS
from cassandra_ros.store.rows import reader

SIZES = (1, 7, 5000)
PAGED = ("auto", "index")
FORMATS = ("ros", "json") if FURTHER else ("ros",)
KINDS = {"tf": FORMATS, "mixed": FORMATS, "string": ("ros",), "every": FORMATS}

STATEMENTS = [
    *(f"select KEY, NODE from /{f}/{k}{end}" for f in FORMATS for k in ("mixed",)
      for end in ("", " order by KEY desc", " limit 20", " order by KEY desc limit 20")),
    "select KEY, NODE, transforms.child_frame_id from /ros/tf",
    f"select transforms.child_frame_id, KEY from /{FORMATS[-1]}/tf order by KEY desc limit 31",
    "select KEY, transforms.transform.translation.x, NODE from /ros/tf order by KEY desc",
    "select KEY, transforms.header.seq from /ros/tf where transforms.child_frame_id like '%_link%'",
    "select KEY from /ros/tf where transforms.transform.translation.x > -1 order by KEY desc",
    f"select KEY, transforms.header.frame_id from /{FORMATS[-1]}/tf where NODE = 'husky' limit 30",
    "select KEY, what, only_older from /ros/mixed where x >= 0 or n is not null",
    f"select KEY, what from /{FORMATS[-1]}/mixed where x > -5 order by KEY desc limit 16",
    "select * from /ros/mixed",
    "select KEY, items.more.a from /ros/every where items.x >= 0 or items.name != ''",
    "select KEY, items.name, items.more.b from /ros/every order by KEY desc",
    "select KEY, f64, words from /ros/every where i32 in (-1, 0, 1, 2, 5) or ints contains 0",
    "select KEY, NODE, f32 from /ros/every where f32 >= 0.1",
    f"select KEY from /{FORMATS[-1]}/every where flag = true and "
    f"KEY between {T0} and {T0 + 200 * 10**9}",
    "select KEY from /ros/string where NODE in ('husky', 'husky_2') and data != 'a'",
    "select count(*), min(KEY), max(NODE) from /ros/every where u8 > 0",
    "select KEY, data from /maps",
    "select KEY, data from /maps order by KEY desc",
    "select KEY, data from /maps where KEY = 'yard'",
    "select KEY, data from /maps where KEY like '%a%' and data != '3' order by KEY desc limit 9",
    "select KEY, NODE, transforms.child_frame_id from /both",
    "select KEY, NODE, transforms.child_frame_id from /both order by KEY desc",
    "select KEY, NODE from /both where transforms.child_frame_id in ('', '1', '3')",
]  # fmt: skip


@pytest.fixture(scope="module")
def store(cassandra, cql):
    name = f"t_{uuid.uuid4().hex[:16]}"
    with RosCassandra(cassandra.host, cassandra.port, keyspace=name) as made:
        with contextlib.ExitStack() as writers:
            for kind, formats in KINDS.items():
                stored = Stored(kind, ROOT / "examples/data/husky_gps_data.bag")
                for format in formats:
                    writers.enter_context(stored.store(made, format))
            _named(made)
            _equal_stamps(made)
            yield made
    cql.execute(f"DROP KEYSPACE {name}")


def _named(made):
    topic = made.addTopic("/maps", format="ros", key_format="manual")
    for n in range(24):
        name = ("hall", "yard", "garage", "Zoë's room")[n % 4]
        topic.addData(String(str(n)), key=name, nodeID="ab"[n % 2])


def _equal_stamps(made):
    """Three messages of each of two nodes at the same time, each of two elements."""
    topic = made.addTopic("/both", format="ros")
    for n in range(24):
        transforms = [TransformStamped(child_frame_id=str(n)), TransformStamped()]
        topic.addData(TFMessage(transforms), key=T0 + n // 6 * 10**9, nodeID="ab"[n % 2])


def rows(found):
    return [tuple(map(canonical, row)) for row in found]


def paged(store, statement, size, plan):
    found, cursor = [], None
    while True:
        with store.statements.select(statement, limit=size, after=cursor, plan=plan) as result:
            page = rows(result)
            # As services keep it: as text.
            cursor = str(result.cursor)
        assert len(page) <= size
        found += page
        # Aggregates are one row, after which nothing can be continued.
        if len(page) < size or not cursor:
            return found


@pytest.mark.suite("all", "it reads in pages of each size")
@pytest.mark.search
@pytest.mark.parametrize("statement", sparing(STATEMENTS, kept=STATEMENTS[:1]))
def test_pages_of_any_size_give_the_same_rows(store, statement):
    whole = rows(store.statements.select(statement, plan="client"))
    assert len(whole) > 7 or "count(" in statement or "= 'yard'" in statement
    ways = [(size, plan) for size in SIZES for plan in PAGED]
    if not FURTHER:  # each size in one of the plans, which take turns
        number = STATEMENTS.index(statement)
        ways = [(size, PAGED[(number + n) % 2]) for n, size in enumerate(SIZES)]
    for size, plan in ways:
        assert paged(store, statement, size, plan) == whole, (size, plan)


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("statement", sparing(STATEMENTS, kept=STATEMENTS[1::4]))
def test_pages_of_the_store_change_nothing(store, statement, monkeypatch):
    whole = rows(store.statements.select(statement, plan="client"))
    for size in (1, 7):
        monkeypatch.setattr(reader, "MAX_PAGE_ROWS", size)
        for plan in PLANS:
            assert rows(store.statements.select(statement, plan=plan)) == whole, (size, plan)
        assert paged(store, statement, 7, "auto") == whole


@pytest.mark.suite("all", "it fills topics of all formats")
def test_positions_are_cursors_too(store):
    """For a statement with one row per message the cursor may be a bare position."""
    topic = store.getTopic("both")
    statement = "select KEY, NODE from both"
    whole = rows(store.statements.select(statement))
    for n, row in enumerate(topic.rows()):
        assert rows(store.statements.select(statement, after=row.position)) == whole[n + 1 :]
