#!/usr/bin/env python3
# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Take the README's pictures of the viewer: a Husky's drive on Home, Ask and Look.

Without --url a Cassandra and a viewer of its own are started, the bag is imported, and nothing is
left running.
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
from urllib.parse import urlencode

from chromium import Browser, chromium
from demo import BAG, RUN, Node
from PIL import Image

from cassandra_ros.local_server import LocalCluster, free_port

DOC = Path(__file__).resolve().parent.parent / "doc"
SIZE = (1280, 800)
MOMENT = 1368022000_000_000_000
"""Half-way through the drive, ns."""
STATEMENT = (
    "select KEY, linear_acceleration.x, linear_acceleration.y, angular_velocity.z from /imu/data"
)
STUDIO = "document.querySelector('iframe#studio').contentDocument.body.dataset"
PAGES = {
    "home": ("/", {}, "document.getElementById('timeline').dataset.state === 'ready'"),
    "ask": ("/ask.html", {"q": STATEMENT}, "document.body.dataset.state === 'done'"),
    "look": ("/look.html", {"time": MOMENT}, f"{STUDIO}.presence === 'PRESENT'"),
}
"""Of each picture: page, what its address says, and when it has all that it shows."""
COLOURS = 128
"""What a picture keeps of them: it is in the repository, and loads with the README."""


def shoot(browser: Browser, url: str, name: str) -> Image.Image:
    """Open a page of a viewer; return its picture once it does not change any more."""
    path, state, ready = PAGES[name]
    browser.driver.get(url.rstrip("/") + path + (f"?{urlencode(state)}" if state else ""))
    browser.wait_for(f"return {ready}", timeout_sec=120)
    picture = Image.open(io.BytesIO(browser.settled()))
    errors = browser.errors()
    if errors:
        raise SystemExit(f"screenshots: {name}: {'; '.join(errors)}")
    return picture.convert("RGB")


def start_viewer(stack: ExitStack) -> str:
    """Start a Cassandra and a viewer that end with the stack; return the viewer's address."""
    home = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="husky_pictures_")))
    cluster = LocalCluster(home / "cassandra", port=free_port(), say=print)
    stack.callback(cluster.stop)
    cluster.start(die_with_us=True)
    env = dict(os.environ, CASSANDRA_ROS_HOST="127.0.0.1", CASSANDRA_ROS_KEYSPACE="husky")
    env.update(CASSANDRA_ROS_PORT=str(cluster.settings.port), CASSANDRA_ROS_CQLSHRC="")
    env.update(PYTHONUNBUFFERED="1")
    subprocess.run([*RUN, "cassandra_bag", "import", str(BAG)], env=env, check=True)
    viewer = Node("viewer", [*RUN, "viewer", "--port", str(free_port())], env, home)
    stack.callback(viewer.stop)
    viewer.wait_for(r"http://\S+", 60)
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
            picture = shoot(browser, url, name)
            picture.quantize(COLOURS, dither=Image.Dither.NONE).save(target, optimize=True)
            print(f"{os.path.relpath(target)}: {target.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
