# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The questions of doc/sql.md are typed, on the fleet that it speaks of."""

from __future__ import annotations

import re

import pytest
from conftest import ROOT
from pages.walk import Walk, pieces

from cassandra_ros.files.bag.importer import import_bag

TEXT = (ROOT / "doc/sql.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module", params=["ros", "packed"])
def fleet(fresh, request):
    with fresh() as rosCas:
        for node in ("alpha", "beta"):
            bag = ROOT / "examples/data/husky_gps_data.bag"
            import_bag(rosCas, bag, request.param, nodeID=node)
        yield rosCas


@pytest.mark.suite("all", "it types the whole page")
def test_the_questions_have_these_answers(fleet, cassandra, monkeypatch, ros_env):
    monkeypatch.setenv("CASSANDRA_ROS_HOST", cassandra.host)
    monkeypatch.setenv("CASSANDRA_ROS_PORT", str(cassandra.port))
    listings = [block for kind, block in pieces(TEXT) if kind == "python"]
    walk = Walk(ros_env)
    try:
        for block in listings:
            mine = block.replace("keyspace='ros'", f"keyspace={fleet.keyspace!r}")
            walk.follow("```python\n" + mine + "```\n")
    finally:
        walk.close()


def test_there_are_twenty_questions():
    section = TEXT.partition("\n## Twenty questions\n")[2]
    numbers = [int(n) for n in re.findall(r"^\*\*(\d+)\. .*\?", section, re.M)]
    assert numbers == list(range(1, 21))
