# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Look: the Studio over our source. A robot's tf, a camera's pictures, seek and play."""

from __future__ import annotations

import re
import time

import pytest
from browser import patrol
from browser.looking import near, pixels

pytestmark = pytest.mark.usefixtures("studio")

EARLY, LATE = patrol.START + 5 * patrol.SECOND, patrol.START + 15 * patrol.SECOND
CLOCK = "[data-testid=PlaybackTime-text] input"
AXES = {"x": (0x9C, 0x39, 0x48), "y": (0x88, 0xDD, 0x04)}
"""Colours of the axes of a frame, as the Studio draws them."""


def panel(kind):
    """Return how a panel of a kind is found in the page."""
    return f'[data-testid^="panel-mouseenter-container {kind}"]'


def shown_sec(window):
    """Return the moment that the player shows, s since midnight UTC."""
    text = window.wait_for(f"return document.querySelector('{CLOCK}')?.value", timeout_sec=120)
    found = re.search(r"(\d+):(\d+):(\d+(?:\.\d+)?)(?: (AM|PM))?", text)
    if not found:
        return float(text) % 86400
    hours = int(found[1]) % 12 + 12 * (found[4] == "PM") if found[4] else int(found[1])
    return hours * 3600 + int(found[2]) * 60 + float(found[3])


def day_sec(ns):
    """Return a moment as shown_sec does."""
    return ns / 1e9 % 86400


def await_pixels(window, selector, condition, timeout_sec=60):
    """Wait until a condition holds of an element's pixels; return them."""
    deadline = time.monotonic() + timeout_sec
    while True:
        picture = pixels(window.picture(selector))
        if condition(picture):
            return picture
        assert time.monotonic() < deadline, f"{selector} never looked so"
        time.sleep(0.2)


def type_moment(window, ns):
    """Go to a moment as a person does who types it."""
    window.driver.find_element("css selector", CLOCK).click()
    field = window.driver.switch_to.active_element
    field.send_keys("\ue009a\ue000", f"{ns // 10**9}.{ns % 10**9:09d}", "\ue007")
    window.run("document.activeElement.blur()")


def press(window, title):
    window.driver.find_element("css selector", f"button[title='{title}']").click()


def is_colour(colour):
    """Make a condition: a good part of what is seen has a colour."""
    return lambda picture: near(picture, colour).mean() > 0.05


def test_a_moment_opens_with_its_picture_and_a_seek_has_another(page):
    window = page("/look.html", time=EARLY, topics=patrol.CAMERA)
    assert shown_sec(window) == pytest.approx(day_sec(EARLY), abs=0.2)
    camera = panel("ImageViewPanel")
    picture = await_pixels(window, camera, is_colour(patrol.COLOURS["early"]))
    assert all(near(picture, colour).mean() > 0.05 for colour in patrol.OTHERS)
    assert not is_colour(patrol.COLOURS["late"])(picture)
    type_moment(window, LATE)
    await_pixels(window, camera, is_colour(patrol.COLOURS["late"]))
    assert shown_sec(window) == pytest.approx(day_sec(LATE), abs=0.2)


def axes(picture):
    """Tell which pixels show the axes of frames."""
    return near(picture, AXES["x"]) | near(picture, AXES["y"])


def test_the_3d_panel_shows_the_robots_tf_where_it_was(page):
    window = page("/look.html", time=EARLY, topics="/tf,/tf_static,/scan")
    assert shown_sec(window) == pytest.approx(day_sec(EARLY), abs=0.2)
    scene = panel("3D")
    before = await_pixels(window, scene, lambda picture: axes(picture).sum() > 50)
    type_moment(window, LATE)
    # The robot is on the other side of the room then.
    await_pixels(
        window, scene, lambda picture: axes(picture).sum() > 50 and (picture != before).any()
    )


def test_play_goes_on_and_pause_ends_it(page):
    window = page("/look.html", time=patrol.START, topics="/odom")
    begin = shown_sec(window)
    press(window, "Play")
    window.wait_for("return document.querySelector('button[title=Pause]')")
    deadline = time.monotonic() + 60
    while shown_sec(window) < begin + 1:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    press(window, "Pause")
    window.wait_for("return document.querySelector('button[title=Play]')")
    stopped = shown_sec(window)
    time.sleep(0.3)
    assert shown_sec(window) == stopped
