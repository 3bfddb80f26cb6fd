# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Three walks of doc/architecture.md as they are: a message, a statement and a bag are followed.

Each walk is taken several times, after everything that happens once is done: the tables exist, the
recording runs, the topic was asked before. A file of src/cassandra_ros is on the walk if one of its
functions is called each time. Followed are the calling thread and the threads that the package
starts, except OTHERS. What these threads call while there is nothing to do is not on the walk.

Files are counted by one rule. The ground (modules beside the rooms, known to all) is not counted. A
file that goes on, because a function in it calls another file, is a stop. A file that only answers
is a tool: its functions call no other file of a room. Changes of room are those from stop to stop,
in the order in which the stops are first entered, one thread after the other.

The map shows all of it in a table. If a walk has changed, the test that compares it prints the
table as it should be.
"""

from __future__ import annotations

import re
import sys
import threading
import time
from contextlib import contextmanager

import pytest
import rosbag
from genpy import Time
from geometry_msgs.msg import Twist
from nodes.children import await_true
from nodes.raw_publisher import header_of, message
from test_architecture import MAP, PACKAGE, section
from test_imports import BELOW, GROUND

from cassandra_ros.bag.importer import import_bag
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.recording.recording import Recording

START = 1_400_000_000 * SECOND_NS
STEP_NS = 10_000_000
COUNT = 100
ROUNDS = 5
IDLE_SEC = 0.3
"""Longer than a batch waits, so that each periodic work is seen at least once."""
OTHERS = {
    "event_loop": "the driver's thread brings the answers to all requests",
    "recorder-losses": "it stores the losses every 2 s",
}
"""Threads that are not followed, and what they do instead."""
PREFIX = f"{PACKAGE}/"


class Calls:
    """Calls of functions of the package, on the threads that were started under ``followed``."""

    def __init__(self):
        self._noted = None

    @contextmanager
    def followed(self):
        """Follow each thread that is started from now on."""
        threading.setprofile(self._note)
        try:
            yield
        finally:
            threading.setprofile(None)

    @contextmanager
    def noted(self):
        """Note the calls of the followed threads and of this one; yield their list."""
        self._noted = by_thread = {threading.current_thread().name: []}
        calls = []
        sys.setprofile(self._note)
        try:
            yield calls
        finally:
            sys.setprofile(None)
            self._noted = None
            own, *others = by_thread
            # Threads take turns as they like: one after the other they are the same each time.
            for name in (own, *sorted(others)):
                calls += by_thread[name]

    def _note(self, frame, event, _):
        noted = self._noted
        if noted is None or event != "call" or not frame.f_code.co_filename.startswith(PREFIX):
            return
        thread = threading.current_thread().name
        if thread in OTHERS:
            return
        caller = frame.f_back
        while caller is not None and not caller.f_code.co_filename.startswith(PREFIX):
            caller = caller.f_back
        own = frame.f_locals.get("self")
        inherited = caller is not None and own is not None and caller.f_locals.get("self") is own
        calls = noted.setdefault(thread, [])
        calls.append((frame.f_code, None if caller is None else caller.f_code, inherited))


def file_of(code):
    return code.co_filename[len(PREFIX) :]


def room_of(file):
    return file.split("/")[0].replace(".py", "")


class Walk:
    """The calls of one journey, taken several times."""

    def __init__(self, rounds, idle=()):
        resting = {code for code, _, _ in idle}
        self.calls = [call for call in rounds[-1] if call[0] not in resting]
        each_time = [{file_of(code) for code, _, _ in calls} - GROUND_FILES for calls in rounds]
        self.files = [
            file
            for file in dict.fromkeys(file_of(code) for code, _, _ in self.calls)
            if all(file in files for files in each_time)
        ]
        known = set(self.files)
        going_on = {
            file_of(caller)
            for code, caller, _ in self.calls
            if caller is not None and file_of(code) != file_of(caller) and file_of(code) in known
        }
        self.stops = [file for file in self.files if file in going_on]
        self.tools = [file for file in self.files if file not in going_on]

    @property
    def changes(self):
        rooms = [room_of(file) for file in self.stops]
        return sum(a != b for a, b in zip(rooms, rooms[1:]))

    def upwards(self):
        """Calls of a method in a higher room that a lower room makes on the same object.

        Imports point downwards, so any other call upwards is of an object or a function that was
        handed down.
        """
        return {
            (file_of(caller), file_of(code), code.co_name)
            for code, caller, inherited in self.calls
            if inherited and room_of(file_of(caller)) in rooms_below(room_of(file_of(code)))
        }


GROUND_FILES = {f"{name}.py" for name in GROUND}


def rooms_below(room):
    found, left = set(), [room]
    while left:
        for lower in BELOW[left.pop()] - found:
            found.add(lower)
            left.append(lower)
    return found


def twists(first):
    """Yield messages that differ."""
    for number in range(first, first + COUNT):
        msg = Twist()
        msg.linear.x = float(number)
        yield msg


def live_walk(rosCas, calls, format_name):
    """Record messages of a topic whose table exists."""
    topic = f"/live_{format_name}"
    clock, header = iter(range(START, START + 10**12, STEP_NS)), header_of(Twist, topic=topic)
    recording = Recording(
        rosCas.catalog, clock=clock.__next__, format=format_name, places=False, block_sec=0.1
    )

    def all_stored():
        return sum(report.received - report.stored for report in recording.reports()) == 0

    def record(number):
        for msg in twists(number * COUNT):
            recording.received(topic, header, message(msg))

    try:
        record(0)
        await_true(all_stored)
        with calls.noted() as idle:
            time.sleep(IDLE_SEC)
        rounds = []
        for number in range(1, ROUNDS + 1):
            with calls.noted() as noted:
                record(number)
                sys.setprofile(None)  # waiting is no part of the walk
                await_true(all_stored)
            rounds.append(noted)
    finally:
        recording.close()
    return Walk(rounds, idle)


def statement_walk(rosCas, calls, format_name):
    """Ask for a few messages of the recorded topic, by a field and KEY."""
    statement = f"SELECT KEY, linear.x FROM /live_{format_name} WHERE linear.x > ? AND KEY >= ?"
    rounds = []
    for number in range(ROUNDS + 1):
        asked = (3 + number, START + STEP_NS)
        with calls.noted() as noted:
            rows = rosCas.executeCQL(f"{statement} LIMIT 5", asked)
        assert [row[1] for row in rows] == [n + asked[0] for n in range(1, 6)]
        rounds.append(noted)
    return Walk(rounds[1:])


def bag_walk(rosCas, calls, folder):
    """Import bags of a topic whose table exists, one after the other."""
    rounds = []
    for number in range(ROUNDS + 1):
        path = folder / f"{number}.bag"
        with rosbag.Bag(str(path), "w") as bag:
            for second, msg in enumerate(twists(number * COUNT), START // SECOND_NS):
                bag.write("/bag", msg, Time(second))
        with calls.noted() as noted:
            assert import_bag(rosCas, path, format="packed").messages == COUNT
        rounds.append(noted)
    return Walk(rounds[1:])


@pytest.fixture(scope="module")
def walks(keyspaces, connect, tmp_path_factory):
    """All walks by their names; those of a statement follow the recordings that they ask for."""
    calls = Calls()
    with keyspaces.lend() as name, calls.followed(), connect(keyspace=name) as rosCas:
        return {
            "A live message": live_walk(rosCas, calls, "ros"),
            "A live message in packed": live_walk(rosCas, calls, "packed"),
            "A statement": statement_walk(rosCas, calls, "ros"),
            "A statement in packed": statement_walk(rosCas, calls, "packed"),
            "A bag": bag_walk(rosCas, calls, tmp_path_factory.mktemp("bags")),
        }


NAMES = (
    "A live message",
    "A live message in packed",
    "A statement",
    "A statement in packed",
    "A bag",
)


def table_of(walks):
    """Return the table of the map: rooms and their files, tools in italics."""
    rooms = [
        room
        for room in BELOW
        if any(f"{room}/" in file for w in walks.values() for file in w.files)
    ]
    rows = [["room", *NAMES], ["---"] * (1 + len(NAMES))]
    for room in reversed(rooms):
        cells = [", ".join(names_in(walks[name], f"{room}/")) for name in NAMES]
        rows.append([f"`{room}/`", *cells])
    for what in ("stops", "tools"):
        rows.append([what, *(str(len(getattr(walks[name], what))) for name in NAMES)])
    rows.append(["changes of room", *(str(walks[name].changes) for name in NAMES)])
    return [f"| {' | '.join(row)} |" for row in rows]


def names_in(walk, room):
    for file in sorted(file for file in walk.files if file.startswith(room)):
        name = file[len(room) : -len(".py")]
        yield f"*{name}*" if file in walk.tools else name


def test_the_map_shows_the_walks_as_they_are(walks):
    shown = MAP.split("## Three walks, measured")[1].split("\n## ")[0]
    measured = table_of(walks)
    print("\n".join(measured))
    assert [line for line in shown.splitlines() if line.startswith("|")] == measured


NOT_MEASURED = {
    "nodes/subscription.py": "it calls Recording.received, with which the test begins",
    "cli/verbs/import_.py": "it calls import_bag, with which the test begins",
    "query/tree/expressions.py": "only for what is computed",
    "query/rows/result_groups.py": "only for groups, distinct rows and another order",
    "blocks/block_lookup.py": "only for single messages",
    "store/page_rows.py": "only for messages that are wanted whole",
    "topics/stored_row.py": "only for objects",
    "messages/wire/objects.py": "only for objects",
    "topics/run_list.py": "it tells afterwards what became of a run",
    "topics/run_finder.py": "it finds a run afterwards",
}
"""Files that the steps of the map name, and why the test does not see them."""


@pytest.mark.parametrize("title", ["A live message", "A statement", "A bag"])
def test_the_steps_of_the_map_are_taken(walks, title):
    named = set(re.findall(r"`([\w/]+\.py)` `", section(title)))
    entered = {file for name in NAMES if name.startswith(title) for file in walks[name].files}
    assert named - entered <= set(NOT_MEASURED)


def test_a_live_message_passes_few_files(walks):
    walk, first = walks["A live message"], "nodes/subscription.py"
    rooms = [room_of(file) for file in (first, *walk.stops)]
    assert len({first, *walk.files}) <= 15
    assert sum(a != b for a, b in zip(rooms, rooms[1:])) <= 6


LIMITS = {
    "A live message": (13, 5),
    "A live message in packed": (14, 5),
    "A statement": (25, 7),
    "A statement in packed": (31, 9),
    "A bag": (26, 7),
}
"""Maximum number of files on each walk, and of changes of room. Lower a limit when a walk has
become shorter, and never raise one."""


def test_a_bag_passes_few_stops(walks):
    """The tools that a bag is looked up in and set up with only answer."""
    walk = walks["A bag"]
    assert len(walk.stops) <= 18
    assert walk.changes <= 7


@pytest.mark.parametrize("name", NAMES)
def test_no_walk_grows(walks, name):
    files, changes = LIMITS[name]
    assert len(walks[name].files) <= files
    assert walks[name].changes <= changes


@pytest.mark.parametrize("name", NAMES)
def test_no_walk_goes_up(walks, name):
    assert not walks[name].upwards()
