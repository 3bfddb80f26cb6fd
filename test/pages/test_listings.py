# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What pages show of Python is typed, on the bag that they speak of."""

from __future__ import annotations

import re

import pytest
from conftest import ROOT
from pages.walk import Walk, pieces

from cassandra_ros.files.bag.importer import import_bag

TOPICS = ["/encoder", "/fix", "/imu/data", "/tf"]
PAGES = ("query", "transforms", "python")


@pytest.fixture(scope="module")
def husky(fresh):
    with fresh() as rosCas:
        # As doc/query.md says: it makes an index.
        import_bag(rosCas, ROOT / "examples/data/husky_gps_data.bag", "ros", TOPICS)
        yield rosCas


@pytest.mark.parametrize("page", PAGES)
def test_listings_are_what_python_says(husky, page, cassandra, monkeypatch, ros_env):
    monkeypatch.setenv("CASSANDRA_ROS_HOST", cassandra.host)
    monkeypatch.setenv("CASSANDRA_ROS_PORT", str(cassandra.port))
    text = (ROOT / f"doc/{page}.md").read_text(encoding="utf-8")
    listings = [block for kind, block in pieces(text) if kind == "python" and ">>>" in block]
    walk = Walk(ros_env)
    try:
        mine = f"keyspace={husky.keyspace!r}"
        for block in listings:
            # The pages speak of the keyspace that everybody has.
            walk.follow("```python\n" + block.replace("keyspace='ros'", mine) + "```\n")
    finally:
        walk.close()
    assert listings, page


def test_a_statement_of_the_page_is_one_of_the_language():
    """What stands in its table of values is what the grammar knows."""
    text = (ROOT / "doc/query.md").read_text(encoding="utf-8")
    grammar = (ROOT / "src/cassandra_ros/query/tree/cql.lark").read_text(encoding="utf-8")
    functions = re.search(r"^FUNCTION.*?/\(\?:([a-z|]+)\)", grammar, re.M)[1].split("|")
    for name in functions:
        assert re.search(rf"\b{name}\b", text, re.I), name
    for word in re.findall(r"^_?[A-Z]+(?:\.\d+)?: /([a-z]+)\\b", grammar, re.M):
        if word not in ("table", "if", "exists", "allow", "filtering", "nan", "true", "false"):
            assert re.search(rf"\b{word}\b", text, re.I), word
