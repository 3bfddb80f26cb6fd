# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What Look gives the Studio: every message once and in order, whatever the network does.

And pages of a store whose clock is that of a simulation, and whose answers are slow.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from urllib.parse import parse_qs, urlparse

import genpy
import pytest
from std_msgs.msg import String
from viewers import running_viewer

from cassandra_ros.errors import StoreUnavailable
from cassandra_ros.viewing.answers import StreamedBody
from cassandra_ros.viewing.routes import ROUTES

COUNT = 210
"""More than Ask shows at once."""
SOURCE = """
const told = [];
const [{ StoreSource }, state] = await Promise.all([
  import("/modules/studio_source.js"), import("/modules/state.js")]);
const source = new StoreSource(
  state.read("?topics=/chatter"), (error) => told.push(error.message), (note) => told.push(note));
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
return found;
"""
LATEST = """
const last = await source.getBackfillMessages({ topics, time: { sec: 110, nsec: 500 } });
return [last.map((each) => each.message.data), told];
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

# As the Studio tells it.
PLAYING = """
let time = 100_000_000_000n;
setInterval(() => parent.postMessage({ time: (time += 1n) }, location.origin), 50);
"""
COUNTED = """
return import("/modules/timeline_data.js").then(({ Lane }) => {
  const lane = new Lane("/a", "");
  lane.take({ types: [], counts: [[0, 20000001]] }, { start: 0n, step: 1n, cells: 1 });
  return lane.countAt(0n);
});
"""


def inside(script):
    return f"return (async () => {{ {SOURCE} {script} }})();"


class Faults:
    """The viewer's routes, but for what is asked of them.

    Attributes:
        coming: What becomes of the next answers that hold messages.
        installed: Whether it says that the Studio is there.
        stuck: Whether plots are never answered.
    """

    def __init__(self):
        self.coming, self.installed, self.stuck = [], False, False
        mine = {
            "/api/messages": self.messages,
            "/api/latest": self.messages,
            "/api/studio": self.studio,
            "/api/plot": self.plot,
        }
        self.routes = tuple(
            replace(route, answer=partial(mine[route.path], route.answer))
            if route.path in mine
            else route
            for route in ROUTES
        )

    def studio(self, usual, call):
        return {**usual(call), "installed": self.installed}

    def plot(self, usual, call):
        if self.stuck:
            call.gone.wait()
        return usual(call)

    def messages(self, usual, call):
        fault = self.coming.pop(0) if self.coming else ""
        if fault == "away":
            raise StoreUnavailable("the store is away for a moment")
        answer = usual(call)
        return (
            StreamedBody(self.cut(answer.chunks), answer.content_type) if fault == "cut" else answer
        )

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
    assert [[sec, kind] for sec, kind, _ in page.run(inside(BETWEEN))] == [
        [sec, "std_msgs/String"] for sec in (105, 106, 107)
    ]
    faults.coming = ["away", "cut"]
    last, told = page.run(inside(LATEST))
    assert last == ["m10" + "." * 500]
    assert len(told) == 2
    page.errors()  # a page that is cut short is told in the console, too


def test_who_goes_elsewhere_does_not_wait(show, faults):
    faults.coming = ["away"] * 9  # it would try again for a minute
    page = show()
    ended, told = page.run(inside(INTERRUPTED))
    assert (ended, set(told)) == ("AbortError", {"the store is away for a moment"})
    assert 0 < len(faults.coming) < 9  # it did not try on to the end
    faults.coming.clear()
    page.errors()


def test_without_the_studio_the_page_says_how_to_get_it(show):
    page = show("/look.html?start=100.0&end=140.0&selection=1,2&map=/scan")
    text = page.wait_for("return document.getElementById('no-studio')?.innerText")
    assert "rosrun cassandra_ros viewer --install-studio" in text
    links = page.run(
        "return [...document.querySelectorAll('#no-studio a')].map((a) => a.getAttribute('href'))"
    )
    assert links[1] == "/window.bag?start=100.000000000&end=140.000000000"
    assert page.errors() == []


def test_what_is_ticked_is_shown_also_while_it_plays(show, faults):
    faults.installed = True
    page = show("/look.html")
    page.wait_for("return document.querySelector('iframe#studio')")
    page.driver.switch_to.frame("studio")
    page.run(PLAYING)
    page.driver.switch_to.default_content()
    page.wait_for("return new URLSearchParams(location.search).get('time')")
    box = "document.querySelector('#menu-topics input[type=checkbox]')"
    page.wait_for(f"return {box}")
    page.run(f"{box}.click()")
    page.wait_for("return document.querySelector('iframe#studio').src.includes('topics=/chatter')")
    faults.installed = False
    # There is no Studio that its frame could load: until it is gone the console hears of that.
    page.driver.get("about:blank")
    page.errors()


def test_rows_lead_to_their_moments_and_go_on_after_cancel(show, faults):
    faults.stuck = True
    page = show("/ask.html?q=select+KEY+from+/chatter")
    rows = "return document.querySelector('#ask-rows').dataset.rows"
    page.wait_for(f"{rows} === '200'")
    # Digits alone would be read as seconds: the clock of a simulation begins at 0.
    href = page.run("return document.querySelector('#ask-rows tbody a').getAttribute('href')")
    assert parse_qs(urlparse(href).query)["time"] == ["100.000000000"]
    page.run("document.getElementById('ask-cancel').click()")
    page.wait_for("return document.body.dataset.state === 'cancelled'")
    page.run("document.getElementById('rows-more').click()")
    page.wait_for(f"{rows} === '{COUNT}'")
    faults.stuck = False
    assert page.errors() == []


def test_counts_are_exact(show):
    assert show().run(COUNTED) == 20_000_001
