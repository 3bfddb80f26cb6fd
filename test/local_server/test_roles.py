# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The table of doc/login.md: what a user of each role may do, tried, and what the others are told.

CASSANDRA_ROS_WRITE_ROLES=1 tries all and writes the table.
"""

from __future__ import annotations

import os
import re
import time

import pytest
from conftest import ROOT
from local_server import role_actions
from local_server.role_actions import Fleet, User, cell_of, lacking
from nodes.children import await_true
from suites import CAMPAIGN

from cassandra_ros.cli.verbs import VERBS
from cassandra_ros.nodes import query_node, recorder_services
from cassandra_ros.store.tables.role_grants import ROLES
from cassandra_ros.viewing.routes import ROUTES

pytestmark = pytest.mark.suite("all", "it starts a Cassandra")

PAGE = ROOT / "doc/login.md"
BEGIN, END = "<!-- roles:tried -->", "<!-- /roles:tried -->"
WRITES = "CASSANDRA_ROS_WRITE_ROLES" in os.environ
ACTIONS = role_actions.actions()
FEW = {
    "cassandra_bag": (
        "list",
        "import, into a stored topic",
        "query SELECT",
        "delete, of messages",
        "delete, of another's topic",
        "roles --apply",
        "list, of another keyspace",
    ),
    "viewer": ("/api/topics", "/api/query"),
}
"""What make test tries; make campaign tries everything."""


def chosen():
    """The actions of this run, as (program, name)."""
    if WRITES or CAMPAIGN:
        return [(program, name) for program, found in ACTIONS.items() for name in found]
    return [(program, name) for program, names in FEW.items() for name in names]


def section():
    """What the page has between the marks."""
    found = re.search(f"{BEGIN}\n(.*?)\n{END}", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    return found[1]


def on_the_page():
    """The lines of the page's table: cells by action."""
    rows = [re.split(r"\s*\|\s*", line.strip("| ")) for line in section().splitlines()[2:]]
    return {row[0]: row[1:] for row in rows}


def label(program, name):
    """How the table calls an action."""
    if program == "cassandra_bag":
        verb, comma, rest = name.partition(",")
        return f"`cassandra_bag {verb}`{comma}{rest}"
    if name == program:
        return f"`{program}`"
    what, comma, rest = name.partition(",")
    return f"`{program}`: `{what}`{comma}{rest}"


def test_every_verb_service_and_request_is_tried():
    """One that is new needs a line in role_actions.py."""

    def first_words(program):
        return {re.split("[ ,?]", name)[0] for name in ACTIONS[program]}

    assert first_words("cassandra_bag") == set(VERBS)
    assert first_words("query_server") == set(query_node.SERVICES)
    of_recorder = {*recorder_services.TOPIC_SERVICES, *recorder_services.OTHER_SERVICES}
    assert first_words("recorder") == of_recorder
    assert first_words("viewer") == {route.path for route in ROUTES}
    wanted = [label(program, name) for program, found in ACTIONS.items() for name in found]
    assert WRITES or list(on_the_page()) == wanted


@pytest.fixture(scope="module")
def fleet(cqlshrc, users, tmp_path_factory):
    made = Fleet(cqlshrc, users, tmp_path_factory.mktemp("fleet"))
    yield made
    made.admin.close()


@pytest.fixture(scope="module")
def as_role(fleet, request):
    """Makes a user of each role."""
    made = {role: User(fleet, role, lambda: request.getfixturevalue("roscore")) for role in ROLES}
    yield made
    for user in made.values():
        user.close()


@pytest.mark.search
def test_what_each_role_may_do(fleet, as_role):
    fleet.make_other()
    if len(chosen()) > 20:
        fleet.add_drive()
    tried, odd = {}, []
    for program, name in chosen():
        work = ACTIONS[program][name]
        cells = tried.setdefault(label(program, name), [])
        begun = time.monotonic()
        for user in as_role.values():
            try:
                cells.append(cell_of(user.attempt(work), user.name))
            except AssertionError as exc:
                odd.append(f"{label(program, name)} as {user.role}: {exc}")
        print(f"{time.monotonic() - begun:6.1f} s {name}: {cells}")
    assert not odd, "\n".join(odd)
    if WRITES:
        write(tried)
    page = on_the_page()
    assert tried == {name: page[name] for name in tried}


def write(tried):
    """Write the table into the page."""
    head = ["", *(f"`{role}`" for role in ROLES)]
    rows = [head, ["---"] * len(head), *([name, *cells] for name, cells in tried.items())]
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    text = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(text.replace(section(), table), encoding="utf-8")


def test_what_an_error_says_to_grant_is_enough(fleet):
    """Somebody who may only read, and gets what the errors ask for one by one, may import."""
    user = User(fleet, fleet.add_reader(), lambda: None)
    given = []

    def helped():
        refusal = user.attempt(ACTIONS["cassandra_bag"]["import, of a new topic"])
        if refusal is None:
            return True
        found = lacking(refusal, user.name)
        if found["right"] not in given:  # a server remembers what it refused for up to 2 s
            given.append(found["right"])
            fleet.admin.cassandra.execute_text(found["remedy"], what="granting a right")
        return False

    await_true(helped)
    assert set(given) == {"MODIFY", "CREATE"}
