# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The viewer's routes of events: who finds what, and who may add one."""

from __future__ import annotations

import pytest
from viewers import running_viewer

SEC = 10**9
T0 = 1_500_000_000 * SEC
ADD = "/api/events/add"
ONE = {"name": "a bump", "start": str(T0), "end": "1500000001.5", "node": "husky"}


@pytest.fixture
def viewer(rosCas):
    with running_viewer(rosCas, allow_writes=True) as viewer:
        yield viewer


@pytest.fixture
def reading(rosCas):
    with running_viewer(rosCas, allow_origin=("https://friend.example",)) as viewer:
        yield viewer


def names(viewer, **parameters):
    return [event["name"] for event in viewer.get("/api/events", **parameters)["events"]]


def test_events_are_found_by_time_name_and_robot(rosCas, viewer):
    assert viewer.get("/api/events") == {"events": [], "more": False}
    for n, name in enumerate(["Bump", "door", "bumper off", "<b>ump"]):
        end = None if n == 3 else T0 + n * SEC
        rosCas.addEvent(
            name, T0 + n * SEC, end, nodeID="ab"[n % 2], labels={"site": "lab"}, values={"x": [1.5]}
        )
    assert names(viewer) == ["Bump", "door", "bumper off", "<b>ump"]
    assert names(viewer, text="BUMP") == ["Bump", "bumper off"]
    assert names(viewer, name="door") == ["door"]
    assert names(viewer, nodes="a") == ["Bump", "bumper off"]
    assert names(viewer, start=T0 + SEC, end=T0 + 2 * SEC) == ["door", "bumper off"]
    assert names(viewer, start=T0 + 9 * SEC) == ["<b>ump"]
    first = viewer.get("/api/events", limit=1)
    (event,) = first["events"]
    assert first["more"] and event["start"] == str(T0) and event["end"] == str(T0)
    assert (event["labels"], event["values"]) == ({"site": "lab"}, {"x": [1.5]})
    assert viewer.get("/api/events", text="<b>")["events"][0]["end"] is None
    assert viewer.fail("/api/events", limit=10**6)[0] == 400
    assert viewer.fail("/api/events", runs="nowhere")[1]["error"] == "RunNotFound"


def test_values_come_with_all_their_digits(rosCas, viewer):
    rosCas.addEvent("bump", T0, values={"at": [T0 + 1], "n": 7, "in": {"ns": 2**63 - 1}})
    (event,) = viewer.get("/api/events")["events"]
    assert event["values"] == {"at": [str(T0 + 1)], "n": 7, "in": {"ns": str(2**63 - 1)}}


def test_an_event_is_added(rosCas, viewer):
    assert viewer.get("/api/keyspace")["allow_writes"]
    reply = viewer.ask(ADD, ONE, "POST")
    assert reply.status == 200, reply.text
    (event,) = rosCas.events("a bump")
    assert (event.start_ns, event.end_ns, event.node) == (T0, T0 + 1_500_000_000, "husky")
    assert reply.json()["key"] == event.key
    for wrong, status in (
        ({**ONE, "end": str(T0 - 1)}, 400),
        ({**ONE, "name": "x" * 300}, 400),
        ({**ONE, "start": "soon"}, 400),
        ({"name": "x", "start": str(T0)}, 400),
    ):
        reply = viewer.ask(ADD, wrong, "POST")
        assert reply.status == status, reply.text
    assert viewer.ask(ADD, ONE).status == 405
    assert viewer.ask("/api/events", {}, "POST").status == 405
    assert len(list(rosCas.events())) == 1


def test_a_viewer_that_only_reads_adds_none(rosCas, reading):
    assert not reading.get("/api/keyspace")["allow_writes"]
    reply = reading.ask(ADD, ONE, "POST")
    assert (reply.status, reply.json()["error"]) == (403, "AccessDenied")
    assert "--allow-writes" in reply.json()["text"]
    assert list(rosCas.events()) == []


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://evil.example"},
        {"Origin": "https://friend.example"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ],
)
def test_a_page_of_another_site_adds_none(rosCas, headers):
    with running_viewer(
        rosCas, allow_writes=True, allow_origin=("https://friend.example",)
    ) as viewer:
        reply = viewer.ask(ADD, ONE, "POST", **headers)
        assert reply.status == 403, reply.text
        own = {"Origin": viewer.url, "Sec_Fetch_Site": "same-origin"}
        assert viewer.ask(ADD, ONE, "POST", **own).status == 200
    assert len(list(rosCas.events())) == 1


def test_a_token_is_asked_for(rosCas):
    token = 20 * "x"
    with running_viewer(rosCas, allow_writes=True, token=token) as viewer:
        assert viewer.ask(ADD, ONE, "POST").status == 401
        assert viewer.ask(ADD, {**ONE, "token": token}, "POST").status == 200
