#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Take the README's pictures of the viewer: an hour of a simulated patrol on each page.

Without --url a Cassandra and a viewer of its own are started, the bag of office_patrol.py is made
and imported, and nothing is left running.
"""

from __future__ import annotations

import argparse
import io
import os
import re
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlencode

import office_patrol
from chromium import Browser, chromium
from office_patrol import BUMP_SEC, BUMPS_SEC, SECOND, START, TOURS
from PIL import Image
from stage import RUN, Program

from cassandra_ros import RosCassandra
from cassandra_ros.local_server import LocalCluster, free_port

DOC = Path(__file__).resolve().parent.parent / "doc"
SIZE = (1280, 800)
ROBOT = "patrol1"


class Page(NamedTuple):
    """A page of the viewer."""

    path: str
    ready: str
    """JavaScript expression that is true when the page has all that it shows."""


STUDIO = "document.querySelector('iframe#studio').contentDocument.body.dataset"
PAGES = {
    "home": Page("/", "document.getElementById('timeline').dataset.state === 'ready'"),
    "ask": Page("/ask.html", "document.body.dataset.state === 'done'"),
    "look": Page("/look.html", f"{STUDIO}.presence === 'PRESENT'"),
    "map": Page("/map.html", "document.querySelector('#map').dataset.state === 'drawn'"),
}
STATES = {
    "home": {},
    "ask": {
        "q": "select KEY, linear_acceleration.x, linear_acceleration.z from /imu/data "
        "where EVENT 'bump' limit 28"
    },
    "look": {
        "start": START + TOURS[1][0] * SECOND,
        "end": START + (TOURS[1][0] + 140) * SECOND,
        "time": START + round((TOURS[1][0] + 17.5) * SECOND),
        "topics": "/camera/image/compressed,/scan,/map,/odom,/tf,/tf_static,/battery",
    },
    "map": {
        "start": START + TOURS[1][0] * SECOND,
        "end": START + (TOURS[1][0] + 140) * SECOND,
        "map": "/scan",
        "odom": "/odom",
    },
}
"""What the address of each page says."""
COLOURS = 128
"""Number of colours of a picture: it is in the repository, and loads with the README."""


def shoot(browser: Browser, url: str, name: str, state: dict[str, object]) -> Image.Image:
    """Open a page of a viewer; return its picture once it does not change any more.

    Args:
        url: Address of the viewer.
        name: The page, of PAGES.
        state: What the address of the page says.
    """
    page = PAGES[name]
    browser.driver.get(url.rstrip("/") + page.path + (f"?{urlencode(state)}" if state else ""))
    browser.wait_for(f"return {page.ready}", timeout_sec=120)
    picture = Image.open(io.BytesIO(browser.settled()))
    errors = browser.errors()
    if errors:
        raise SystemExit(f"screenshots: {name}: {'; '.join(errors)}")
    return picture.convert("RGB")


def add_events(port: int) -> None:
    """Name the tours and the bumps of the robot."""
    with RosCassandra("127.0.0.1", port, keyspace="office") as rosCas:
        for number, (second, length) in enumerate(TOURS, 1):
            ends = START + second * SECOND, START + (second + length) * SECOND
            rosCas.addEvent("tour", *ends, nodeID=ROBOT, values={"number": number})
        for bump in BUMPS_SEC:
            begin, end = (START + round(s * SECOND) for s in (bump - 0.5, bump + BUMP_SEC + 0.5))
            rosCas.addEvent("bump", begin, end, nodeID=ROBOT)


def start_viewer(stack: ExitStack) -> str:
    """Start a Cassandra and a viewer that end with the stack; return the viewer's address."""
    home = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="office_pictures_")))
    bag = home / "office.bag"
    office_patrol.write(bag)
    cluster = LocalCluster(home / "cassandra", port=free_port(), say=print)
    stack.callback(cluster.stop)
    cluster.start(die_with_us=True)
    env = dict(os.environ, CASSANDRA_ROS_HOST="127.0.0.1", CASSANDRA_ROS_KEYSPACE="office")
    env.update(CASSANDRA_ROS_PORT=str(cluster.settings.port), CASSANDRA_ROS_CQLSHRC="")
    env.update(PYTHONUNBUFFERED="1")
    words = ("import", str(bag), "--node-id", ROBOT, "--format", "packed")
    subprocess.run(["cassandra_bag", *words], env=env, check=True)
    add_events(cluster.settings.port)
    viewer = Program(
        "viewer", [*RUN, "viewer", "--no-token", "--port", str(free_port())], env, home
    )
    stack.callback(viewer.stop)
    viewer.wait_for(r"http://\S+")
    return re.findall(r"http://[^\s,]+", viewer.text())[0]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--url", help="of a viewer that runs (default: one is started)")
    parser.add_argument("--out", type=Path, default=DOC, help="folder for the pictures (doc/)")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        url = args.url or start_viewer(stack)
        browser = stack.enter_context(chromium(SIZE))
        for name in PAGES:
            target = args.out / f"{name}.png"
            picture = shoot(browser, url, name, STATES[name])
            picture.quantize(COLOURS, dither=Image.Dither.NONE).save(target, optimize=True)
            print(f"{os.path.relpath(target)}: {target.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
