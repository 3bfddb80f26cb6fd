# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One Chromium, one viewer and one keyspace for all tests that look at pages.

Stored are five topics of the Husky (2013-05-08, 14:06:20 to 14:06:58 UTC) and, an hour later, a
patrol that browser/patrol.py makes.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import chromium
import pytest
import rosbag
from browser import patrol
from browser.looking import BUSY, HUSKY, HUSKY_TOPICS, LATER, Viewer, unable
from nodes.children import PROGRAMS, Child
from std_msgs.msg import Float64

from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.viewing.studio import studio_folder, studio_installed


def pytest_collection_modifyitems(items):
    for item in items:
        if "browser" in item.path.parts:
            item.add_marker(pytest.mark.suite("all", "it drives a browser"))


@pytest.fixture(scope="session")
def window():
    """The browser of this run."""
    missing = chromium.missing_programs()
    if missing:
        debian = "ID=debian" in Path("/etc/os-release").read_text(encoding="utf-8").split()
        why = "make setup installs it" if debian else "make setup has no package of it here"
        unable(f"no {' and no '.join(missing)}", why, debian)
    with chromium.chromium() as browser:
        yield browser


@pytest.fixture(scope="session")
def stored(keyspaces, connect, tmp_path_factory):
    """What is looked at: the name of the keyspace, how many messages each topic has."""
    path = tmp_path_factory.mktemp("patrol") / "patrol.bag"
    patrol.write(path)
    counts = Counter()
    for file, topics in ((HUSKY, HUSKY_TOPICS), (path, None)):
        with rosbag.Bag(str(file)) as bag:
            found = bag.get_type_and_topic_info(topics)[1]
            counts.update({topic: info.message_count for topic, info in found.items()})
    with keyspaces.lend() as name:
        with connect(keyspace=name) as rosCas:
            import_bag(rosCas, HUSKY, topics=HUSKY_TOPICS)
            import_bag(rosCas, path)
        yield name, dict(counts)


@pytest.fixture(scope="session")
def viewer(cassandra, stored, ros_env):
    """A viewer of that keyspace, started as a person starts it."""
    env = {
        **ros_env,
        "CASSANDRA_ROS_HOST": cassandra.host,
        "CASSANDRA_ROS_PORT": str(cassandra.port),
        # The ROS home of the tests is empty.
        "CASSANDRA_ROS_STUDIO": str(studio_folder().parent),
    }
    command = [PROGRAMS / "viewer", "--port", 0, "--keyspace", stored[0]]
    with Child(command, env) as process:
        line = process.await_line("http://")
        url = next(word for word in line.split() if word.startswith("http://"))
        yield Viewer(url.rstrip("/.,"), process)
        assert process.end() == 0, process.output


@pytest.fixture
def page(window, viewer):
    """Opens pages of the viewer, which may show no error, nor have one in the console."""

    def show(path, **state):
        window.driver.get(viewer.at(path, **state))
        return window

    window.errors()
    yield show
    errors = window.errors()
    banner = window.run("return document.getElementById('banner')?.textContent ?? ''")
    # What goes on in a page would cost the other tests time.
    window.driver.get("about:blank")
    assert not errors, errors
    assert not banner, banner


@pytest.fixture(scope="session")
def studio():
    """Skip the test, or fail in CI, if the Studio's packages are not installed."""
    if not studio_installed(studio_folder()):
        unable(f"no Studio in {studio_folder()}", "make setup could not fetch it")


@pytest.fixture
def bags(keyspaces, connect):
    """A keyspace with 10 s of 1970, from before a clock was set, 40 s of 2017 and 20 s of 2026.

    In 2017 the robot r2 sends /first, then both robots another topic; in 1970 it is r3.
    """
    topics = [("/clock", "r3", 5, 10), ("/first", "r2", BUSY, 20), ("/later", "r2", BUSY + 20, 20)]
    topics += [("/other", "r1", BUSY + 20, 20), ("/clock", "r1", LATER, 20)]
    with keyspaces.lend() as name:
        with connect(keyspace=name) as rosCas:
            for topic, node, begin, seconds in topics:
                stored_topic = rosCas.addTopic(topic, msg_type="std_msgs/Float64", nodeID=node)
                for n in range(seconds):
                    stored_topic.addData(Float64(n), (begin + n) * 10**9)
        yield name
