# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""--store, given several times: query and info over several stores."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
import rosbag
from mcap.reader import make_reader
from proxy import Proxy
from std_msgs.msg import String

from cassandra_ros.messages.classes import serialize
from cassandra_ros.stores.copying.replicator import Replicator

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


def contents(path):
    """Bytes and time of the messages of a file, read by others than we."""
    if path.suffix == ".bag":
        with rosbag.Bag(str(path)) as bag:
            yield from ((raw[1], t.to_nsec()) for _, raw, t in bag.read_messages(raw=True))
        return
    with path.open("rb") as stream:
        for _, _, message in make_reader(stream).iter_messages():
            yield message.data, message.log_time


def test_a_statement_is_answered_over_all_stores(call, places, tmp_path):
    statement = "SELECT data FROM /a WHERE KEY > 5.0 ORDER BY KEY DESC LIMIT 3"
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
    asked = ["--store", places[0], "--store", gone, "--store-timeout", "60"]
    status, out, err = call("query", "SELECT count(*) FROM a", *asked, "--output", "csv")
    assert (status, out.split()) == (3, ["count(*)", "5"])
    assert f"cassandra_bag: store {gone} did not answer" in err
    status, out, err = call("info", *asked, "--json")
    assert (status, list(json.loads(out)["missing"])) == (3, [gone])
    assert gone in err
    assert call("query", "SELECT * FROM a", "--store", gone, "--store-timeout", "60")[0] == 1


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_file_gets_each_message_once(call, places, connect, tmp_path, kind):
    with connect(keyspace=places[1].split("/")[1]) as robot:
        event = robot.addEvent("bump", T0 + 2, T0 + 3)
        with connect(keyspace=places[0].split("/")[1]) as home:
            home.endEvent(home.catalog.keyspace.events.put(replace(event, end_ns=None)), T0 + 3)
    path = tmp_path / f"out.{kind}"
    status, out, err = call("export", path, *both(places), "--json")
    assert (status, err) == (0, "")
    report = json.loads(out)
    assert (report["messages"], report["missing"]) == ({"/a": 6}, {})
    assert report["events"] == (kind == "mcap")
    assert list(contents(path)) == [(serialize(String(str(n))), T0 + n) for n in range(6)]
    asked = ["--start", "1500000000.000000002", "--no-latched", "-f", "-q"]
    assert call("export", path, *both(places), *asked)[0] == 0
    asked = ["--event", "bump", "--after", "1s", "--no-latched", "-f", "-q"]
    assert call("export", path, *both(places), *asked)[0] == 0
    assert [t for _, t in contents(path)] == [T0 + n for n in (2, 3, 4, 5)]
    for option in (("--start", "1500000000"), ("--event", "bump")):
        status, _, err = call("export", path, *both(places), *option, "-f")
        assert (status, "--no-latched" in err) == (2, True)


@pytest.mark.parametrize("option", ["--explain", "--allow-writes"])
def test_what_asks_one_store_is_refused(call, option):
    status, _, err = call("query", "SELECT * FROM a", "--store", "home", option)
    assert status == 2
    assert option in err
