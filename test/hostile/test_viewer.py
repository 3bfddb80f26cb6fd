# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Changed HTTP requests of the viewer, as bytes on a socket."""

from __future__ import annotations

import contextlib
import re
import socket
from urllib.parse import quote

import pytest
from hostile.inputs import Refused
from hostile.mutate import NUMBERS, changed_bytes, changed_text
from hostile.test_statements import WORDS, statements
from mapping.room import T0, Drive
from viewers import running_viewer

from cassandra_ros.viewing.routes import ROUTES
from cassandra_ros.viewing.viewer_settings import ClientLimits

LIMITS = ClientLimits(head_sec=0.3, idle_sec=0.3, stalled_sec=30.0)
SECONDS = T0 // 10**9
ANSWER_SEC = 180.0
VALUES = {
    "q": [*statements(), ""],
    "topic": ["/tf", "/odom", "/scan", "/none", ""],
    "topics": ["/tf,/odom", "/scan", ""],
    "nodes": ["a", ""],
    "runs": ["a", "5", ""],
    "where": ["/odom: pose.pose.position.x > 1", "x"],
    "position": ["", "AAAA"],
    "key": [str(T0 + 10**9), "nan", "2014-05-13T16:53:20Z"],
    "nearest": ["before", "after", "either", "x"],
    "compression": ["none", "lz4", "bz2", "zstd", "x"],
    "polygon": ["0,0 1,0 1,1", "x", "0,0"],
    "frame": ["odom", "map", "x"],
    "robot": ["base", "x"],
    "odom": ["odom"],
    "name": ["a", "../../x"],
    "resolution": ["0.05", "1e-9", "1e9", "0"],
}
KINDS = {
    "time": [str(SECONDS), str(T0), str(SECONDS + 3), "-1", "1e400", "2014-05-13T16:53:20Z"],
    "count": ["0", "1", "100", "999999", *map(str, NUMBERS)],
    "number": ["0", "1.5", "-1e300", "nan", "1e400"],
    "flag": ["", "true", "0", "x"],
    "text": ["", "x"],
    "texts": ["", "a,b"],
    "lines": ["", "x"],
}
HEADERS = (
    "Connection: close\r\n",
    "Range: bytes=0-99\r\n",
    "Range: bytes=-1,5-,99999999999999999999-\r\n",
    "If-None-Match: *\r\n",
    'If-Range: "x"\r\n',
    "Accept-Encoding: gzip, br\r\n",
    "Host: evil.example\r\n",
    "Origin: http://evil.example\r\n",
    "Sec-Fetch-Site: cross-site\r\n",
    "Cookie: token=x; a=\x00\r\n",
    "Authorization: Bearer x\r\n",
    "Transfer-Encoding: chunked\r\n",
    "Content-Length: 5\r\n",
    "Content-Length: -1\r\n",
    "Expect: 100-continue\r\n",
    "Upgrade: websocket\r\nConnection: Upgrade\r\n",
    f"X: {'y' * 9000}\r\n",
)
PATHS = ("/", "/index.html", "/look.html", "/../../etc/passwd", "/studio/%2e%2e/x", "//", "/%00")


def request(chance, port):
    """Return a request of a route with parameters, of which some are changed, as bytes."""
    route = chance.choice(ROUTES)
    words = []
    for parameter in route.parameters:
        if parameter.required or chance.random() < 0.4:
            real = chance.choice(VALUES.get(parameter.name, KINDS[parameter.kind]))
            text = changed_text(chance, real, WORDS) if chance.random() < 0.2 else real
            words.append(f"{parameter.name}={quote(text.encode('utf-8', 'surrogateescape'))}")
    path = route.path if chance.random() < 0.9 else chance.choice(PATHS)
    method = chance.choice(("GET", "GET", "GET", "GET", "HEAD", "POST", "PUT", "OPTIONS", "X"))
    more = "".join(chance.choices(HEADERS, k=chance.choice((0, 0, 1, 2))))
    head = f"{method} {path}?{'&'.join(words)} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n"
    data = f"{head}Connection: close\r\n{more}\r\n".encode("utf-8", "surrogateescape")
    return changed_bytes(chance, data) if chance.random() < 0.3 else data


@contextlib.contextmanager
def viewer_of(store):
    with running_viewer(store, limits=LIMITS, allow_writes=True) as viewer:
        yield viewer


@pytest.mark.suite("all", "thousands of requests")
def test_http_requests(give, fresh):
    with fresh() as store:
        Drive().store(store, ("/tf", "/tf_static", "/odom", "/scan"), "a")

        def attempt(viewer, chance):
            data = request(chance, viewer.port)
            with socket.create_connection(("127.0.0.1", viewer.port), ANSWER_SEC) as sock:
                sock.sendall(data)
                answer = b""
                with contextlib.suppress(ConnectionResetError):
                    while part := sock.recv(1 << 20):
                        answer = (answer + part)[:4096]
            if not answer:
                raise Refused("closed")
            found = re.match(rb"HTTP/\d\.\d (\d{3}) ", answer)
            assert found, (data[:2000], answer[:2000])
            status = int(found[1])
            assert status != 500, (data[:2000], answer[:2000])
            if status >= 400:
                raise Refused(str(status))

        give("HTTP requests", 100, attempt, within=lambda: viewer_of(store))
