# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag runs, with the parameters of one, and --run of the others."""

from __future__ import annotations

import datetime
import json
import xmlrpc.client

import pytest
import rosbag
import rosgraph
import yaml
from topics.test_run_states import begin

from cassandra_ros.store.tables.context_blob import NodeGraph, RunContext
from cassandra_ros.store.tables.registry import Loss, LossKind

PARAMS = {
    "rosdistro": "noetic\n",
    "run_id": "of that day",
    "roslaunch": {"uris": {"host": "http://x"}},
    "arm": {"gains": {"p": 1.5, "i": 2}, "name": "links ☃", "empty": {}},
    "list": [1, "a", {"b": False}],
    "when": xmlrpc.client.DateTime("20260102T03:04:05"),
    "raw": xmlrpc.client.Binary(b"\x00\xff"),
}
GRAPH = NodeGraph(
    {"/scan": ["/laser"]},
    {"/scan": ["/map"]},
    {"/go": ["/map"]},
    {"/scan": "sensor_msgs/LaserScan"},
)


@pytest.fixture
def store(rosCas):
    """Two runs of one topic, with parameters and losses; the second goes on."""
    begin(rosCas, 7, "corridor").close()
    rosCas.catalog.keyspace.registry.put_context(7, "husky", RunContext(PARAMS, GRAPH))
    rosCas.catalog.keyspace.registry.put_loss(
        Loss("/n", "husky", 7, LossKind.BUFFER_FULL, 10**18, 10**18, 4)
    )
    rosCas.catalog.keyspace.registry.put_loss(
        Loss("/gone", "husky", 8, LossKind.UNHEARD, 10**18, 10**18, 0)
    )
    with begin(rosCas, 8, "yard", count=2):
        yield rosCas


def test_runs_are_listed(store, call):
    status, out, err = call("runs")
    lines = [line.split() for line in out.splitlines()]
    assert (status, err) == (0, "")
    header = "run id robot kind first last state messages lost labels"
    assert lines[0] == header.split()
    found = [(line[0], line[1], line[2], line[6], line[7]) for line in lines[-2:]]
    assert found == [
        ("corridor", "7", "husky", "ended", "5"),
        ("yard", "8", "husky", "recording", "2"),
    ]
    found = json.loads(call("runs", "--json")[1])
    assert [(run["name"], run["writer"], run["state"]) for run in found] == [
        ("corridor", 7, "ended"),
        ("yard", 8, "recording"),
    ]
    assert found[0]["stored"] == {"/n": 5} and found[0]["started"].endswith("Z")


def test_info_tells_of_losses_and_of_one_run(store, call):
    status, out, _ = call("info")
    lines = [line.split() for line in out.splitlines()]
    assert status == 0
    assert ["/n", "husky", "corridor", "4"] in [line[:4] for line in lines]
    assert ["buffer", "full"] in [line[-2:] for line in lines]
    assert ["/gone", "husky", "yard", "?"] in [line[:4] for line in lines]
    for run, count in (("corridor", "5"), ("8", "2")):
        lines = [line.split() for line in call("info", "/n", "--run", run)[1].splitlines()]
        assert ["/n", "std_msgs/Int64", "ros", "husky", count] in [line[:5] for line in lines]
    found = yaml.safe_load(call("info", "--yaml")[1])
    assert [loss["kind"] for loss in found["losses"]] == ["publisher not heard", "buffer full"]
    assert {run["name"]: run["state"] for run in found["runs"]} == {
        "corridor": "ended",
        "yard": "recording",
    }


def test_export_query_and_verify_of_one_run(store, call, tmp_path):
    bag = tmp_path / "yard.bag"
    assert call("export", bag, "--run", "yard")[0] == 0
    with rosbag.Bag(str(bag)) as opened:
        assert opened.get_message_count() == 2
    assert call("verify", bag, "--run", "yard")[0] == 0
    assert call("verify", bag)[0] == 1
    assert call("verify", bag, "--content", "--run", "yard")[0] == 0
    select = ("query", "SELECT count(*) FROM n", "--output", "csv")
    assert call(*select, "--run", "yard")[1].split() == ["count(*)", "2"]
    assert "yard" in call("query", "SELECT KEY, RUN FROM n WHERE RUN LIKE 'y%'")[1]
    status, _, err = call("export", tmp_path / "no.bag", "--run", "yart")
    assert (status, "did you mean yard?" in err) == (1, True)


def test_parameters_are_printed_and_loaded(store, call, roscore, monkeypatch):
    status, out, err = call("runs", "--params", "corridor")
    assert (status, err) == (0, "")
    found = yaml.safe_load(out)
    assert found["arm"] == PARAMS["arm"] and found["list"] == PARAMS["list"]
    assert (found["raw"], found["when"]) == (b"\x00\xff", datetime.datetime(2026, 1, 2, 3, 4, 5))
    assert yaml.safe_load(call("runs", "--params", "7", "--namespace", "/arm/gains")[1]) == {
        "p": 1.5,
        "i": 2,
    }
    found = json.loads(call("runs", "--params", "corridor", "--json")[1])
    assert (found["arm"]["gains"], found["raw"]) == ({"p": 1.5, "i": 2}, "AP8=")
    graph = yaml.safe_load(call("runs", "--params", "corridor", "--graph")[1])
    assert graph["/laser"]["publishes"] == {"/scan": "sensor_msgs/LaserScan"}
    assert graph["/map"] == {
        "publishes": {},
        "subscribes": {"/scan": "sensor_msgs/LaserScan"},
        "services": ["/go"],
    }
    monkeypatch.setenv("ROS_MASTER_URI", roscore.uri)
    master = rosgraph.Master("/test_params")
    own = master.getParam("/run_id")
    master.setParam("/arm/other", "stays")
    try:
        status, out, err = call("runs", "--params", "corridor", "--load")
        assert (status, err) == (0, "")
        assert out.startswith("6 parameters set\n")
        assert "/rosdistro, /run_id, /roslaunch/uris/host" in out
        assert master.getParam("/arm/gains") == PARAMS["arm"]["gains"]
        assert master.getParam("/arm/other") == "stays"
        assert master.getParam("/list") == PARAMS["list"]
        assert (
            master.getParam("/raw") == PARAMS["raw"] and master.getParam("/when") == PARAMS["when"]
        )
        assert master.getParam("/run_id") == own
        master.deleteParam("/arm/gains")
        out = call("runs", "--params", "corridor", "--load", "--namespace", "arm/gains/p")[1]
        assert out == "1 parameters set\n"
        assert master.getParam("/arm/gains") == {"p": 1.5}
    finally:
        for name in ("/arm", "/list", "/raw", "/when"):
            if master.hasParam(name):
                master.deleteParam(name)


def test_what_is_wrong_with_parameters(store, call, monkeypatch):
    assert "only runs that were recorded live" in call("runs", "--params", "yard")[2]
    assert "did you mean corridor" in call("runs", "--params", "coridor")[2]
    assert "no parameter '/leg'" in call("runs", "--params", "corridor", "--namespace", "/leg")[2]
    for words in (["--load"], ["--graph"], ["--namespace", "/arm"]):
        status, _, err = call("runs", *words)
        assert (status, "go with --params RUN" in err) == (2, True)
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:9")
    status, _, err = call("runs", "--params", "corridor", "--load")
    assert (status, "start roscore" in err) == (1, True)
