# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the viewer's API answers of a recording of a day, and how long that takes."""

from __future__ import annotations

import http.client
import json
import time
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any, Callable, Mapping
from urllib.parse import urlencode

from suite.day import DAY_NS
from suite.messages import START_NS
from suite.results import Results, quartiles

EXPERIMENT = "viewer"
HOUR_NS = 3600 * 10**9
NOON_NS = START_NS + 12 * HOUR_NS
FIRST_NS = 20 * 10**9
"""Length of the recording that is read before it plays, ns."""
PIXELS = 1200
PLOT = "select linear_acceleration.x from /imu"
SQL = "SELECT KEY, linear_acceleration.x FROM imu WHERE KEY >= '{}' AND KEY < '{}'"

TARGETS: dict[str, float | None] = {
    "timeline of the day": 1.0,
    "timeline of an hour of it": 1.0,
    "timeline of a second of it": 1.0,
    "timeline of a year with 10⁹ messages": 1.0,
    "open at hour 12": 3.0,
    "open at hour 12, in a browser": 3.0,
    "seek": 3.0,
    "plot of the day, first answer": 1.0,
    "plot of the day, complete": None,
    "plot of a minute, complete": 1.0,
    "a minute as an MCAP": None,
    "a small SQL statement": None,
}
"""What is measured -> seconds that it may take; None = as long as it takes."""


@dataclass
class Client:
    """Asks a viewer.

    Attributes:
        bytes: How many the last answer had.
    """

    port: int
    bytes: int = 0

    def ask(self, path: str, parameters: Mapping[str, Any], most: int | None = None) -> bytes:
        """Return an answer, or its first bytes."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=600)
        try:
            connection.request("GET", f"{path}?{urlencode(parameters)}")
            answer = connection.getresponse()
            data = answer.read(most) if most is not None else answer.read()
        finally:
            connection.close()
        if answer.status != 200:
            raise RuntimeError(f"{path}: {answer.status} {data[:500]!r}")
        self.bytes = len(data)
        return data

    def json(self, path: str, **parameters: Any) -> Any:
        """Return an answer of JSON."""
        return json.loads(self.ask(path, parameters))


def timeline(client: Client, start: int, length: int) -> dict[str, Any]:
    """Ask for what Home draws of a time range."""
    found = client.json("/api/timeline", start=start, end=start + length - 1, pixels=PIXELS)
    assert any(lane["counts"] for lane in found["lanes"])
    return found


def open_at(client: Client, t: int) -> None:
    """Ask for what Look asks when it is opened at a moment: topics, backfill, the first seconds."""
    client.json("/api/connections", time=t)
    seek(client, t)


def seek(client: Client, t: int) -> None:
    """Ask for what Look asks when its time is set: what was sent last, and what comes then."""
    assert client.ask("/api/latest", {"time": t})
    assert client.ask("/api/messages", {"start": t, "end": t + FIRST_NS})


def plot(client: Client, **window: int) -> bool:
    """Ask for the numbers of a field; return whether the answer is complete."""
    found = client.json("/api/plot", q=PLOT, pixels=PIXELS, **window)
    assert len(found["times"]) > 1, found
    return bool(found["complete"])


def plot_whole(client: Client, **window: int) -> None:
    """Ask until the answer is complete, as the page does."""
    while not plot(client, **window):
        pass


def second(t: int) -> str:
    """Return a time as SQL takes it, cut to seconds."""
    return datetime.fromtimestamp(t // 10**9, timezone.utc).strftime("%Y-%m-%d %H:%M:%S")


def measure(results: Results, client: Client, rounds: int, say: Callable[[str], None]) -> None:
    """Measure everything that needs no browser; a first round does not count."""
    hour = [NOON_NS + n * HOUR_NS // 7 for n in range(-20, 20, 3)]
    works: dict[str, Callable[[int], object]] = {
        "timeline of the day": lambda n: timeline(client, START_NS, DAY_NS),
        "timeline of an hour of it": lambda n: timeline(client, hour[n], HOUR_NS),
        "timeline of a second of it": lambda n: timeline(client, hour[n], 10**9),
        "open at hour 12": lambda n: open_at(client, NOON_NS + n * 10**9),
        "seek": lambda n: seek(client, hour[n]),
        "plot of a minute, complete": lambda n: plot_whole(
            client, start=hour[n], end=hour[n] + 60 * 10**9
        ),
        "a minute as an MCAP": lambda n: client.ask(
            "/window.mcap", {"start": hour[n], "end": hour[n] + 60 * 10**9}
        ),
        "a small SQL statement": lambda n: client.json(
            "/api/query", q=SQL.format(second(hour[n]), second(hour[n] + 10**9)), language="sql"
        ),
    }
    for what, work in works.items():
        for n in range(rounds + 1):
            timed(results, what, lambda n=n, work=work: work(n), counts=n > 0)
        told(results, what, say)


def measure_plot(results: Results, client: Client, say: Callable[[str], None]) -> None:
    """Measure the plot of the day: the viewer keeps what it has read, so it does so once."""
    begin = time.perf_counter()
    whole = plot(client)
    first = time.perf_counter()
    if not whole:
        plot_whole(client)
    results.add(EXPERIMENT, "plot of the day, first answer", "viewer", [first - begin], "s")
    took = time.perf_counter() - begin
    results.add(EXPERIMENT, "plot of the day, complete", "viewer", [took], "s")
    for what in ("plot of the day, first answer", "plot of the day, complete"):
        told(results, what, say)


def timed(results: Results, what: str, work: Callable[[], object], counts: bool = True) -> None:
    """Do something, and note how long it took."""
    begin = time.perf_counter()
    work()
    if counts:
        results.add(EXPERIMENT, what, "viewer", [time.perf_counter() - begin], "s")


def told(results: Results, what: str, say: Callable[[str], None]) -> None:
    """Print what was measured."""
    values = results.find(EXPERIMENT, what, "viewer")
    wanted = TARGETS[what]
    limit = "" if wanted is None else f", must be ≤ {wanted:g} s"
    if values:
        low, middle, high = quartiles(values)
        say(f"  {what:40} {middle:8.3f} s ({low:.3f} to {high:.3f}){limit}")


def rows(results: Results) -> list[list[str]]:
    """Return the lines of the table: work, what must be reached, what was, verdict."""
    found = []
    for what, wanted in TARGETS.items():
        values = results.find(EXPERIMENT, what, "viewer")
        must = "-" if wanted is None else f"≤ {wanted:g} s"
        if not values:
            found.append([what, must, "-", "not measured"])
            continue
        low, middle, high = quartiles(values)
        spread = f" ({low:.3g} to {high:.3g})" if len(values) > 1 else ""
        verdict = "" if wanted is None else "reached" if middle <= wanted else "missed"
        found.append([what, must, f"{middle:.3g} s{spread}", verdict])
    return found
