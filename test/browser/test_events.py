# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Events on Home: drawn as flags, found in the list, made by dragging and the key E."""

from __future__ import annotations

import json
from contextlib import ExitStack
from urllib.parse import parse_qs, urlparse

import pytest
from browser.looking import HUSKY_END, HUSKY_START, near, pixels
from browser.test_home import CANVAS, Home
from selenium.webdriver.common.keys import Keys
from viewers import running_viewer

SEC = 10**9
AXIS = slice(34, 60)
"""Rows of pixels of the axis, on which the flags are."""


@pytest.fixture
def store(stored, connect):
    """The keyspace that is looked at, with three events, which are gone afterwards."""
    with connect(keyspace=stored[0]) as store:
        store.addEvent("bump", HUSKY_START + 10 * SEC, HUSKY_START + 12 * SEC, labels={"a": "b"})
        store.addEvent("<b>door</b>", HUSKY_START + 20 * SEC, HUSKY_START + 21 * SEC)
        store.addEvent("lasts", HUSKY_START + 30 * SEC)
        yield store
        for event in list(store.events()):
            store.removeEvent(event)


@pytest.fixture
def show(window, store):
    """Open Home of a viewer of its own, at the time range of the Husky."""
    with ExitStack() as viewers:

        def opened(**settings):
            viewer = viewers.enter_context(running_viewer(store, **settings))
            window.driver.get(f"{viewer.url}/?start={HUSKY_START}&end={HUSKY_END}")
            return Home(window)

        window.errors()
        yield opened
        errors = window.errors()
        # Before the viewer ends, which the page would ask again.
        window.driver.get("about:blank")
    # An answer with an error status stands in the console, too.
    assert not [text for text in errors if "403" not in str(text)], errors


def tab(home, name):
    home.window.wait_for(
        "const tab = [...document.querySelectorAll('#tables [role=tab]')]"
        f".find(tab => tab.textContent.startsWith('{name}')); return tab && (tab.click(), true)"
    )


def await_list(home, names):
    rows = "[...document.querySelectorAll('#events tbody tr')].map(row => row.cells[0].textContent)"
    wanted = json.dumps("|".join(names))
    home.window.wait_for(f"return {rows}.join('|') === {wanted}")


def test_events_are_flags_and_a_list_that_leads_to_look(store, show):
    home = show()
    home.window.wait_for(
        f"return document.querySelector('{CANVAS}').timeline.picture.events.length === 3"
    )
    home.settle()
    colour = home.window.run(
        "return getComputedStyle(document.documentElement).getPropertyValue('--accent').trim()"
    )
    accent = tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))
    row = pixels(home.window.picture(CANVAS))[AXIS]
    columns = near(row, accent, within=12).sum(axis=0)
    for t, flagged in ((10, True), (20, True), (30, True), (15, False), (25, False)):
        x = round(home.x_of(HUSKY_START + t * SEC))
        assert (columns[x - 1 : x + 2].max() > 10) == flagged, t
    told = home.say(
        "timeline.tellOf({x: timeline.xOf(BigInt(arguments[0])), y: 90})",
        str(HUSKY_START + 11 * SEC),
    )
    assert "event bump" in told
    tab(home, "Events")
    await_list(home, ["bump", "<b>door</b>", "lasts"])
    search = home.window.run("return document.getElementById('event-search')")
    search.send_keys("BUM")
    await_list(home, ["bump"])
    href = home.window.run("return document.querySelector('#events tbody a').href")
    asked = parse_qs(urlparse(href).query)
    assert urlparse(href).path == "/look.html"
    ends = HUSKY_START + 10 * SEC, HUSKY_START + 12 * SEC
    begin = home.window.run(
        "const {parse} = await import('/modules/times.js');"
        "return [parse(arguments[0]), parse(arguments[1])].map(String)",
        asked["start"][0],
        asked["end"][0],
    )
    assert tuple(map(int, begin)) == ends
    home.window.run("document.querySelector('#events tbody button').click()")
    home.settle()
    assert home.view == ends


def test_a_dragged_range_and_e_make_an_event(store, show):
    home = show(allow_writes=True)
    start, end = HUSKY_START + 5 * SEC, HUSKY_START + 8 * SEC
    home.drag(start, end)
    span = home.say("[timeline.selection.start, timeline.selection.end].map(String)")
    home.canvas.send_keys("e")
    name = home.window.wait_for("return document.getElementById('event-name')")
    name.send_keys("from the page", Keys.ENTER)
    home.window.wait_for("return !document.getElementById('event-form')")
    (event,) = store.events("from the page")
    assert [str(event.start_ns), str(event.end_ns)] == span
    assert abs(event.start_ns - start) < SEC / 2
    home.window.wait_for(
        f"return document.querySelector('{CANVAS}').timeline.picture.events.length === 4"
    )
    # Escape leaves all as it is.
    home.canvas.send_keys("e")
    name = home.window.wait_for("return document.getElementById('event-name')")
    name.send_keys("not this", Keys.ESCAPE)
    home.window.wait_for("return !document.getElementById('event-form')")
    assert list(store.events("not this")) == []


def test_a_viewer_that_only_reads_says_so(store, show):
    home = show()
    home.drag(HUSKY_START + 5 * SEC, HUSKY_START + 8 * SEC)
    home.window.wait_for(f"return !!document.querySelector('{CANVAS}').timeline.selection")
    home.canvas.send_keys("E")
    home.window.wait_for(
        "return document.getElementById('banner')?.textContent.includes('--allow-writes')"
    )
    assert home.window.run("return document.getElementById('event-form')") is None
    assert len(list(store.events())) == 3
