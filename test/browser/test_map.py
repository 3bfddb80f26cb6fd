# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Map: the walls stand where they stood, a place of the robot's track leads to its moment."""

from __future__ import annotations

import re
from urllib.parse import parse_qs, urlparse

import pytest
from browser import patrol
from browser.looking import HUSKY_END, HUSKY_START, pixels
from compiled import compiled
from selenium.webdriver import ActionChains
from selenium.webdriver.common.keys import Keys

CANVAS = "#map"


class Map:
    """The map in the page, in metres.

    Args:
        window: The browser, with the page.
    """

    def __init__(self, window):
        self.window = window
        window.wait_for(
            "return ['drawn', 'failed'].includes(document.querySelector('#map').dataset.state)"
        )
        self.data = window.run("return {...document.querySelector('#map').dataset}")
        self.canvas = window.driver.find_element("css selector", CANVAS)
        size = self.canvas.size
        self._middle = size["width"] / 2, size["height"] / 2
        self._centre = [float(text) for text in self.data["centre"].split(",")]
        self._scale = float(self.data["scale"])

    def from_middle(self, x, y):
        """Return how many pixels a place is to the right of the canvas's middle, and below."""
        return (
            round((x - self._centre[0]) * self._scale),
            round((self._centre[1] - y) * self._scale),
        )

    def click(self, x, y):
        right, down = self.from_middle(x, y)
        move = ActionChains(self.window.driver).move_to_element_with_offset(
            self.canvas, right, down
        )
        move.click().perform()

    def around(self, x, y, reach=5):
        """Return the pixels about a place."""
        right, down = self.from_middle(x, y)
        column, row = round(self._middle[0] + right), round(self._middle[1] + down)
        picture = pixels(self.window.picture(CANVAS))
        return picture[row - reach : row + reach + 1, column - reach : column + reach + 1]


@pytest.fixture
def drawn(page):
    """The map of the patrol."""
    page("/").prefer("light")
    window = page("/map.html", start=patrol.START, end=patrol.END, map=patrol.SCAN)
    return Map(window)


def test_the_walls_stand_where_they_stood_and_the_track_leads_to_its_moments(drawn):
    assert drawn.data["state"] == "drawn"
    assert int(drawn.data["points"]) > 20
    x, y = patrol.HALF
    # Each wall away from where the lines of the grid are.
    for place in ((x, 0.4), (-x, 0.4), (0.4, y), (0.4, -y)):
        assert drawn.around(*place, reach=6).max(axis=2).min() < 60, place
    assert drawn.around(0.3, 0.3, reach=2).min() > 180
    # A quarter of the circle after 5 s.
    drawn.click(0, patrol.RADIUS)
    link = drawn.window.wait_for("return document.querySelector('#map-picked a')?.href")
    moment = int(parse_qs(urlparse(link).query)["time"][0])
    assert moment == pytest.approx(patrol.START + 5 * patrol.SECOND, abs=patrol.SECOND)


def test_a_lasso_tells_when_the_robot_was_there(drawn):
    window, canvas = drawn.window, drawn.canvas
    window.driver.find_element("css selector", "#map-lasso").click()
    corners = [drawn.from_middle(*at) for at in ((-1, 1.2), (1, 1.2), (1, 2.6), (-1, 2.6))]
    move = ActionChains(window.driver, duration=20)
    move.move_to_element_with_offset(canvas, *corners[0]).click_and_hold()
    for before, after in zip(corners, corners[1:]):
        move.move_by_offset(after[0] - before[0], after[1] - before[1])
    move.release().perform()
    window.wait_for("return document.querySelector('#map').dataset.stays")
    links = window.run("return [...document.querySelectorAll('#map-near a')].map((a) => a.href)")
    look, home, bag = links
    # From a quarter of the circle minus 30 degrees on, for 60 degrees.
    start = int(parse_qs(urlparse(look).query)["time"][0])
    assert start == pytest.approx(patrol.START + 10 / 3 * patrol.SECOND, abs=patrol.SECOND / 5)
    ends = parse_qs(urlparse(home).query)
    assert int(ends["end"][0]) - start == pytest.approx(10 / 3 * patrol.SECOND, abs=patrol.SECOND)
    assert urlparse(bag).path == "/window.bag"
    # The address holds it: who opens it sees the same, and Escape takes it away.
    window.driver.refresh()
    again = window.wait_for("return document.querySelector('#map').dataset.stays")
    assert again == "1"
    window.driver.find_element("css selector", "#map").send_keys(Keys.ESCAPE)
    window.wait_for("return !document.querySelector('#map-near a')")
    # Without a pointer: around the middle, where it never was.
    window.driver.find_element("css selector", "#map").send_keys("n")
    window.wait_for("return document.querySelector('#map').dataset.stays === '0'")


def test_keys_work_on_a_fresh_page_and_not_while_a_control_has_the_focus(drawn):
    window = drawn.window
    scale = "Number(document.querySelector('#map').dataset.scale)"
    before = window.run(f"return {scale}")
    ActionChains(window.driver).send_keys("+").perform()
    window.wait_for(f"return {scale} > {before * 1.05}")
    ActionChains(window.driver).send_keys("0").perform()
    window.wait_for(f"return Math.abs({scale} - {before}) < {before / 100}")
    ActionChains(window.driver).send_keys("n").perform()
    window.wait_for("return document.querySelector('#map').dataset.stays === '0'")
    ActionChains(window.driver).send_keys(Keys.ESCAPE).perform()
    window.wait_for("return !document.querySelector('#map-near .panel')")
    # In a control they are the control's.
    select = window.driver.find_element("css selector", "#map-resolution")
    select.send_keys("n")
    assert window.run("return document.querySelector('#map-near').childElementCount") == 0


def test_the_control_says_which_topic_told_the_poses(page):
    compiled("tf2_py")
    window = page("/map.html", start=patrol.START, end=patrol.END, map=patrol.SCAN)
    drawn = Map(window)
    assert drawn.data["state"] == "drawn"
    options = "return [...document.querySelectorAll('#map-odom option')].map((o) => o.text)"
    assert window.run(options)[0] == "tf, by itself"
    Map(page("/map.html", start=patrol.START, end=patrol.END, map=patrol.SCAN, odom=patrol.ODOM))
    (told,) = [text for text in window.run(options) if text.startswith(patrol.ODOM)]
    assert told.endswith(" %)")


def test_why_no_track_is_drawn_is_said(page):
    window = page("/map.html", map=patrol.MAP, odom="/nowhere")
    window.wait_for("return document.querySelector('#map-told').textContent.includes('no tracks')")
    assert "nowhere" in window.run("return document.querySelector('#map-told').textContent")
    assert any("/api/places" in error for error in window.errors())  # 4xx, as chromium tells it


def test_a_track_over_latitude_and_longitude_and_a_lasso_of_it(page):
    state = {"start": HUSKY_START, "end": HUSKY_END, "map": "", "odom": "/fix"}
    window = page("/map.html", **state)
    drawn = Map(window)
    assert int(drawn.data["points"]) == 95  # each fix
    # The plane is that of metres: the track is as wide and as high as it was driven.
    assert float(drawn.data["scale"]) > 20
    ActionChains(window.driver).move_to_element(drawn.canvas).perform()
    cursor = window.run("return document.querySelector('#map-cursor').textContent")
    assert re.fullmatch(r"latitude 43\.4098\d+  longitude -80\.448[23]\d+", cursor), cursor
    # A lasso around the south of the drive, in degrees: longitude, latitude.
    west, east, south, north = -80.44834, -80.44831, 43.40986, 43.40988
    corners = ";".join(f"{x},{y}" for y, x in ((south, west), (south, east), (north, east)))
    lasso = f"{corners};{west},{north}"
    window = page("/map.html", **state, lasso=lasso)
    window.wait_for("return document.querySelector('#map').dataset.stays === '1'")
    look = window.run("return document.querySelector('#map-near a').href")
    start = int(parse_qs(urlparse(look).query)["time"][0])
    assert HUSKY_START < start < HUSKY_END
    # Around the middle, drawn and read again.
    Map(window)
    window.driver.find_element("css selector", "#map").send_keys("n")
    address = window.wait_for(
        "const at = new URLSearchParams(location.search).get('lasso');"
        f"return at && at !== '{lasso}' ? at : null"
    )
    for pair in address.split(";"):
        longitude, latitude = map(float, pair.split(","))
        assert (longitude, latitude) == pytest.approx((-80.4483, 43.4099), abs=1e-4)
