# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What Look gives the Studio: every message once and in order, whatever the network does."""

from __future__ import annotations

from dataclasses import replace

import genpy
import pytest
from std_msgs.msg import String
from viewers import running_viewer

from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.viewing.answers import Stream
from cassandra_ros.viewing.routes import ROUTES

COUNT = 40
SOURCE = """
const told = [];
const [{ StoreSource }, state] = await Promise.all([
  import("/modules/studio_source.js"), import("/modules/state.js")]);
const source = new StoreSource(state.read("?topics=/chatter"), (error) => told.push(error.message));
await source.open();
const topics = ["/chatter"];
"""
READ = """
const found = [];
for await (const each of source.messageIterator({ topics })) found.push(each.msgEvent.message.data);
return [found, told];
"""
BETWEEN = """
const [start, end] = [{ sec: 105, nsec: 0 }, { sec: 107, nsec: 0 }];
const found = [];
for await (const { msgEvent } of source.messageIterator({ topics, start, end })) {
  found.push([msgEvent.receiveTime.sec, msgEvent.schemaName, msgEvent.sizeInBytes]);
}
const last = await source.getBackfillMessages({ topics, time: { sec: 110, nsec: 500 } });
return [found, last.map((each) => each.message.data)];
"""
INTERRUPTED = """
const reading = source.messageIterator({ topics, consumptionType: "partial" });
const waiting = reading.next();
while (!told.length) await new Promise((resolve) => setTimeout(resolve, 20));
source.interrupt();
try {
  await waiting;
} catch (error) {
  return [error.name, told];
}
"""


def inside(script):
    return f"return (async () => {{ {SOURCE} {script} }})();"


class Faults:
    """Answers /api/messages; what ``coming`` holds becomes of the next answers."""

    def __init__(self):
        self.coming = []
        (self._route,) = (route for route in ROUTES if route.path == "/api/messages")
        mine = replace(self._route, answer=self.answer)
        self.routes = tuple(mine if route is self._route else route for route in ROUTES)

    def answer(self, call):
        fault = self.coming.pop(0) if self.coming else ""
        if fault == "away":
            raise StoreUnavailable("the store is away for a moment")
        answer = self._route.answer(call)
        return Stream(self.cut(answer.chunks), answer.content_type) if fault == "cut" else answer

    def cut(self, chunks):
        for chunk in chunks:
            yield chunk[: len(chunk) * 2 // 3]
            raise StoreUnavailable("it went away")


@pytest.fixture(scope="module")
def faults():
    return Faults()


@pytest.fixture(scope="module")
def show(window, fresh, faults, tmp_path_factory):
    """Runs a script in a page of a viewer that has no Studio, and whose answers break off."""
    with fresh() as store:
        topic = store.addTopic("/chatter", msg_type="std_msgs/String")
        for number in range(COUNT):
            topic.addData(String(f"m{number}" + "." * 500), key=genpy.Time(100 + number))
        studio = tmp_path_factory.mktemp("none")
        with running_viewer(store, faults.routes, studio=studio) as viewer:

            def show(path="/index.html"):
                window.driver.get(viewer.url + path)
                return window

            yield show
            window.driver.get("about:blank")


def test_each_message_comes_once_whatever_breaks_off(show, faults):
    expected = [f"m{number}" + "." * 500 for number in range(COUNT)]
    page = show()
    assert page.run(inside(READ)) == [expected, []]
    faults.coming = ["away", "cut", "cut"]
    found, told = page.run(inside(READ))
    assert found == expected
    assert told[0] == "the store is away for a moment"
    assert len(told) == 3
    between, last = page.run(inside(BETWEEN))
    assert between == [[sec, "std_msgs/String", 506] for sec in (105, 106, 107)]
    assert last == ["m10" + "." * 500]
    page.errors()  # a page that is cut short is told in the console, too


def test_who_goes_elsewhere_does_not_wait(show, faults):
    faults.coming = ["away"] * 9  # it would try again for a minute
    page = show()
    assert page.run(inside(INTERRUPTED)) == ["AbortError", ["the store is away for a moment"]]
    assert len(faults.coming) == 8
    faults.coming.clear()
    page.errors()


def test_without_the_studio_the_page_says_how_to_get_it(show):
    page = show("/look.html?start=100.0&end=140.0")
    text = page.wait_for("return document.getElementById('no-studio')?.innerText")
    assert "rosrun cassandra_ros viewer --install-studio" in text
    links = page.run(
        "return [...document.querySelectorAll('#no-studio a')].map((a) => a.getAttribute('href'))"
    )
    assert links[1] == "/window.bag?start=100.000000000&end=140.000000000"
    assert page.errors() == []
