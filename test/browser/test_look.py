# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Look: the Studio over our source. A robot's tf, a camera's pictures, seek, play, memory."""

from __future__ import annotations

import numpy as np
import pytest
from browser import film, patrol
from browser.looking import HUSKY_END, HUSKY_START, near
from browser.studio import BODY, Studio, await_true, packed
from geometry_msgs.msg import Wrench
from std_msgs.msg import String
from suites import SUITE

from cassandra_ros.files.bag.importer import import_bag

pytestmark = pytest.mark.usefixtures("studio")

EARLY, LATE = patrol.START + 5 * patrol.SECOND, patrol.START + 15 * patrol.SECOND
X_AXIS, Y_AXIS = (0x78, 0x28, 0x38), (0x68, 0xA8, 0x08)
"""How the Studio draws the axes of a frame."""


NOTES = "return [...document.querySelectorAll('p.told span')].map((each) => each.textContent)"


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
    window.wait_for(
        "return new URLSearchParams(location.search).get('time') === arguments[0]", str(LATE)
    )


def test_play_goes_on_and_pause_ends_it(page):
    studio = Studio(page("/look.html", time=patrol.START, topics=patrol.ODOM))
    studio.press("Play")
    studio.await_time(lambda now: now > patrol.START + patrol.SECOND)
    assert studio.data("playing") == "true"
    studio.press("Pause")
    await_true(lambda: studio.data("playing") == "false", lambda: "it plays for ever")
    # Odometry comes ten times a second; the first second is all there, whatever the machine is.
    assert int(studio.data("messages")) >= 10
    # The step that the player was at may be shown after the pause: go to a moment that is known.
    studio.go_to(EARLY)
    studio.press("Seek backward")
    studio.await_time(lambda now: EARLY - patrol.SECOND <= now < EARLY)
    assert studio.data("playing") == "false"


def test_what_is_not_in_the_window_is_a_note_at_most(page, keyspaces, connect):
    with keyspaces.lend() as name:
        with connect(keyspace=name) as rosCas:
            rosCas.addTopic("/x", msg_type="std_msgs/String").addData(String("x"), patrol.START)
            rosCas.addTopic("/once", key_format="hash").addData(String("without a time"))
        window = page("/look.html", keyspace=name, time=patrol.START)
        assert Studio(window).time_ns == patrol.START
        assert window.run(NOTES) == []
        window = page("/look.html", keyspace=name, start=patrol.START + 1, end=patrol.END)
        (note,) = window.wait_for(NOTES.replace("return", "const n =") + "; return n.length && n")
        assert "no message" in note


LAYOUT = """
return (async () => {
  const [{ layoutOf }, { get }] = await Promise.all([
    import("/modules/studio_layout.js"), import("/modules/api.js")]);
  const found = await get("/api/connections", arguments[0]);
  const { configById } = layoutOf(found.topics, false);
  const names = Object.keys(configById).map((id) => id.split("!")[0]);
  return [names, (configById["Plot!curves"]?.paths ?? []).map((path) => path.value)];
})();
"""


def test_panels_are_of_what_the_window_has(page, keyspaces, connect):
    window = page("/ask.html")

    def panels(start, end, **chosen):
        return window.run(LAYOUT, {"start": str(start), "end": str(end), **chosen})

    drive, patrols = (HUSKY_START, HUSKY_END), (patrol.START, patrol.END)
    names, curves = panels(*drive, topics=["/fix"])
    assert names == ["map", "Plot", "RawMessages"]
    assert curves == ["/fix.altitude"]
    assert panels(*drive)[0] == ["3D", "map", "Plot", "RawMessages", "RosOut"]
    assert panels(*patrols)[0] == ["3D", "ImageViewPanel", "Plot", "RawMessages"]
    # The room's map and tf are of the patrol; an hour earlier they are not named.
    assert panels(*drive, topics=["/encoder", "/scan", "/map"])[0] == ["Plot", "RawMessages"]
    assert panels(*drive, topics=["/rosout"])[0] == ["RawMessages", "RosOut"]
    with keyspaces.lend() as name:
        with connect(keyspace=name) as rosCas:
            rosCas.addTopic("/text", msg_type="std_msgs/String").addData(String("x"), 10**18)
            rosCas.addTopic("/wrench").addData(Wrench(), 10**18)
        found = panels(10**18, 10**18 + 1, keyspace=name)
    assert found[0] == ["Plot", "RawMessages"]
    assert found[1][:2] == ["/wrench.force.x", "/wrench.force.y"]


def test_positions_are_on_a_map_that_asks_no_other_server(page):
    # An error in the console would be told by the fixture.
    window = page("/look.html", start=HUSKY_START, end=HUSKY_END, topics="/fix")
    studio = Studio(window)
    window.wait_for("return document.querySelector('#menu-topics')")
    studio.press("Play")
    studio.await_time(lambda now: now > HUSKY_START + 2 * patrol.SECOND)
    studio.await_picture("map", lambda picture: len(np.unique(picture.reshape(-1, 3), axis=0)) > 10)


@pytest.fixture
def narrow(window):
    """A page that is 400 pixels wide."""
    window.resize((400, 800))
    yield
    window.resize((1280, 800))


@pytest.mark.usefixtures("narrow")
def test_panels_are_below_each_other_on_a_narrow_page(page):
    window = page("/look.html", start=patrol.START, end=patrol.END)
    studio = Studio(window)
    widths = {kind: studio.picture(kind).shape[1] for kind in ("3D", "ImageViewPanel", "Plot")}
    assert min(widths.values()) > 300, widths
    # All controls can be reached.
    controls = (
        f"[...{BODY}.querySelectorAll('button, input')].map((e) => e.getBoundingClientRect())"
    )
    assert window.run(f"return Math.max(...{controls}.map((each) => each.right))") <= 400


def test_the_menus_name_what_the_window_has(page):
    window = page("/look.html", start=patrol.START, end=patrol.END, topics="/odom,/fix")
    Studio(window)
    texts = "[...document.querySelectorAll('#menu-topics li')].map((e) => e.textContent)"
    topics = [text.split(" ")[0] for text in window.wait_for(f"return {texts}.length && {texts}")]
    # /fix has nothing in it, but can be left out again.
    assert topics == ["/camera/image/compressed", "/map", *patrol_topics(), "/fix"]
    runs = "return [...document.querySelectorAll('#menu-runs li')].map((e) => e.textContent)"
    assert window.run(runs) == ["patrol.bag"]


def patrol_topics():
    return [patrol.ODOM, patrol.SCAN, "/tf", "/tf_static"]


FILM_SEC = {"test": 30, "all": 100, "campaign": 3600}[SUITE]
"""How much is recorded, which is played in a tenth of the time."""
HEAP_BYTES = 400 << 20
GROWTH_BYTES = 600 << 20
"""How much more the browser may hold than when a tenth was played; what it held before that
depends on the pages that it showed."""


@pytest.mark.search
def test_memory_is_bounded_however_long_is_played(page, stored, connect, tmp_path, record_property):
    film.write(tmp_path / "film.bag", FILM_SEC)
    with connect(keyspace=stored[0]) as rosCas:
        import_bag(rosCas, tmp_path / "film.bag")
    panels = {"ImageViewPanel!film": {"cameraTopic": film.TOPIC, "mode": "fit"}}
    layout = {"layout": next(iter(panels)), "configById": panels, "playbackConfig": {"speed": 10}}
    whole = {"start": film.START, "end": film.START + FILM_SEC * 10**9, "time": film.START}
    window = page("/look.html", topics=film.TOPIC, layout=packed(layout), **whole)
    studio = Studio(window)
    studio.press("Play")
    heap = 0
    resident = []
    for part in range(1, 10):
        moment = film.START + part * FILM_SEC * 10**8
        studio.await_time(lambda now, moment=moment: now >= moment, timeout_sec=180 + FILM_SEC / 10)
        heap = max(heap, window.heap_bytes())
        resident.append(window.resident_bytes())
    # If pictures come faster than they can be drawn, some are not drawn, but all are read.
    assert int(studio.data("messages")) > 0.8 * FILM_SEC * film.RATE_HZ
    growth = max(resident) - resident[0]
    told = f"heap {heap >> 20}, all {max(resident) >> 20}, of which {growth >> 20} while it played"
    record_property("told", f"{FILM_SEC} s at 10 x: {told} MB")
    assert heap < HEAP_BYTES
    assert growth < GROWTH_BYTES
