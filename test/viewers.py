# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A viewer in a thread of a test, and what asks it as a program does: without a browser."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import threading
from dataclasses import dataclass, replace
from urllib.parse import quote, urlencode

from cassandra_ros.viewing.viewer_server import listening
from cassandra_ros.viewing.viewer_settings import ViewerSettings


@dataclass
class Reply:
    """What came back."""

    status: int
    headers: http.client.HTTPMessage
    data: bytes

    @property
    def text(self):
        return self.data.decode("utf-8")

    def json(self):
        return json.loads(self.data)


class RunningViewer:
    """A viewer that listens, on a port of its own."""

    def __init__(self, port):
        self.port = port
        self.url = f"http://127.0.0.1:{port}"

    def connect(self, timeout_sec=180.0):
        return http.client.HTTPConnection("127.0.0.1", self.port, timeout=timeout_sec)

    def ask(self, path, parameters=None, method="GET", body=None, **headers):
        """Ask for a path; what is given by name are headers, If_Range for If-Range."""
        query = f"?{urlencode(parameters, doseq=True, quote_via=quote)}" if parameters else ""
        named = {name.replace("_", "-"): text for name, text in headers.items()}
        with contextlib.closing(self.connect()) as connection:
            connection.request(method, path + query, body, named)
            answer = connection.getresponse()
            return Reply(answer.status, answer.headers, answer.read())

    def get(self, path, **parameters):
        """Ask for JSON that must be there."""
        found = self.ask(path, parameters)
        assert found.status == 200, found.text
        return found.json()

    def fail(self, path, **parameters):
        """Ask for what fails; return the status and the JSON that tells it."""
        found = self.ask(path, parameters)
        assert found.status >= 400, found.text
        return found.status, found.json()


@contextlib.contextmanager
def running_viewer(store, routes=None, **settings):
    """Run a viewer of a store or fleet, which stays open; as ``serve`` does it, in a thread."""
    manager = listening(replace(ViewerSettings(port=0), **settings), store, routes)
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="test viewer")

    thread.start()
    try:
        port = asyncio.run_coroutine_threadsafe(manager.__aenter__(), loop).result(180)
        try:
            yield RunningViewer(port)
        finally:
            ended = manager.__aexit__(None, None, None)
            asyncio.run_coroutine_threadsafe(ended, loop).result(180)
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.run_until_complete(loop.shutdown_asyncgens())
        loop.close()
