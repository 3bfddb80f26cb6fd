# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A viewer of several stores: each message once, who does not answer is named, the rest refused."""

from __future__ import annotations

import contextlib
import json
import struct
import subprocess
import time

import pytest
from fleet.test_fleet import (  # noqa: F401 - proxied is a fixture
    PATIENT_SEC,
    SEC,
    T0,
    fill,
    give_up_soon,
    messages,
    outage_of,
    place,
    proxied,
    write,
)
from geometry_msgs.msg import TransformStamped
from nodes.children import PROGRAMS, Child, await_true
from sensor_msgs.msg import Image
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage
from viewers import running_viewer

from cassandra_ros import Fleet
from cassandra_ros.store.tables.registry import Loss, LossKind
from cassandra_ros.stores.copying.replicator import Replicator
from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer
from cassandra_ros.viewing.api_call import ViewedFleet
from cassandra_ros.viewing.fleet_routes import FLEET_ROUTES
from cassandra_ros.viewing.routes import ROUTES

REFUSED = {
    "/api/explain": {"q": "SELECT * FROM t"},
    "/api/map": {"topic": "/scan"},
    "/api/near": {},
    "/window.bag": {},
    "/window.mcap": {},
}
"""Some routes that one store answers."""


@pytest.fixture(scope="module")
def mixed(fresh):
    """Viewers of two stores that overlap, and of one that has all messages; and the stores."""
    with contextlib.ExitStack() as stack:
        first, second, whole = (stack.enter_context(fresh()) for _ in range(3))
        rows = messages(1, 400)
        write(whole, "/t", "ros", rows)
        write(first, "/t", "packed", rows[:300])
        write(second, "/t", "ros", rows[200:])
        image = Image(height=2, width=2, encoding="mono8", step=2, data=bytes(4))
        for store in (second, whole):
            fill(store, "/only", range(3), nodeID="jackal")
            store.addTopic("/image").addData(image, key=T0 + SEC)
            store.catalog.adder.close()
        for store, start in ((first, T0), (second, T0 + 2 * SEC)):
            for at in (store, whole):
                at.addEvent("bump", start, start + SEC)
        fleet = stack.enter_context(Fleet([place(first), place(second)]))
        yield (
            stack.enter_context(running_viewer(fleet)),
            stack.enter_context(running_viewer(whole)),
            [first, second, whole],
        )


def frames_of(reply):
    """Messages, and the JSON of all other frames, of a stream."""
    assert reply.status == 200, reply.text
    found, told, data = [], [], reply.data
    while data:
        channel, size, t = struct.unpack_from("<IIq", data)
        body, data = data[16 : 16 + size], data[16 + size :]
        if channel:
            found.append((t, body))
        else:
            told.append(json.loads(body))
    return found, told


def test_all_paths_are_those_of_one_store_and_what_one_store_answers_is_refused(mixed):
    viewer, _, stores = mixed
    assert [(r.path, r.parameters) for r in FLEET_ROUTES] == [
        (r.path, r.parameters) for r in ROUTES
    ]
    for path, asked in {**REFUSED, "/api/topics": {"keyspace": stores[0].keyspace}}.items():
        status, told = viewer.fail(path, **asked)
        assert (status, told["error"]) == (400, "InvalidOption"), path
        assert "--store-host" in told["text"]
    for path in ("/api/query", "/api/plot", "/api/complete"):
        assert "--store-host" in viewer.fail(path, q="SELECT 1", language="sql")[1]["text"]
    added = {"name": "x", "start": "1.0", "end": "2.0"}
    reply = viewer.ask("/api/events/add", added, "POST")
    assert (reply.status, "--store-host" in reply.text) == (400, True)
    described = viewer.get("/api/openapi.json")["paths"]
    assert described["/api/map"]["get"]["summary"].startswith("Refused: one store")
    assert not described["/api/query"]["get"]["summary"].startswith("Refused")


def test_home_of_several_stores_counts_each_message_once(mixed):
    viewer, one, stores = mixed
    names = [place(store) for store in stores[:2]]
    found = viewer.get("/api/keyspace")
    assert (found["stores"], found["partial"], found["missing"]) == (names, False, {})
    assert one.get("/api/keyspace")["stores"] == []
    address = {"nodes": "husky,huskj", "time": T0 + 999 * 86_400 * SEC}
    notes = [each.get("/api/notes", **address)["notes"] for each in (viewer, one)]
    assert [len(each) for each in notes] == [2, 2]
    assert "did you mean husky" in notes[0][0] and notes[0][1] == notes[1][1]
    mine, theirs = ({t["topic"]: t for t in v.get("/api/topics")["topics"]} for v in (viewer, one))
    assert mine.keys() == theirs.keys()
    for topic, entry in mine.items():
        for name in ("messages", "bytes", "start", "end", "types", "key"):
            assert entry[name] == theirs[topic][name], (topic, name)
    assert mine["/t"]["stores"] == dict(zip(names, [300, 200]))
    events = [v.get("/api/events", text="BU")["events"] for v in (viewer, one)]
    assert [e["start"] for e in events[0]] == [e["start"] for e in events[1]]
    assert len(events[0]) == 2
    assert {run["id"] for run in viewer.get("/api/runs")["runs"]} >= {
        run["id"] for run in one.get("/api/runs")["runs"] if run["messages"]
    } & {3, 7}
    assert "marks" in viewer.get("/api/marks")


def test_the_timeline_of_several_stores_is_that_of_all_messages(mixed):
    viewer, one, _ = mixed
    asked = {"topics": "/t,/only", "pixels": 40, "detail": "true"}
    mine, theirs = (v.get("/api/timeline", **asked) for v in (viewer, one))
    assert [mine[n] for n in ("first", "last", "start", "end", "cell_ns")] == [
        theirs[n] for n in ("first", "last", "start", "end", "cell_ns")
    ]
    lanes = {(lane["topic"], lane["node"]): lane for lane in mine["lanes"]}
    assert len(lanes) == len(mine["lanes"]) == len(theirs["lanes"])
    for lane in theirs["lanes"]:
        found = lanes[lane["topic"], lane["node"]]
        # Never more than there are, and exact where only one store has messages.
        assert 0 < found["messages"] <= lane["messages"]
        if lane["topic"] == "/only":
            assert (found["messages"], found["exact"], found["counts"]) == (
                *(lane["messages"], lane["exact"]),
                lane["counts"],
            )
        else:
            assert found["messages"] == lane["messages"] or not found["exact"]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_copy_is_counted_once_in_the_timeline(fresh):
    with fresh() as robot, fresh() as home:
        write(robot, "/t", "packed", messages(2, 200))
        Replicator(robot, home).copy()
        write(home, "/t", "packed", messages(3, 50))
        with Fleet([place(home), place(robot)]) as fleet, running_viewer(fleet) as viewer:
            for asked in ({}, {"pixels": 1}, {"pixels": 100, "detail": "true"}):
                lanes = viewer.get("/api/timeline", **asked)["lanes"]
                assert sum(lane["messages"] for lane in lanes) == 250, asked


STATEMENTS = [
    "SELECT KEY, NODE, linear.y FROM /t",
    "SELECT KEY, linear.y FROM /t WHERE linear.x > 2 ORDER BY KEY DESC",
    "SELECT count(*), sum(linear.y) FROM /t",
    "SELECT linear.x, count(*) FROM /t GROUP BY linear.x ORDER BY linear.x",
    "SELECT linear.y FROM /t WHERE EVENT 'bump'",
]


@pytest.mark.parametrize("statement", STATEMENTS)
def test_statements_are_answered_page_by_page_as_of_one_store(mixed, statement):
    def pages(viewer):
        after, rows, times = "", [], []
        while True:
            page = viewer.get("/api/query", q=statement, limit=37, after=after)
            rows += page["rows"]
            times += page["times"]
            after = page["after"]
            if not after:
                return rows, times, page["columns"], page["kinds"]

    viewer, one, _ = mixed
    assert pages(viewer) == pages(one)


@pytest.mark.suite("test", "the Ask page of a fleet")
def test_ask_restricts_completes_and_plots(mixed):
    viewer, one, _ = mixed
    window = {"start": str(T0 + SEC), "end": str(T0 + 4 * SEC)}
    for asked in ({}, window, {"nodes": "husky"}, {"nodes": "husky,jackal"}, {"runs": "3"}):
        rows = [v.get("/api/query", q=STATEMENTS[0], limit=999, **asked)["rows"] for v in mixed[:2]]
        assert rows[0] == rows[1] != []
        plots = [
            v.get("/api/plot", q="SELECT linear.y FROM /t", seconds=60, pixels=20, **asked)
            for v in mixed[:2]
        ]
        assert plots[0]["complete"]
        assert sum(plots[0]["rows"]) >= len(rows[0]) - 1
        assert plots[0]["columns"][0]["name"] == plots[1]["columns"][0]["name"]
    for text in ("SELECT * FROM ", "SELECT lin", "SELECT * FROM /t WHERE NODE = '"):
        offers = [v.get("/api/complete", q=text)["offers"] for v in (viewer, one)]
        assert offers[0] == offers[1]
    status, told = viewer.fail("/api/query", q="SELECT * FROM /unknown")
    assert (status, told["error"]) == (400, "InvalidQuery")


def test_look_reads_each_message_once_in_pages(mixed):
    viewer, one, _ = mixed

    def pages(v):
        after, found = {}, []
        while True:
            some, told = frames_of(v.ask("/api/messages", {"bytes": "2000", **after}))
            found += some
            end = told[-1]["end"]
            if end["next"] is None:
                return found, end
            after = {"after": end["next"]}

    mine, end = pages(viewer)
    theirs, _ = pages(one)
    assert sorted(mine) == sorted(theirs)
    assert [t for t, _ in mine] == [t for t, _ in theirs]
    assert end["missing"] == {}
    found, whole = (v.get("/api/connections") for v in (viewer, one))
    assert [t["topic"] for t in found["topics"]] == [t["topic"] for t in whole["topics"]]
    assert [t["schema"] for t in found["topics"]] == [t["schema"] for t in whole["topics"]]
    late = {"start": T0 + 2 * SEC, "end": T0 + 10**12}
    found, whole = (v.get("/api/connections", **late)["topics"] for v in (viewer, one))
    assert [t["topic"] for t in found] == [t["topic"] for t in whole] != []
    for t in (T0 + 3 * SEC, T0 + 10**12):
        latest = [frames_of(v.ask("/api/latest", {"time": str(t)}))[0] for v in (viewer, one)]
        assert latest[0] == latest[1] != []


def test_a_message_and_an_image(mixed):
    viewer, one, _ = mixed
    for nearest in ("before", "after", "either"):
        asked = {"topic": "/t", "key": str(T0 + 3 * SEC + 5), "nearest": nearest}
        mine, theirs = (v.get("/api/message", **asked) for v in (viewer, one))
        for name in ("time", "node", "size", "message"):
            assert mine[name] == theirs[name]
        assert mine["missing"] == {}
        again = viewer.get("/api/message", topic="/t", position=mine["position"])
        assert again["message"] == mine["message"]
    images = [
        v.ask("/api/image", {"topic": "/image", "key": str(T0 + SEC)}).data for v in (viewer, one)
    ]
    assert images[0] == images[1]
    assert images[0].startswith(b"\xff\xd8")
    assert viewer.fail("/api/message", topic="/t", key="5")[0] == 404


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_topic_that_has_no_common_order_is_named_and_the_others_are_shown(fresh):
    with fresh() as first, fresh() as second:
        fill(first, "/a", [1])
        fill(first, "/b", [1])
        second.addTopic("/a", key_format="manual").addData(String("x"), key="name")
        second.catalog.adder.close()
        with Fleet([place(first), place(second)]) as fleet, running_viewer(fleet) as viewer:
            for path in ("/api/topics", "/api/connections"):
                found = viewer.get(path)
                assert [topic["topic"] for topic in found["topics"]] == ["/b"]
                assert [problem["topic"] for problem in found["problems"]] == ["/a"]


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
def test_a_store_that_does_not_answer_is_in_each_answer(fresh, proxied):  # noqa: F811
    with fresh() as first, fresh() as second:
        fill(first, "/s", range(5))
        fill(second, "/s", range(3, 9))
        fill(second, "/only", range(3))
        run = str(second.getTopic("/only").first().seq >> 32)
        name = f"{proxied.host}:{proxied.port}/{second.keyspace}"
        asked = {
            **{f"/api/{path}": {} for path in ("keyspace", "topics", "runs", "marks", "events")},
            **{f"/api/{path}": {} for path in ("timeline", "connections")},
            "/api/notes": {"nodes": "nobody", "time": 1},
            "/api/query": {"q": "SELECT data FROM s"},
            "/api/plot": {"q": "SELECT KEY FROM s"},
            "/api/complete": {"q": "SELECT "},
            "/api/message": {"topic": "/s", "key": str(T0)},
        }
        with Fleet([place(first), name], answer_sec=PATIENT_SEC) as fleet:
            with running_viewer(fleet, store_pause_sec=0.5) as viewer:
                assert len(viewer.get("/api/query", **asked["/api/query"])["rows"]) == 11
                give_up_soon(fleet, name)
                proxied.freeze()
                for path, parameters in asked.items():
                    found = viewer.get(path, **parameters)
                    assert (found["partial"], list(found["missing"])) == (True, [name]), path
                assert viewer.get("/api/notes", **asked["/api/notes"])["notes"] == []
                assert len(viewer.get("/api/query", **asked["/api/query"])["rows"]) == 5
                for path in ("/api/messages", "/api/latest"):
                    found, told = frames_of(viewer.ask(path))
                    assert list(told[-1]["end"]["missing"]) == [name]
                # What only that store has is left out, and the rest is given.
                both = {"topics": "/s,/only"}
                for path in ("/api/topics", "/api/connections"):
                    found = viewer.get(path, **both)
                    assert [topic["topic"] for topic in found["topics"]] == ["/s"], path
                    assert [each["topic"] for each in found["problems"]] == ["/only"], path
                lanes = viewer.get("/api/timeline", **both)["lanes"]
                assert [(lane["topic"], lane["messages"]) for lane in lanes] == [("/s", 5)]
                for path, count in (("/api/messages", 5), ("/api/latest", 1)):
                    assert len(frames_of(viewer.ask(path, both))[0]) == count
                    assert frames_of(viewer.ask(path, {"topics": "/only"}))[0] == []
                    assert frames_of(viewer.ask(path, {"runs": run}))[0] == []
                status, told = viewer.fail("/api/message", topic="/s", key=str(T0 + 8 * SEC))
                assert (status, name in told["text"]) == (404, True)


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_a_store_that_answers_again_is_asked_again(fresh, proxied):  # noqa: F811
    """Though requests end meanwhile that began while it was away, or lost it long ago."""
    with fresh() as first, fresh() as second:
        fill(first, "/s", range(5))
        name = f"{proxied.host}:{proxied.port}/{second.keyspace}"
        with Fleet([place(first), name], answer_sec=PATIENT_SEC) as fleet:
            viewed = ViewedFleet(fleet, 600.0)
            lost = viewed.begin()
            give_up_soon(fleet, name)
            proxied.cut()
            lost.each(lost.catalogs, lambda catalog: catalog.keyspace.schema.tables(fresh=True))
            assert list(lost.missing) == [name]
            viewed.note(lost)
            unasked = viewed.begin()
            assert list(unasked.missing) == [name]
            proxied.mend()
            outage_of(fleet, name).limit_sec = PATIENT_SEC
            await_true(lambda: not FleetAnswer(fleet.stores).missing)
            time.sleep(0.1)
            for request, pause_sec in ((unasked, 600.0), (lost, 0.1)):
                viewed = ViewedFleet(fleet, pause_sec)
                viewed.note(request)
                assert viewed.begin().missing == {}


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("first_made", ["robot", "home"])
def test_pages_go_on_in_copies(fresh, first_made):
    """A replicator copies while a user looks at a result page by page, backwards."""
    with fresh() as robot, fresh() as home:
        for store in (robot, home) if first_made == "robot" else (home, robot):
            write(store, "/t", "packed", messages(9, 1) if store is home else messages(2, 50))
        with Fleet([place(home), place(robot)]) as fleet, running_viewer(fleet) as viewer:
            asked = "SELECT KEY, linear.y FROM /t ORDER BY KEY DESC"
            wanted = viewer.get("/api/query", q=asked, limit=999)["rows"]
            found, after = [], ""
            for number in range(len(wanted)):
                page = viewer.get("/api/query", q=asked, limit=7, after=after)
                found, after = found + page["rows"], page["after"]
                if number == 2:
                    Replicator(robot, home).copy()
                if not after:
                    break
            assert found == wanted
            assert len(wanted) == 51


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_moment_is_that_of_one_store_with_all(fresh):
    """Versions of a named message that came later, and transforms of another drive."""
    with fresh() as first, fresh() as second, fresh() as whole:
        for number, store in enumerate((first, second)):
            for at in (store, whole):
                moved = TransformStamped(child_frame_id=f"base{number}")
                start = T0 + number * 100 * SEC
                for n in range(5):
                    at.addTopic("/tf").addData(TFMessage([moved]), key=start + n * SEC // 5)
                at.addTopic("/map", key_format="manual").addData(String(f"v{number}"), key="m")
                at.catalog.adder.close()
            between = time.time_ns()
        with Fleet([place(first), place(second)]) as fleet, running_viewer(fleet) as viewer:
            with running_viewer(whole) as one:
                for t in (T0 + SEC, T0 + 50 * SEC, T0 + 101 * SEC, T0 + 999 * SEC, 1, between):
                    latest = [
                        frames_of(v.ask("/api/latest", {"time": str(t)}))[0] for v in (viewer, one)
                    ]
                    assert [w for _, w in latest[0]] == [w for _, w in latest[1]], t


def test_a_loss_that_has_grown_is_shown_once(fresh):
    with fresh() as first, fresh() as second:
        for store, count in ((first, 5), (second, 9)):
            fill(store, "/s", [1])
            store.catalog.keyspace.registry.put_loss(
                Loss("/s", "", 7, LossKind.BUFFER_FULL, T0, T0 + count * SEC, count)
            )
        with Fleet([place(first), place(second)]) as fleet, running_viewer(fleet) as viewer:
            marks = [m for m in viewer.get("/api/marks")["marks"] if m["kind"] == "loss"]
            assert [mark["count"] for mark in marks] == [9]


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_the_program_names_who_does_not_answer_and_refuses_what_asks_one_store(fresh, ros_env):
    away = "127.0.0.1:9/ros"
    with fresh() as first:
        fill(first, "/s", range(5))
        words = [PROGRAMS / "viewer", "--store", place(first), "--store", away]
        with Child([*words, "--port", "0"], ros_env) as process:
            line = process.await_line("http://")
            assert f"the fleet of {place(first)}, {away} is at" in line
            process.await_line(f"store {away} did not answer")
            assert process.end() == 0, process.output
        done = subprocess.run(
            [*words, "--allow-writes"], env=ros_env, capture_output=True, text=True, timeout=300
        )
        assert (done.returncode, "--allow-writes asks one store" in done.stderr) == (2, True)
