# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Every page as it comes: no error in the console, the state in its links, light and dark."""

from __future__ import annotations

import os
import urllib.error
from pathlib import Path

import numpy as np
import pytest
import screenshots
from browser import patrol
from browser.looking import pixels
from std_msgs.msg import Float64
from suites import sparing

PAGES = {"Home": "/", "Ask": "/ask.html", "Look": "/look.html", "Map": "/map.html"}


@pytest.mark.parametrize("name", PAGES)
def test_a_page_loads_without_an_error(page, viewer, stored, name):
    window = page(PAGES[name])
    window.wait_for("return document.querySelector('#head nav a')")
    assert window.driver.title.startswith(f"{name} ")
    links = window.run(
        "return [...document.querySelectorAll('#head nav a')].map("
        "a => [a.textContent, new URL(a.href).pathname, a.getAttribute('aria-current')])"
    )
    assert links == [[each, path, "page" if each == name else None] for each, path in PAGES.items()]
    shown = "const k = document.getElementById('keyspace');"
    shown += "return k.textContent && (k.querySelector('select')?.value ?? k.textContent.slice(9))"
    assert window.wait_for(shown) == stored[0]


@pytest.fixture
def other(keyspaces, connect):
    """Another keyspace, with one topic."""
    with keyspaces.lend() as name:
        with connect(keyspace=name) as rosCas:
            rosCas.addTopic("/elsewhere", msg_type="std_msgs/Float64").addData(Float64(7.5), 10**18)
        yield name


def test_another_keyspace_is_chosen_and_stays_chosen(page, viewer, stored, other):
    window = page("/ask.html", start=patrol.START, topics="/scan")
    select = "document.querySelector('#keyspace select')"
    window.wait_for(f"return [...({select}?.options ?? [])].some((o) => o.value === '{other}')")
    window.run(f"{select}.value = '{other}'; {select}.dispatchEvent(new Event('change'))")
    chosen = f"location.search === '?keyspace={other}' && {select}?.value === '{other}'"
    window.wait_for(f"return {chosen}")
    topics = "[...document.querySelectorAll('#ask-topics button')].map((b) => b.textContent)"
    assert window.wait_for(f"return {topics}.length && {topics}") == ["/elsewhere"]
    window.run("document.querySelector('#ask-topics button').click()")
    window.wait_for("return document.querySelector('#ask-rows tbody td:last-child')")
    assert "7.5" in window.run("return document.querySelector('#ask-rows tbody').textContent")
    for name, path in PAGES.items():
        window.wait_for("return document.querySelector('#head nav a')")
        window.driver.find_element("link text", name).click()
        window.wait_for(f"return location.pathname === '{path}' && document.title")
        assert f"keyspace={other}" in window.driver.current_url
        window.wait_for(f"return {select}?.value === '{other}'")
    # Where no poses are stored the map says why it has no tracks; the browser notes that answer.
    window.wait_for("return document.querySelector('#map-told').textContent.includes('no tracks')")
    assert [error for error in window.errors() if "/api/places" not in error] == []


PLAYED = """
return (async () => {
  const [{ StoreSource }, state] = await Promise.all([
    import("/modules/studio_source.js"), import("/modules/state.js")]);
  const fail = (told) => { throw new Error(told); };
  const source = new StoreSource(state.read("?topics=/elsewhere"), fail, fail);
  await source.open();
  history.replaceState(null, "", "?layoutId=x&ds=y");
  const found = [];
  for await (const each of source.messageIterator({ topics: ["/elsewhere"] })) {
    found.push(each.msgEvent.message.data);
  }
  return found;
})();
"""


def test_look_plays_what_is_in_the_keyspace_of_its_address(page, other):
    """Also when the Studio has got an address of its own."""
    window = page("/ask.html", keyspace=other)
    assert window.run(PLAYED) == [7.5]


def test_links_to_the_other_pages_keep_the_window(page):
    window = page("/", start=patrol.START, end=patrol.END, topics="/scan,/odom")
    for name, path in list(PAGES.items())[1:]:
        window.wait_for("return document.querySelector('#head nav a')")
        window.driver.find_element("link text", name).click()
        window.wait_for(f"return location.pathname === '{path}' && document.title")
        kept = window.run("return Object.fromEntries(new URLSearchParams(location.search))")
        wanted = {"start": str(patrol.START), "end": str(patrol.END), "topics": "/scan,/odom"}
        assert {key: kept.get(key) for key in wanted} == wanted


def test_a_time_that_is_none_is_told_and_left_out(window, viewer):
    window.errors()
    window.driver.get(viewer.at("/", start="yesterday"))
    told = window.wait_for("return document.querySelector('#banner .problem')?.textContent")
    assert "yesterday" in told
    window.driver.find_element("css selector", "#banner button[aria-label=Close]").click()
    assert not window.run("return document.getElementById('banner').textContent")
    assert not window.errors()
    window.driver.get("about:blank")


def test_pages_are_light_or_dark_as_the_system_is(page):
    window = page("/")
    brightness = {}
    for scheme in ("dark", "light"):
        window.prefer(scheme)
        window.wait_for(
            "return matchMedia(`(prefers-color-scheme: ${arguments[0]})`).matches", scheme
        )
        brightness[scheme] = np.median(pixels(window.picture()))
    assert brightness["dark"] < 80 < 180 < brightness["light"]


def test_there_is_nothing_but_the_pages(viewer):
    for path in ("/nothing.html", "/modules/../../setup.py", "/%2e%2e/setup.py", "/modules/"):
        with pytest.raises(urllib.error.HTTPError) as refused:
            viewer.ask(path)
        assert refused.value.code in (403, 404), path


STATES = {
    "home": {},
    "ask": {
        "q": "select KEY, linear_acceleration.z from /imu/data",
        "with": "select altitude from /fix",
    },
    "look": {"time": patrol.START + 5 * patrol.SECOND},
    "map": {"start": patrol.START, "end": patrol.END, "map": patrol.SCAN},
}
"""What the address of each page says that is taken as a picture."""


@pytest.mark.usefixtures("studio")
@pytest.mark.parametrize("name", sparing(screenshots.PAGES, kept=["home", "ask"]))
def test_the_readmes_pictures_show_their_pages(page, viewer, name):
    window = page("/")
    window.prefer("light")
    picture = np.asarray(screenshots.shoot(window, viewer.url, name, STATES[name]))
    assert picture.shape[:2] == (800, 1280)
    # Something is drawn in each part of it.
    for part in np.array_split(picture, 3):
        assert len(np.unique(part.reshape(-1, 3), axis=0)) > 20


READY = {
    "home": "document.querySelector('#timeline')?.dataset.state === 'ready'",
    "ask": "document.body.dataset.state === 'done'",
    "look": "document.querySelector('#studio[data-ready], #no-studio')",
    "map": "document.querySelector('#map')?.dataset.state === 'drawn'",
}
CUT = """
const reach = document.documentElement.scrollHeight, bar = document.getElementById("head");
const kinds = "button a select input label textarea canvas iframe p h2".split(" ");
const main = kinds.map((kind) => `main ${kind}`).join();
const parts = [...document.querySelectorAll(`#head *, ${main}`)];
return parts.filter((each) => {
  const { left, right, top, bottom, width } = each.getBoundingClientRect();
  if (!width || each.closest(".scroll, .sheet")) return false;
  const low = bar.contains(each) ? bar.getBoundingClientRect().bottom : reach - scrollY;
  return left < 0 || right > innerWidth + 1 || bottom > low + 1;
}).map((each) => each.outerHTML.slice(0, 100));
"""
"""Parts of a page that cannot be seen, also by scrolling down, or leave the bar."""
LEAST = {"home": "#timeline", "ask": "#plot-panels canvas", "look": "#studio", "map": "#map"}
"""What each page is for, which must be 120 pixels high at least, on Look and Map 300."""


@pytest.fixture
def widened(window):
    """Gives the page another width."""
    yield lambda width: window.resize((width, 800))
    window.resize((1280, 800))


@pytest.mark.usefixtures("studio", "other")
@pytest.mark.parametrize("name", READY)
def test_pages_are_whole_at_every_width(page, widened, name):
    check_widths(page(PAGES[name.title()], **STATES[name]), widened, name)


@pytest.mark.usefixtures("other")
def test_home_of_several_periods_is_whole_at_every_width(page, widened, bags):
    window = page("/", keyspace=bags)
    window.wait_for("return document.querySelectorAll('#periods button').length === 2")
    check_widths(window, widened, "home", "periods_")


@pytest.mark.usefixtures("other")
def test_the_topics_of_ask_are_whole_at_every_width(page, widened):
    window = page("/ask.html", **STATES["ask"])
    window.wait_for("return document.querySelector('#ask-topics button')")
    window.run("document.querySelector('#ask-topics').open = true")
    check_widths(window, widened, "ask", "topics_")


def check_widths(window, widened, name, prefix=""):
    """Make a page wide and narrow; nothing of it may be cut off."""
    for width in (1280, 800, 520, 400):
        widened(width)
        window.wait_for(f"return innerWidth === {width} && {READY[name]}")
        window.wait_for("return document.querySelector('#keyspace select')")
        if "CASSANDRA_ROS_PICTURES" in os.environ:
            path = Path(os.environ["CASSANDRA_ROS_PICTURES"]) / f"{prefix}{name}_{width}.png"
            path.write_bytes(window.settled())
        # A plot follows the new width when the page is laid out again.
        window.wait_for(f"return (() => {{{CUT}}})().length === 0")
        assert window.run("return document.documentElement.scrollWidth") <= width
        least = f"return document.querySelector('{LEAST[name]}').getBoundingClientRect().height"
        assert window.run(least) >= (300 if name in ("look", "map") else 120), width
