# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements over HTTP, as the page Ask and other programs send them."""

from __future__ import annotations

import math
import threading

import pytest
from geometry_msgs.msg import Twist, Vector3
from std_msgs.msg import Duration, Float64, Int64, String, UInt8MultiArray
from viewers import running_viewer
from viewing.test_timeline import add

from cassandra_ros.topics.overview.envelopes import EnvelopeReader
from cassandra_ros.topics.query_result import QueryResult
from cassandra_ros.viewing import ask_routes

SEC = 10**9
T0 = 1_500_000_000 * SEC


@pytest.fixture(scope="module")
def viewer(fresh):
    with fresh() as store:
        drive = store.addTopic("/cmd", nodeID="husky")
        for n in range(25):
            drive.addData(Twist(linear=Vector3(x=n / 4, y=-n)), key=T0 + n * SEC)
        odd = store.addTopic("/odd")
        for n, value in enumerate([1.5, math.nan, math.inf, -math.inf]):
            odd.addData(Float64(value), key=T0 + n)
        store.addTopic("/large").addData(Int64(2**53 + 1), key=T0)
        store.addTopic("/bytes").addData(UInt8MultiArray(data=bytes(range(200))), key=T0)
        store.addTopic("/text").addData(String("<b>é</b>" * 30), key=T0)
        lag = Duration()
        lag.data.secs = -2
        store.addTopic("/lag").addData(lag, key=T0)
        named = store.addTopic("/named", key_format="manual", msg_type="std_msgs/Int64")
        named.addData(Int64(4), "four")
        with running_viewer(store) as running:
            running.store = store
            yield running


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """Plots are complete at once, on a busy machine too, where no other time is asked for."""
    monkeypatch.setattr(ask_routes, "BUDGET_SEC", 600.0)


def pages(viewer, **asked):
    """All rows of a statement, and their times, page by page."""
    rows, times, after, count = [], [], "", 0
    while count == 0 or after:
        page = viewer.get("/api/query", after=after, **asked)
        assert len(page["rows"]) <= asked.get("limit", 200)
        rows, times, after = rows + page["rows"], times + page["times"], page["after"]
        count += 1
    return rows, times, count


def test_rows_come_page_by_page_with_their_times(viewer):
    statement = "select linear.x, linear.y from cmd where linear.x > 1"
    rows, times, count = pages(viewer, q=statement, limit=7)
    assert rows == [[n / 4, float(-n)] for n in range(5, 25)] and count == 3
    assert times == [str(T0 + n * SEC) for n in range(5, 25)]
    page = viewer.get("/api/query", q="select * from cmd limit 1")
    assert page["columns"][:2] == ["KEY", "linear.x"] and page["kinds"][:2] == ["time", "float64"]
    assert page["rows"][0][0] == str(T0) and page["after"] == ""
    groups = "select time(10s) as t, count(*), max(linear.x) from cmd group by t"
    rows, times, _ = pages(viewer, q=groups, limit=2)
    assert rows == [
        [str(T0 + s * SEC), c, m] for s, c, m in ((0, 10, 2.25), (10, 10, 4.75), (20, 5, 6.0))
    ]
    assert times == [row[0] for row in rows]
    rows, times, _ = pages(viewer, q="select NODE, count(*) from cmd group by NODE")
    assert (rows, times) == ([["husky", 25]], [None])
    assert pages(viewer, q="select linear.x from cmd where linear.x > 99") == ([], [], 1)


def test_a_window_chooses_messages_but_of_no_group(viewer):
    ends = {"start": str(T0 + 3 * SEC), "end": "2017-07-14T02:40:05Z"}
    assert pages(viewer, q="select linear.y from cmd", **ends)[0] == [[-3.0], [-4.0], [-5.0]]
    assert pages(viewer, q="select linear.y from cmd where linear.y < -3 or linear.y > 0", **ends)[
        0
    ] == [
        [-4.0],
        [-5.0],
    ]
    assert pages(viewer, q="select count(*) from cmd", **ends)[0] == [[25]]
    assert pages(viewer, q="select data from named", **ends)[0] == [[4]]
    count = {"q": "select count(*) from cmd"}
    assert pages(viewer, **count, nodes="husky,other")[0] == [[25]]
    assert pages(viewer, **count, nodes="one,other")[0] == [[0]]
    assert pages(viewer, **count, nodes="other")[0] == [[0]]


def test_values_lose_nothing(viewer):
    assert pages(viewer, q="select data from odd")[0] == [[1.5], ["nan"], ["inf"], ["-inf"]]
    assert pages(viewer, q="select data from large")[0] == [[str(2**53 + 1)]]
    assert pages(viewer, q="select data from lag")[0] == [["-2000000000"]]
    (whole,) = pages(viewer, q="select data from bytes")[0]
    (cut,) = pages(viewer, q="select data from bytes", cut=3)[0]
    assert len(whole[0]) == 268 and cut == [{"first": "AAEC", "of": 200}]
    assert pages(viewer, q="select data from text", cut=3)[0] == [[{"first": "<b>", "of": 240}]]
    assert pages(viewer, q="select KEY, data from named")[0] == [["four", 4]]


def test_what_is_wrong_says_where(viewer):
    status, problem = viewer.fail("/api/query", q="select linear.z, lineer.x from cmd")
    assert (status, problem["error"], problem["position"]) == (400, "InvalidQuery", 17)
    assert problem["text"].splitlines()[-1] == " " * 19 + "^"
    assert viewer.fail("/api/plot", q="select lineer.x from cmd")[1]["position"] == 7
    for path in ("/api/query", "/api/plot", "/api/explain"):
        assert viewer.fail(path, q="select x from nowhere")[1]["position"] == 14
        status, problem = viewer.fail(path, q="delete from cmd where linear.x > 1")
        assert status == 400 and "changes what is stored" in problem["text"]
        assert viewer.fail(path, q="select linear.x from cmd", runs="none such")[0] == 404
        assert viewer.get(path, q="select linear.x from cmd", nodes="husky,b")
        assert viewer.fail(path)[0] == 400
    assert viewer.fail("/api/query", q="select linear.x from cmd", after="x")[0] == 400
    assert viewer.fail("/api/plot", q="select linear.x from cmd", pixels=10**6)[0] == 400
    assert viewer.fail("/api/plot", q="select linear.x from cmd", start=9, end=3)[0] == 400
    assert viewer.store.getTopic("/cmd").countTopicData() == 25


def test_the_plan_is_told(viewer):
    plan = viewer.get("/api/explain", q="select KEY from cmd where linear.x > 5")
    assert plan["server"] == ["linear.x > 5 (filter)"] and plan["rows_returned"] == 4
    assert plan["text"] == str(viewer.store.explainCQL("select KEY from cmd where linear.x > 5"))


def test_completion_knows_the_store(viewer):
    def offered(text):
        return [offer["text"] for offer in viewer.get("/api/complete", q=text)["offers"]]

    assert offered("select * from c") == ["/cmd"]
    assert (
        offered("select * from cmd where NODE = ")
        == ["'husky'"] + offered("select * from cmd where NODE = ")[1:]
    )
    found = viewer.get("/api/complete", q="select lin from cmd", at=10)
    assert found["start"] == 7
    assert found["offers"][0] == {"text": "linear.x", "kind": "field", "note": "float64"}


def test_a_plot_is_ends_of_pixels(viewer):
    found = viewer.get("/api/plot", q="select linear.x, linear.y from cmd", pixels=1000)
    x, y = found["columns"]
    assert (x["name"], x["unit"]) == ("linear.x", "m/s") and found["complete"]
    assert x["low"] == [n / 4 for n in range(25)] and x["high"] is None
    assert found["times"] == [str(T0 + n * SEC) for n in range(25)] and found["rows"] == [1] * 25
    assert (found["how"], found["breaks"], found["left_out"]) == ("", [], [])
    coarse = viewer.get("/api/plot", q="select linear.y from cmd", pixels=4)
    low, high = coarse["columns"][0]["low"], coarse["columns"][0]["high"]
    assert len(low) <= 4 and min(low) == -24 and max(high) == 0 and sum(coarse["rows"]) == 25
    part = viewer.get(
        "/api/plot", q="select linear.y from cmd", start=T0 + 5 * SEC, end=T0 + 7 * SEC
    )
    assert set(part["columns"][0]["low"]) >= {-5.0, -6.0, -7.0} and len(part["times"]) <= 5
    assert int(part["start"]) <= T0 + 5 * SEC and int(part["end"]) >= T0 + 7 * SEC
    odd = viewer.get("/api/plot", q="select data from odd")
    assert odd["columns"][0]["low"] == [1.5, None, None, None]
    assert viewer.get("/api/plot", q="select data from text")["columns"] == []


def test_a_plot_that_is_not_complete_says_how_and_goes_on(viewer):
    asked = {"q": "select linear.y from cmd where linear.x >= 0", "seconds": 0, "pixels": 25}
    found = viewer.get("/api/plot", **asked)
    while not found["complete"]:
        assert "%" in found["how"] and found["share"] < 1
        found = viewer.get("/api/plot", **asked)
    assert sum(found["rows"]) == 25


def test_a_browser_that_goes_away_ends_the_reading(viewer, monkeypatch):
    ended, begun = threading.Event(), threading.Event()

    def endless(result, *arguments):
        begun.set()
        try:
            while True:
                result._watch()
                ended.wait(0.01)
        finally:
            ended.set()

    monkeypatch.setattr(QueryResult, "_read_together", endless)
    monkeypatch.setattr(EnvelopeReader, "read", endless)
    for path in ("/api/query", "/api/explain", "/api/plot"):
        begun.clear()
        ended.clear()
        connection = viewer.connect()
        connection.request("GET", f"{path}?q=select+linear.x+from+cmd+where+linear.y+%3E+1")
        assert begun.wait(180)
        connection.close()
        assert ended.wait(180), path


def test_several_runs_are_chosen_by_name_or_id(viewer):
    for writer, name in ((71, "one"), (72, "two"), (73, "three")):
        add(viewer.store, "/runs", [T0 + writer, T0 + SEC + writer], writer=writer, name=name)
    for runs, count in (
        ("one,two", 4),
        ("71,72", 4),
        ("one,73", 4),
        ("72", 2),
        ("one", 2),
        ("", 6),
    ):
        asked = {"q": "select count(*) from /runs", "runs": runs}
        assert viewer.get("/api/query", **asked)["rows"] == [[count]]
        asked["q"] = "select data from /runs"
        assert sum(viewer.get("/api/plot", **asked)["rows"]) == count
    status, problem = viewer.fail("/api/query", q="select data from /runs", runs="one,nobody")
    assert status == 404 and "there is no run 'nobody'" in str(problem)


def test_names_that_are_not_stored_are_told_with_similar_ones(viewer):
    asked = {"q": "select linear.x from cmd where NODE = 'huskey'"}
    (hint,) = viewer.get("/api/query", **asked)["hints"]
    assert "of robot 'huskey'; did you mean husky?" in hint
    found = viewer.get("/api/query", q="select count(*) from cmd where RUN = 'nope'")
    assert found["rows"] == [[0]] and "there is no run 'nope'" in found["hints"][0]
    assert viewer.get("/api/query", q="select linear.x from cmd")["hints"] == []
