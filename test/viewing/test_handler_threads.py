# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Handlers on threads: what is sent, what fails, and what ends when the client does not wait."""

from __future__ import annotations

import http.client
import itertools
import json
import threading

import pytest
from viewers import running_viewer

from cassandra_ros import errors
from cassandra_ros.errors import CassandraRosError, InvalidQuery, StoreUnavailable, TopicNotFound
from cassandra_ros.viewing import handler_threads
from cassandra_ros.viewing.answers import Bytes, StreamedBody
from cassandra_ros.viewing.application import status_of
from cassandra_ros.viewing.route import Parameter, Route

MIB = 2**20


def route(path, answer, *parameters, **options):
    return Route(path, answer, "X.", parameters, **options)


class Endless:
    """A stream without end, and what became of it."""

    def __init__(self, chunk=b"x" * MIB):
        self.chunk = chunk
        self.made = 0
        self.closed = threading.Event()

    def chunks(self):
        try:
            while True:
                self.made += 1
                yield self.chunk
        finally:
            self.closed.set()

    def answer(self, call):
        return StreamedBody(self.chunks(), "application/x-endless")


def fail(error):
    def answer(call):
        raise error

    return answer


def test_what_a_handler_returns_is_sent():
    def some():
        yield b"ab"
        yield b""
        yield b"cd"

    routes = [
        route("/api/json", lambda call: {"a": [1, None, "ü\ud800"], "ns": "1368021980238582676"}),
        route("/bytes", lambda call: Bytes(b"\x00\xff", "image/png", {"X-Width": "7"})),
        route("/stream", lambda call: StreamedBody(some(), "text/plain", {"X-Total": "4"})),
        route("/none", lambda call: StreamedBody(iter(()), "text/plain")),
    ]
    with running_viewer(None, routes) as viewer:
        assert viewer.get("/api/json")["ns"] == "1368021980238582676"
        found = viewer.ask("/bytes")
        assert (found.data, found.headers["Content-Type"]) == (b"\x00\xff", "image/png")
        assert found.headers["X-Width"] == "7"
        found = viewer.ask("/stream")
        assert (found.data, found.headers["X-Total"]) == (b"abcd", "4")
        assert viewer.ask("/stream", method="HEAD").headers["X-Total"] == "4"
        assert viewer.ask("/none").data == b""
        found = viewer.ask("/api/json", method="POST", body="{}")
        assert (found.status, found.headers["Allow"]) == (405, "GET,HEAD")
        assert found.json()["text"] == "/api/json takes GET,HEAD, not POST"
        found = viewer.ask("/api/none")
        assert (found.status, found.json()["error"]) == (404, "HTTPNotFound")
        assert "no /api/none; /api/openapi.json" in found.json()["text"]
        assert "/none.html" in viewer.ask("/none.html").text


def test_nan_is_never_sent_as_json():
    with running_viewer(None, [route("/api/nan", lambda call: [float("nan")])]) as viewer:
        assert viewer.ask("/api/nan").status == 500


def subclasses(kind):
    return {kind}.union(*map(subclasses, kind.__subclasses__()))


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (errors.InvalidOption("no"), 400),
        (errors.InvalidKey("no"), 400),
        (TopicNotFound("no"), 404),
        (errors.RunNotFound("no"), 404),
        (errors.KeyspaceNotFound("no"), 404),
        (StoreUnavailable("no"), 503),
        (errors.LoginFailed("no"), 503),
        (errors.AccessDenied("no"), 403),
        (errors.UnsupportedSchema("no"), 500),
    ],
    ids=lambda value: type(value).__name__,
)
def test_errors_have_the_status_of_whose_fault_it_is(error, status):
    assert status_of(error) == status


def test_errors_are_told_as_json():
    query = InvalidQuery("select x from /a", 7, "topic /a has no field x")
    routes = [route("/api/query", fail(query)), route("/file", fail(TopicNotFound("no topic /x")))]
    with running_viewer(None, routes) as viewer:
        status, told = viewer.fail("/api/query")
        assert (status, told["error"], told["position"]) == (400, "InvalidQuery", 7)
        assert told["text"] == str(query)
        assert told["statement"] == "select x from /a"
        assert viewer.fail("/file") == (404, {"error": "TopicNotFound", "text": "no topic /x"})
        assert viewer.fail("/api/query", nothing=1)[1]["error"] == "InvalidOption"
    for kind in subclasses(CassandraRosError) - {InvalidQuery}:
        assert 400 <= status_of(kind("no")) <= 503


def test_a_stream_that_fails_tells_it_before_its_first_chunk_and_is_cut_behind():
    def broken(chunks):
        yield from chunks
        raise StoreUnavailable("it is away")

    routes = [
        route("/early", lambda call: StreamedBody(broken([]))),
        route("/late", lambda call: StreamedBody(broken([b"x" * 1000]))),
    ]
    with running_viewer(None, routes) as viewer:
        found = viewer.ask("/early")
        assert (found.status, found.json()["text"]) == (503, "it is away")
        with pytest.raises((http.client.IncompleteRead, ConnectionError)):
            viewer.ask("/late")
        assert viewer.ask("/early").status == 503  # the viewer goes on


def test_a_stream_that_the_end_cut_off_does_not_look_complete():
    def chunks(call):
        yield b"x"
        call.gone.wait(180)

    routes = [route("/listens", lambda call: StreamedBody(chunks(call)))]
    with running_viewer(None, routes) as viewer:
        connection = viewer.connect()
        connection.request("GET", "/listens")
        reply = connection.getresponse()
        assert reply.read(1) == b"x"
    with pytest.raises((http.client.IncompleteRead, ConnectionError)):
        reply.read()
    connection.close()


def test_a_stream_is_made_as_it_is_taken_and_closed_when_the_browser_goes():
    endless = Endless()
    routes = [route("/endless", endless.answer), route("/api/one", lambda call: 1)]
    with running_viewer(None, routes, threads=1) as viewer:
        connection = viewer.connect()
        connection.request("GET", "/endless")
        answer = connection.getresponse()
        assert answer.read(10) == b"x" * 10
        for _ in range(50):  # who waits for a slow browser keeps no thread
            assert viewer.get("/api/one") == 1
        assert endless.made < 40
        assert not endless.closed.is_set()
        connection.close()
        answer.close()
        assert endless.closed.wait(180)


def test_a_handler_learns_that_its_client_does_not_wait():
    begun, ended = threading.Event(), threading.Event()

    def waits(call):
        begun.set()
        if call.gone.wait(180):
            ended.set()
        return 1

    with running_viewer(None, [route("/api/wait", waits)]) as viewer:
        connection = viewer.connect()
        connection.request("GET", "/api/wait")
        assert begun.wait(180)
        assert not ended.is_set()
        connection.close()
        assert ended.wait(180)


def test_no_more_handlers_run_at_once_than_there_are_threads():
    running, most, lock = [], [], threading.Lock()
    both = threading.Barrier(2)

    def counted(call):
        with lock:
            running.append(1)
            most.append(len(running))
        both.wait(180)
        with lock:
            running.pop()
        return 1

    with running_viewer(None, [route("/api/n", counted)], threads=2) as viewer:
        asking = [threading.Thread(target=viewer.get, args=["/api/n"]) for _ in range(6)]
        for thread in asking:
            thread.start()
        for thread in asking:
            thread.join()
    assert max(most) == 2
    assert len(most) == 6


class Kept:
    """Something that a handler keeps for later calls."""

    closed: list = []

    def __init__(self, settings):
        self.number = next(Kept.numbers)

    numbers = itertools.count(1)

    def close(self):
        Kept.closed.append(self.number)


def test_the_end_closes_streams_handlers_and_what_was_kept():
    endless, begun = Endless(), threading.Event()

    def waits(call):
        begun.set()
        call.gone.wait(180)
        return call.cached_by_viewer(Kept).number

    routes = [route("/endless", endless.answer), route("/api/wait", waits)]
    with running_viewer(None, routes) as viewer:
        connections = [viewer.connect(), viewer.connect()]
        for connection, path in zip(connections, ("/endless", "/api/wait")):
            connection.request("GET", path)
        assert connections[0].getresponse().read(1) == b"x"
        assert begun.wait(180)
    assert endless.closed.is_set()
    assert Kept.closed == [1]
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("viewer")]
    for connection in connections:
        connection.close()


@pytest.mark.suite("all", "it waits for seconds")
def test_the_end_waits_for_no_handler_that_does_not_listen(connect, keyspace, monkeypatch):
    monkeypatch.setattr(handler_threads, "PATIENCE_SEC", 0.05)
    raised, begun = [], threading.Event()

    def deaf(call):
        try:
            while True:
                call.store.getKeyspaces()
                begun.set()
        except CassandraRosError as exc:
            raised.append(exc)
            raise

    with connect(keyspace=keyspace) as store:
        with running_viewer(store, [route("/api/deaf", deaf)]) as viewer:
            connection = viewer.connect()
            connection.request("GET", "/api/deaf")
            assert begun.wait(180)
        connection.close()
        assert len(raised) == 1


def test_a_parameter_reaches_its_handler_as_it_was_written():
    def echo(call):
        return {
            "topics": call.texts("topics"),
            "where": call.lines("where"),
            "at": call.time_ns("at"),
        }

    parameters = (
        Parameter("topics", "texts", "T."),
        Parameter("where", "lines", "W."),
        Parameter("at", "time", "A."),
    )
    with running_viewer(None, [route("/api/echo", echo, *parameters)]) as viewer:
        given = {"topics": ["/a,/ü", "/c"], "where": ["/a: x > 1, y", "/b: s = '&%'"], "at": "1.5"}
        assert viewer.get("/api/echo", **given) == {
            "topics": ["/a", "/ü", "/c"],
            "where": given["where"],
            "at": 1_500_000_000,
        }
        assert json.loads(viewer.ask("/api/echo?topics=%2Fa%2C%2Fb").data)["topics"] == ["/a", "/b"]
        # The user has selected all but a few of them.
        many = [f"/robot_{n}/camera/image" for n in range(500)]
        assert viewer.get("/api/echo", topics=",".join(many))["topics"] == many
