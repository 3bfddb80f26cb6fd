# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""--store, given several times: query and info over several stores."""

from __future__ import annotations

import json

import pytest
from proxy import Proxy
from std_msgs.msg import String

from cassandra_ros.copying.replicator import Replicator

T0 = 1_500_000_000 * 10**9


@pytest.fixture
def places(rosCas, cassandra, keyspaces, connect):
    """Two stores: the first has /a 0 to 4, the other a copy of these, and 5."""
    topic = rosCas.addTopic("/a")
    for n in range(5):
        topic.addData(String(str(n)), key=T0 + n)
    rosCas.catalog.adder.close()
    with keyspaces.lend() as name, connect(keyspace=name) as other:
        Replicator(rosCas, other).copy()
        other.addTopic("/a").addData(String("5"), key=T0 + 5)
        other.catalog.adder.close()
        where = f"{cassandra.host}:{cassandra.port}"
        yield [f"{where}/{rosCas.keyspace}", f"{where}/{name}"]


def both(places):
    return [word for place in places for word in ("--store", place)]


def test_a_statement_is_answered_over_all_stores(call, places, tmp_path):
    statement = "SELECT data FROM /a WHERE KEY > 5 ORDER BY KEY DESC LIMIT 3"
    status, out, err = call("query", statement, *both(places), "--output", "csv")
    assert (status, out.split(), err) == (0, ["data", "5", "4", "3"], "")
    file = tmp_path / "stores"
    file.write_text(f"[home]\nplace = {places[0]}\n[robot]\nplace = {places[1]}\n")
    names = ["--store", "home", "--store", "robot", "--store-file", file]
    status, out, _ = call("query", "SELECT count(*) FROM a", *names, "--json")
    assert (status, json.loads(out)) == (0, [{"count(*)": 6}])


def test_info_counts_each_message_once(call, places):
    status, out, err = call("info", *both(places))
    assert (status, err) == (0, "")
    assert "6 of 1 topic" in out
    assert f"{places[0]} 5, {places[1]} 6" in out
    status, out, _ = call("info", "-e", "/a.*", *both(places), "--json")
    answer = json.loads(out)
    assert (status, answer["messages"], answer["partial"]) == (0, 6, False)
    assert answer["topics"][0]["stores"] == {places[0]: 5, places[1]: 6}


def test_a_store_that_does_not_answer_is_named_with_a_status_of_its_own(call, places, cassandra):
    with Proxy(cassandra.host, cassandra.port) as proxy:
        proxy.cut()
        gone = f"{proxy.host}:{proxy.port}/{places[1].split('/')[1]}"
    asked = ["--store", places[0], "--store", gone, "--store-timeout", "2"]
    status, out, err = call("query", "SELECT count(*) FROM a", *asked, "--output", "csv")
    assert (status, out.split()) == (3, ["count(*)", "5"])
    assert f"cassandra_bag: store {gone} did not answer" in err
    status, out, err = call("info", *asked, "--json")
    assert (status, list(json.loads(out)["missing"])) == (3, [gone])
    assert gone in err
    assert call("query", "SELECT * FROM a", "--store", gone, "--store-timeout", "1")[0] == 1


@pytest.mark.parametrize("option", ["--explain", "--allow-writes"])
def test_what_asks_one_store_is_refused(call, option):
    status, _, err = call("query", "SELECT * FROM a", "--store", "home", option)
    assert status == 2
    assert option in err
