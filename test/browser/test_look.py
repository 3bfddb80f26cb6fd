# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Look: the Studio over our source. A robot's tf, a camera's pictures, seek, play, memory."""

from __future__ import annotations

import pytest
from browser import patrol
from browser.looking import near
from browser.studio import Studio, await_true

pytestmark = pytest.mark.usefixtures("studio")

EARLY, LATE = patrol.START + 5 * patrol.SECOND, patrol.START + 15 * patrol.SECOND
X_AXIS, Y_AXIS = (0x9C, 0x39, 0x48), (0x88, 0xDD, 0x04)
"""How the Studio draws the axes of a frame."""


def is_colour(colour):
    """Make a condition: a good part of what is seen has a colour."""
    return lambda picture: near(picture, colour).mean() > 0.05


def has_axes(picture):
    """Tell whether axes of frames are seen."""
    return near(picture, X_AXIS).sum() > 20 and near(picture, Y_AXIS).sum() > 20


def test_a_moment_opens_with_its_picture_and_its_frames(page):
    window = page("/look.html", time=EARLY, topics=f"{patrol.CAMERA},/tf,/tf_static,/scan")
    studio = Studio(window)
    assert studio.time_ns == EARLY
    picture = studio.await_picture("ImageViewPanel", is_colour(patrol.COLOURS["early"]))
    assert all(near(picture, colour).mean() > 0.05 for colour in patrol.OTHERS)
    assert not is_colour(patrol.COLOURS["late"])(picture)
    before = studio.await_picture("3D", has_axes)
    # Half a circle later the camera sees something else, and the robot stands elsewhere.
    studio.go_to(LATE)
    studio.await_picture("ImageViewPanel", is_colour(patrol.COLOURS["late"]))
    studio.await_picture("3D", lambda now: has_axes(now) and (now != before).any())
    # An address that is copied opens there again.
    window.wait_for("return new URLSearchParams(location.search).get('time') === arguments[0]", str(LATE))


def test_play_goes_on_and_pause_ends_it(page):
    studio = Studio(page("/look.html", time=patrol.START, topics=patrol.ODOM))
    studio.press("Play")
    studio.await_time(lambda now: now > patrol.START + patrol.SECOND)
    assert studio.data("playing") == "true"
    studio.press("Pause")
    await_true(lambda: studio.data("playing") == "false", lambda: "it plays for ever")
    stopped = studio.time_ns
    # Odometry comes ten times a second; the first second is all there, whatever the machine is.
    assert int(studio.data("messages")) >= 10
    studio.press("Seek forward")
    studio.await_time(lambda now: stopped < now <= stopped + patrol.SECOND)
