# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Every page as it comes: no error in the console, the state in its links, light and dark."""

from __future__ import annotations

import urllib.error

import numpy as np
import pytest
import screenshots
from browser import patrol
from browser.looking import pixels
from campaign import sparing

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
    keyspace = window.wait_for("return document.getElementById('keyspace').textContent")
    assert keyspace == f"keyspace {stored[0]}"


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


@pytest.mark.usefixtures("studio")
@pytest.mark.parametrize("name", sparing(screenshots.PAGES, kept=["home", "ask"]))
def test_the_readmes_pictures_show_their_pages(page, viewer, name):
    window = page("/")
    window.prefer("light")
    picture = np.asarray(screenshots.shoot(window, viewer.url, name))
    assert picture.shape[:2] == (800, 1280)
    # Something is drawn in each part of it.
    for part in np.array_split(picture, 3):
        assert len(np.unique(part.reshape(-1, 3), axis=0)) > 20
