# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag plot as it is typed; the pictures are opened."""

from __future__ import annotations

import pytest
from PIL import Image
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Float64

T0 = 1_500_000_000 * 10**9


@pytest.fixture
def drive(rosCas):
    fix, speed = rosCas.addTopic("/fix", nodeID="a"), rosCas.addTopic("/speed", nodeID="b")
    for n in range(20):
        fix.addData(NavSatFix(altitude=270 + n % 5, latitude=43), key=T0 + n * 10**9)
        speed.addData(Float64(n), key=T0 + n * 10**9 + 5)


def test_statements_become_one_picture(call, drive, tmp_path):
    path = tmp_path / "x.png"
    asked = ["select altitude, latitude, header.frame_id from /fix", "select data from speed"]
    status, out, err = call("plot", *asked, "-o", path, "--size", "640x480", "--title", "Drive")
    assert (status, out) == (0, "")
    assert err == "/fix: header.frame_id is not drawn: text\n"
    assert Image.open(path).size == (640, 480)
    status, _, err = call("plot", asked[1], "-o", path)
    assert status == 1 and "exists" in err
    assert call("plot", asked[1], "-o", path, "-f")[0] == 0
    assert not list(tmp_path.glob("*.active"))


def test_one_column_over_another(call, drive, tmp_path):
    path, svg = tmp_path / "x.png", tmp_path / "x.svg"
    asked = "select latitude, altitude from /fix"
    assert call("plot", asked, "--xy", "altitude", "latitude", "-o", path) == (0, "", "")
    assert Image.open(path).size == (1200, 600)
    assert call("plot", asked, "--xy", "altitude", "latitude", "-o", svg)[0] == 0
    for text in ("altitude [m]", "latitude [°N]"):
        assert f"<!-- {text} -->" in svg.read_text()
    status, _, err = call("plot", asked, "--xy", "altitude", "lat", "-o", path, "-f")
    assert status == 1 and "--xy lat: the statement on /fix has latitude, altitude" in err


def test_endings_groups_windows_and_robots(call, drive, tmp_path):
    svg = tmp_path / "x.svg"
    groups = "select time(5s) as t, max(altitude) from fix group by t"
    assert call("plot", groups, "-o", svg)[0] == 0
    assert "<!-- max(altitude) -->" in svg.read_text()
    pdf = tmp_path / "x.PDF"
    window = ("--start", "1500000003", "--end", "1500000004")
    assert call("plot", "select data from speed", "-o", pdf, *window, "--node-id", "b")[0] == 0
    assert pdf.read_bytes()[:5] == b"%PDF-"
    status, _, err = call(
        "plot", "select data from speed", "-o", tmp_path / "y.png", "--node-id", "a"
    )
    assert status == 0 and "nothing to draw" in err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["select altitud from fix", "-o", "x.png"], "altitude"),
        (["select altitude from fix", "-o", "x.gif"], ".png, .svg, .pdf"),
        (["select altitude from fix", "-o", "x.png", "--size", "big"], "1200x600"),
        (["select altitude from fix", "-o", "x.png", "--size", "9x9"], "100 to 20000"),
        (["select header.frame_id from fix", "-o", "x.png"], "header.frame_id is text"),
        (["select altitude from fix", "-o", "none/x.png"], "cannot be written"),
        (["delete from fix where altitude > 3", "-o", "x.png"], "SELECT"),
        (["select altitude from fix"], "-o/--output"),
    ],
)
def test_what_is_wrong_is_told_and_leaves_no_file(call, drive, tmp_path, monkeypatch, words, told):
    monkeypatch.chdir(tmp_path)
    status, _, err = call("plot", *words)
    assert status != 0 and told in err
    assert not list(tmp_path.iterdir())
