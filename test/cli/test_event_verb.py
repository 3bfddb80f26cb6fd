# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag event: add, list, end, delete."""

from __future__ import annotations

import json

import pytest

from cassandra_ros.store.tables.registry import Run

SEC = 10**9
T0 = 1_500_000_000 * SEC


def test_an_event_from_its_addition_to_its_deletion(rosCas, call):
    status, out, err = call(
        *("event", "add", "door open", "--start", "2017-07-14T02:40:00Z", "--node-id", "husky"),
        *("--label", "site=lab", "--value", "angle=1.5", "--value", "side=left", "--json"),
    )
    assert (status, err) == (0, "")
    added = json.loads(out)
    assert added["start_ns"] == T0 and added["end_ns"] is None and added["lasts"]
    assert added["values"] == {"angle": 1.5, "side": "left"}
    (event,) = rosCas.events("door open")
    assert (event.key, event.node, event.labels) == (added["key"], "husky", {"site": "lab"})
    _, out, _ = call("event", "list")
    assert out.splitlines()[0].split() == "event robot start end labels values key".split()
    row = "door open  husky  2017-07-14T02:40:00.000Z  lasts"
    assert " ".join(row.split()) in " ".join(out.split())
    assert "angle=1.5, side=left" in out
    assert call("event", "end", event.key, "--end", "1500000005.5")[0] == 0
    assert next(rosCas.events()).end_ns == T0 + 5_500_000_000
    status, out, err = call("event", "delete", "door open", "--dry-run")
    assert (status, out) == (0, "1 event would be deleted\n")
    status, out, err = call("event", "delete", "door open")
    assert status == 1 and "confirm it with --yes" in err
    assert call("event", "delete", "door open", "-y") == (0, "1 event is deleted\n", "")
    assert call("event", "list") == (0, "no event is stored\n", "")
    assert call("event", "list", "bump") == (0, "there is no such event\n", "")


def test_events_are_chosen_by_pattern_time_and_robot(rosCas, call):
    for n, name in enumerate(["bump 1", "bump 2", "door", "bump 3"]):
        rosCas.addEvent(name, T0 + n * SEC, T0 + n * SEC, nodeID="a" if n % 2 else "b")

    def listed(*words):
        return [event["name"] for event in json.loads(call("event", "list", *words, "--json")[1])]

    assert listed("bump%", "--like") == ["bump 1", "bump 2", "bump 3"]
    assert listed("bump%") == []
    assert listed("--start", "1500000001", "--end", "1500000002") == ["bump 2", "door"]
    assert listed("--node-id", "b") == ["bump 1", "door"]
    assert listed("-n", "1") == ["bump 1"]
    assert call("event", "delete", "bump%", "--like", "-y", "--end", "1500000001")[1].startswith(
        "2"
    )
    assert listed() == ["door", "bump 3"]
    door = next(rosCas.events("door"))
    assert call("event", "delete", door.key, "-yq") == (0, "", "")
    assert listed() == ["bump 3"]


@pytest.mark.parametrize(
    ("words", "status", "reason"),
    [
        (["add"], 2, "add needs the name"),
        (["add", "e"], 2, "add needs --start"),
        (["add", "e", "--start", "2", "--end", "1"], 1, "is after --end"),
        (["add", "e", "--start", "soon"], 1, "--start"),
        (["add", "e", "--start", "2", "--label", "x"], 2, "NAME=VALUE"),
        (["end"], 2, "end needs the name or the key"),
        (["end", "e"], 1, "there is no event 'e'"),
        (["delete"], 2, "delete needs the name"),
        (["delete", "e", "-y"], 1, "there is no event 'e'"),
    ],
)
def test_wrong_usage_says_so(rosCas, call, words, status, reason):
    found, out, err = call("event", *words)
    assert (found, out) == (status, "")
    assert reason in err
    assert list(rosCas.events()) == []


def test_a_robot_or_run_deletes_its_own_events_only(rosCas, call):
    run = Run("husky", 9, "recording", name="monday")
    rosCas.catalog.keyspace.side_tables.make()
    rosCas.catalog.keyspace.registry.put_run(run)
    for n, options in enumerate(
        ({}, {"nodeID": "husky"}, {"nodeID": "husky", "run": "monday"}, {"nodeID": "jackal"})
    ):
        rosCas.addEvent("bump", T0 + n * SEC, T0 + n * SEC, **options)

    def starts():
        return [(event.start_ns - T0) // SEC for event in rosCas.events("bump")]

    assert call("event", "delete", "bump", "--run", "monday", "-y")[0] == 0
    assert starts() == [0, 1, 3]
    assert call("event", "delete", "bump", "--node-id", "husky", "-y")[0] == 0
    assert starts() == [0, 3]
    status, _, err = call("event", "delete", "bump", "--node-id", "husky", "-y")
    assert (status, "no event 'bump' is of this robot and run alone" in err) == (1, True)
    key = next(rosCas.events("bump")).key
    assert call("event", "delete", key, "--node-id", "husky", "-y")[0] == 1
    assert starts() == [0, 3]


def test_a_value_keeps_all_its_digits_or_is_refused(rosCas, call):
    add = ("event", "add", "bump", "--start", str(T0), "--value")
    status, _, err = call(*add, "at=1368021980.238582676")
    assert status == 2 and "would become 1368021980.2385826" in err and "as a text" in err
    assert list(rosCas.events()) == []
    for value in ("at=1368021980238582676", 'at="1368021980.238582676"', "at=0.10", "at=1e3"):
        assert call(*add, value)[0] == 0
    values = [event.values["at"] for event in rosCas.events()]
    assert set(values) == {1368021980238582676, "1368021980.238582676", 0.1, 1000.0}
