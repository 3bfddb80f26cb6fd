# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Home: what was imported stands there, and a window of it is chosen with mouse and keyboard."""

from __future__ import annotations

import json
import urllib.request
from urllib.parse import parse_qs, urlparse

import numpy as np
import pytest
import rosbag
from browser import patrol
from browser.looking import BUSY, HUSKY_END, HUSKY_START, LATER, near, pixels
from selenium.webdriver import ActionChains
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from std_msgs.msg import Float64

CANVAS = "#timeline"
TOP, ROW = 60, 24
"""Where the rows begin, and how high one is, pixels."""
ROOM_NS = 10**9


class Home:
    """The timeline in the page.

    Args:
        window: The browser, with the page.
    """

    def __init__(self, window):
        self.window = window
        self.canvas = window.wait_for(f"return document.querySelector('{CANVAS}')")
        self.settle()
        size = self.canvas.size
        self._middle = size["width"] / 2, size["height"] / 2

    def settle(self):
        """Wait until all is there that the window shows."""
        self.window.wait_for(f"return document.querySelector('{CANVAS}').dataset.state === 'ready'")

    def say(self, expression, *arguments):
        """Return what an expression about its ``timeline`` is; times as texts."""
        script = (
            f"const timeline = document.querySelector('{CANVAS}').timeline; return {expression}"
        )
        return self.window.run(script, *arguments)

    @property
    def view(self):
        """The window that is seen, ns."""
        return tuple(map(int, self.say("[String(timeline.view.start), String(timeline.view.end)]")))

    def x_of(self, ns):
        return self.say("timeline.xOf(BigInt(arguments[0]))", str(ns))

    def point(self, x, y):
        """Return an action's pointer, moved to a pixel of the canvas."""
        right, down = round(x - self._middle[0]), round(y - self._middle[1])
        return ActionChains(self.window.driver, duration=0).move_to_element_with_offset(
            self.canvas, right, down
        )

    def drag(self, start, end):
        """Drag from one time to another, in the middle of the rows."""
        y = self._middle[1]
        action = self.point(self.x_of(start), y).click_and_hold()
        for part in (0.5, 1):
            x = self.x_of(start + round((end - start) * part))
            action.move_to_element_with_offset(
                self.canvas, round(x - self._middle[0]), round(y - self._middle[1])
            )
        action.release().perform()

    def wheel(self, ns, down):
        """Turn the wheel over a time."""
        origin = ScrollOrigin.from_element(self.canvas, round(self.x_of(ns) - self._middle[0]), 0)
        ActionChains(self.window.driver).scroll_from_origin(origin, 0, down).perform()
        self.settle()

    def links(self):
        """Return the parameters of the links out of the window, by their texts."""
        found = self.window.run(
            "return Object.fromEntries([...document.querySelectorAll('#links a')].map("
            "link => [link.textContent, link.href]))"
        )
        return {text: (href, parse_qs(urlparse(href).query)) for text, href in found.items()}


def test_what_was_imported_stands_there(page, stored):
    counts = stored[1]
    home = Home(page("/"))
    rows = home.window.wait_for(
        "const rows = [...document.querySelectorAll('#tables tr')]; return rows.length > 1 && "
        "rows.map(row => [...row.cells].map(cell => cell.textContent))"
    )
    heads = rows[0]
    topic, messages = heads.index("topic"), heads.index("messages")
    told = {row[topic]: int(row[messages].replace(",", "")) for row in rows[1 : len(counts) + 1]}
    assert {topic: told.get(topic) for topic in counts} == counts
    assert HUSKY_START - 10**12 < home.view[0] <= HUSKY_START
    assert patrol.END - 10**9 < home.view[1]


def drawn(home, topic):
    """Return which columns of pixels of a topic's row are those of data, and where it begins."""
    line = "timeline.lines.find(line => line.lane?.topic === arguments[0])"
    y, left = home.say(f"[{line}.y - timeline.scrolled, timeline.size.names]", topic)
    row = pixels(home.window.picture(CANVAS))[y + TOP + 2 : y + TOP + ROW - 2]
    colour = home.window.run(
        "return getComputedStyle(document.documentElement).getPropertyValue('--data').trim()"
    )
    wanted = tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return near(row, wanted, within=12).any(axis=0), left


def test_the_timeline_is_drawn_where_messages_are(page):
    page("/").prefer("light")
    # The Husky, a gap of an hour, the patrol: a tenth of the width each way.
    home = Home(page("/", start=HUSKY_START - 300 * 10**9, end=patrol.END + 300 * 10**9))
    columns, left = drawn(home, "/tf")
    busy = np.flatnonzero(columns)
    edges = [home.x_of(ns) for ns in (HUSKY_START, HUSKY_END, patrol.START, patrol.END)]
    assert abs(busy.min() - edges[0]) <= 3
    assert abs(busy.max() - edges[3]) <= 3
    assert not columns[round(edges[1]) + 4 : round(edges[2]) - 4].any()
    assert not columns[left : round(edges[0]) - 4].any()


def test_a_window_is_chosen_by_wheel_drag_and_keys_and_leads_on(page, tmp_path):
    home = Home(page("/", start=HUSKY_START - ROOM_NS, end=HUSKY_END + ROOM_NS))
    before = home.view
    middle = (HUSKY_START + HUSKY_END) // 2
    home.wheel(middle, -400)
    after = home.view
    assert after[1] - after[0] < 0.7 * (before[1] - before[0])
    assert after[0] < middle < after[1]
    home.canvas.send_keys("-")
    home.settle()
    assert home.view[1] - home.view[0] > 1.8 * (after[1] - after[0])
    start, end = middle - 2 * 10**9, middle + 2 * 10**9
    home.drag(start, end)
    links = home.links()
    for text in ("Look", "Ask", ".bag", ".mcap"):
        chosen = links[text][1]
        pixel = (home.view[1] - home.view[0]) / 800
        assert int(chosen["start"][0]) == pytest.approx(start, abs=2 * pixel), text
        assert int(chosen["end"][0]) == pytest.approx(end, abs=2 * pixel), text
    # The link is what rosbag reads.
    href, chosen = links[".bag"]
    target = tmp_path / "window.bag"
    with urllib.request.urlopen(href, timeout=300) as answer:  # noqa: S310 (our own viewer)
        target.write_bytes(answer.read())
    with rosbag.Bag(str(target)) as bag:
        times = [t.to_nsec() for _, _, t in bag.read_messages()]
    assert len(times) > 100
    assert int(chosen["start"][0]) <= min(times) <= max(times) <= int(chosen["end"][0])


SIDES = "[...document.querySelectorAll('#periods button')].map((b) => b.textContent)"


def await_sides(home, *texts):
    home.window.wait_for(f"return JSON.stringify({SIDES}) === arguments[0]", json_text(texts))
    home.settle()


def json_text(texts):
    return json.dumps(list(texts), ensure_ascii=False, separators=(",", ":"))


def test_home_opens_where_most_messages_are_and_folds_the_others(page, bags):
    home = Home(page("/", keyspace=bags))
    before, after = "◀ 1970-01-01: 10 messages", "2026-01-01: 20 messages ▶"
    await_sides(home, before, after)
    start, end = home.view
    assert (BUSY - 10) * 10**9 < start <= BUSY * 10**9 < (BUSY + 39) * 10**9 <= end
    assert end < (BUSY + 50) * 10**9
    home.window.run("document.querySelector('#periods button').click()")
    await_sides(home, "2017-07-14: 60 messages ▶")
    start, end = home.view
    assert start <= 5 * 10**9 < 14 * 10**9 <= end < 3600 * 10**9
    # It stands in the address, and the other way leads there again.
    address = home.window.driver.current_url
    assert parse_qs(urlparse(address).query)["start"] == ["5.000000000"]
    home.window.driver.back()
    await_sides(home, before, after)
    # All of them, by the menu; and the address alone says so.
    menu = "document.querySelector('#periods select')"
    home.window.run(f"{menu}.value = -1; {menu}.dispatchEvent(new Event('change'))")
    await_sides(home)
    assert home.view[0] <= 5 * 10**9 < LATER * 10**9 <= home.view[1]
    address = home.window.driver.current_url
    home.window.driver.get("about:blank")
    home.window.driver.get(address)
    home = Home(home.window)
    assert home.view[0] <= 5 * 10**9 < LATER * 10**9 <= home.view[1]


LINES = "timeline.lines.map((line) => (line.lane ? [line.lane.topic, line.busy] : line.node))"


def test_what_has_nothing_in_view_is_below_the_others(page, bags):
    home = Home(page("/", keyspace=bags))
    # r3 has messages only in another year.
    first, later, other = (["/first", True], ["/later", True], ["/other", True])
    clock = ["/clock", False]  # of r1, in another year
    assert home.say(LINES) == ["r1", other, "r2", first, later, "r1", clock]
    home = Home(page("/", keyspace=bags, start=BUSY * 10**9, end=(BUSY + 15) * 10**9))
    idle = ["r1", clock, ["/other", False], "r2", ["/later", False]]
    assert home.say(LINES) == ["r2", first, *idle]
    home.canvas.send_keys("\ue011")  # Home
    home.window.wait_for(
        f"const {{ timeline }} = arguments[0]; return {LINES}[0] === 'r1'", home.canvas
    )
    home = Home(page("/", keyspace=bags, start=(BUSY + 25) * 10**9, end=(BUSY + 30) * 10**9))
    idle = ["r1", clock, "r2", ["/first", False]]
    assert home.say(LINES) == ["r1", other, "r2", later, *idle]


def test_a_robot_whose_messages_were_deleted_is_gone(page, keyspaces, connect):
    with keyspaces.lend() as name:
        with connect(keyspace=name) as rosCas:
            for node in ("stays", "leaves"):
                topic = rosCas.addTopic("/x", msg_type="std_msgs/Float64", nodeID=node)
                for n in range(20):
                    topic.addData(Float64(n), (LATER + n) * 10**9)
            rosCas.upkeep.delete(nodeID="leaves")
        home = Home(page("/", keyspace=name))
        home.window.wait_for("return document.querySelectorAll('#tables tbody tr').length")
        # A part of the time is asked for, too.
        home.wheel((LATER + 10) * 10**9, -400)
        robots = "[...new Set(timeline.picture.lanes.map((lane) => lane.node))]"
        assert home.say(robots) == ["stays"]
        assert not home.window.run("return document.querySelector('#menu-nodes')")
