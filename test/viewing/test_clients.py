# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What clients may take: connections, time for heads, time without reading, bytes of answers."""

from __future__ import annotations

import contextlib
import http.client
import socket
import threading
import tracemalloc

import pytest
from nodes.children import await_true
from viewers import running_viewer
from viewing.test_handler_threads import MIB, Endless, route

from cassandra_ros.viewing.answers import Bytes
from cassandra_ros.viewing.viewer_settings import ClientLimits

BIG = bytes(16 * MIB)
UNHURRIED = {"head_sec": 600.0, "idle_sec": 600.0, "stalled_sec": 600.0}
"""Limits of time that no test reaches, also where the machine stands still for a while."""


@contextlib.contextmanager
def connected(viewer, count=1, head=b"", buffer=None):
    """Open connections, send the same on each, and read nothing."""
    with contextlib.ExitStack() as stack:
        found = []
        for _ in range(count):
            sock = stack.enter_context(socket.socket())
            if buffer is not None:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
            sock.settimeout(180)
            sock.connect(("127.0.0.1", viewer.port))
            sock.sendall(head)
            found.append(sock)
        yield found


def is_closed(sock):
    """Say whether the viewer has closed a connection, without waiting for it."""
    sock.settimeout(0.02)
    try:
        return sock.recv(4096) == b""
    except socket.timeout:
        return False
    except ConnectionError:
        return True


def asked_in_time(viewer, begun):
    """Ask /api/slow until a head has come in time, which a busy machine may delay."""
    while True:
        asking = viewer.connect()
        asking.request("GET", "/api/slow")
        while not begun.wait(0.2):
            if is_closed(asking.sock):
                break
        else:
            asking.sock.settimeout(180)
            return asking


def test_who_trickles_a_head_is_disconnected():
    begun, go_on = threading.Event(), threading.Event()

    def slow(call):
        begun.set()
        return int(go_on.wait(180))

    limits = ClientLimits(head_sec=0.3)
    with running_viewer(None, [route("/api/slow", slow)], limits=limits) as viewer:
        asking = asked_in_time(viewer, begun)
        with connected(viewer, 20, b"GET /api/slow HTTP/1.1\r\nHost: 127.0.0.1\r\nX-A: ") as many:
            left = list(many)

            def trickled():
                for sock in list(left):
                    with contextlib.suppress(ConnectionError):
                        sock.sendall(b"a")
                    if is_closed(sock):
                        left.remove(sock)
                return not left

            await_true(trickled)
        with connected(viewer) as (silent,):
            await_true(lambda: is_closed(silent))
        go_on.set()  # whose head came in time waits for the answer as long as it takes
        assert asking.getresponse().read() == b"1"
        asking.close()


def test_an_idle_connection_is_closed():
    limits = ClientLimits(head_sec=600.0, idle_sec=0.3)
    with running_viewer(None, [route("/api/one", lambda call: 1)], limits=limits) as viewer:
        head = b"GET /api/one HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
        with connected(viewer, head=head) as (sock,):
            assert sock.recv(4096).startswith(b"HTTP/1.1 200")
            sock.sendall(head[:9])  # nor is a head that begins late an excuse
            await_true(lambda: is_closed(sock))


def test_too_many_clients_are_told_so():
    go_on = threading.Event()
    routes = [route("/api/wait", lambda call: int(go_on.wait(180)))]
    with running_viewer(None, routes, limits=ClientLimits(clients=3, **UNHURRIED)) as viewer:
        with connected(viewer, 3) as (first, *_):
            found = viewer.ask("/api/wait")
            assert (found.status, found.headers["Connection"]) == (503, "close")
            assert "already has 3 connections: close pages" in found.text
            assert int(found.headers["Retry-After"]) > 0
            # None of those that are there is disturbed.
            first.sendall(b"GET /api/wait HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            go_on.set()
            assert first.recv(4096).startswith(b"HTTP/1.1 200")
        await_true(lambda: viewer.ask("/api/wait").status == 200)


def test_a_burst_of_clients_is_no_way_round_the_limit():
    limits = ClientLimits(clients=5, **UNHURRIED)
    with running_viewer(None, [route("/api/one", lambda call: 1)], limits=limits) as v:
        with connected(v, 40, b"GET /api/one HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n") as every:
            answers = [sock.recv(12) for sock in every]
    assert (answers.count(b"HTTP/1.1 200"), answers.count(b"HTTP/1.1 503")) == (5, 35)


def test_who_does_not_read_a_stream_is_disconnected():
    endless = Endless()
    limits = ClientLimits(stalled_sec=0.5)
    with running_viewer(None, [route("/endless", endless.answer)], limits=limits) as viewer:
        head = b"GET /endless HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
        with connected(viewer, head=head, buffer=4096):
            assert endless.closed.wait(180)


def test_answers_that_are_not_read_are_held_within_a_bound():
    limits = ClientLimits(answers_bytes=4 * len(BIG), **UNHURRIED)
    routes = [route("/big", lambda call: Bytes(BIG)), route("/api/one", lambda call: 1)]
    head = b"GET /big HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    with running_viewer(None, routes, limits=limits) as viewer:
        assert viewer.ask("/big").data == BIG
        assert viewer.ask("/big", method="HEAD").headers["Content-Length"] == str(len(BIG))
        tracemalloc.start()
        try:
            with connected(viewer, 4, head, buffer=4096):
                await_true(lambda: viewer.ask("/big", method="HEAD").status == 503)
                found = viewer.ask("/big")
                assert (found.status, found.json()["error"]) == (503, "StoreUnavailable")
                assert "already sending 67 MB to other clients, of at most 67 MB" in found.text
                assert viewer.get("/api/one") == 1  # small ones are sent all the same
                # None of them has a copy of its own.
                assert tracemalloc.get_traced_memory()[1] < len(BIG) / 2
        finally:
            tracemalloc.stop()
        await_true(lambda: viewer.ask("/big").status == 200)


def test_one_that_does_not_read_gives_back_what_it_held():
    limits = ClientLimits(answers_bytes=len(BIG), stalled_sec=0.5)
    head = b"GET /big HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
    with running_viewer(
        None, [route("/big", lambda call: Bytes(BIG))], limits=limits
    ) as viewer, contextlib.ExitStack() as clients:

        def status():
            return viewer.ask("/big", method="HEAD").status

        def is_held():
            # One more each time: a busy machine may ask when the one before it has given it back.
            clients.enter_context(connected(viewer, head=head, buffer=4096))
            return status() == 503

        await_true(is_held)
        await_true(lambda: status() == 200)


def test_a_stream_that_finds_no_room_is_refused_and_never_sent_in_part():
    endless = Endless(b"x" * 2 * MIB)
    routes = [route("/big", lambda call: Bytes(BIG)), route("/endless", endless.answer)]
    limits = ClientLimits(answers_bytes=len(BIG) + MIB, **UNHURRIED)
    with running_viewer(None, routes, limits=limits) as viewer:
        with connected(viewer, head=b"GET /big HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n", buffer=4096):
            await_true(lambda: viewer.ask("/big", method="HEAD").status == 503)
            with pytest.raises((http.client.IncompleteRead, ConnectionError)):
                viewer.ask("/endless")
            assert endless.closed.wait(180)
