# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What crosses the border of a process: forks of a client, errors, classes of messages."""

from __future__ import annotations

import copy
import multiprocessing
import pickle

import pytest
from std_msgs.msg import String

import cassandra_ros
from cassandra_ros import errors
from cassandra_ros.errors import (
    CassandraRosError,
    ConnectionFailed,
    InvalidQuery,
    WriteFailed,
)
from cassandra_ros.messages.classes import message_class, raw_class, serialize
from cassandra_ros.messages.definition import parse_definition

FORKING = multiprocessing.get_context("fork")
LIMIT_SEC = 180.0
"""A child that has not answered by then hangs, s."""


def in_child(work):
    """Return what a function returns in a fork of this process, or the error that it raises."""
    ours, theirs = FORKING.Pipe()

    def run():
        try:
            theirs.send(work())
        except BaseException as exc:  # noqa: BLE001 - the parent looks at it
            theirs.send(exc)

    child = FORKING.Process(target=run)
    child.start()
    try:
        assert ours.poll(LIMIT_SEC), "the child hangs"
        answer = ours.recv()
        child.join(LIMIT_SEC)
        assert child.exitcode == 0
        return answer
    finally:
        child.kill()
        child.join()


def pickled(value):
    return pickle.loads(pickle.dumps(value))  # noqa: S301 - we made it


@pytest.fixture
def stored(rosCas):
    topic = rosCas.addTopic("/a")
    topic.addData(String("x"), key=1)
    rosCas.sql("SELECT data FROM a").fetchall()
    return rosCas


USES = {
    "items": lambda store: list(store.getTopic("/a").items()),
    "rows": lambda store: [row.wire for row in store.getTopic("/a").rows()],
    "statement": lambda store: list(store.executeCQL("SELECT data FROM a")),
    "sql": lambda store: store.sql("SELECT data FROM a").fetchall(),
    "bag": lambda store: list(cassandra_ros.Bag("a", rosCas=store).read_messages()),
    "add": lambda store: store.getTopic("/a").addData(String("y"), key=2),
    "topics": lambda store: [topic.name for topic in store.getAllTopics()],
}


@pytest.mark.parametrize("use", sorted(USES))
def test_a_fork_of_a_client_says_at_once_what_to_do(stored, use):
    answer = in_child(lambda: USES[use](stored))
    assert isinstance(answer, (ConnectionFailed, WriteFailed))
    assert "is a fork of" in str(answer) and "worker_init_fn" in str(answer)
    in_child(stored.close)
    assert stored.getTopic("/a").getData(1).data == "x"  # the parent goes on


def kinds_of(base):
    return {base}.union(*map(kinds_of, base.__subclasses__()))


@pytest.mark.parametrize(
    "kind", sorted(kinds_of(CassandraRosError), key=lambda kind: kind.__name__)
)
def test_errors_are_pickled(kind):
    if kind.__module__ != errors.__name__:
        pytest.skip("not in the tree of errors.py")
    exc = kind("what failed, and why", *[5, "the reason"] * (kind is InvalidQuery))
    vars(exc)["extra"] = 7
    for found in (pickled(exc), copy.copy(exc)):
        assert (type(found), str(found), vars(found)) == (kind, str(exc), vars(exc))


def test_messages_of_types_that_are_not_installed_are_pickled():
    part = "=" * 80 + "\nMSG: other_msgs/Part\nint8 n\n"
    definition = parse_definition("other_msgs/Whole", f"Part[] parts\nPart one\ntime t\n{part}")
    cls = message_class(definition)
    msg = cls()
    msg.one.n, msg.parts, msg.t.secs = 3, [type(msg.one)(4)], 5
    for found in (pickled(msg), in_child(lambda: msg), copy.deepcopy(msg)):
        assert type(found) is cls
        assert found == msg
        assert serialize(found) == serialize(msg)


def test_messages_whose_definition_is_unusable_are_pickled():
    msg = raw_class("other_msgs/Odd", "0" * 32)(b"abc")
    found = pickled(msg)
    assert found == msg
    assert (found._type, serialize(found)) == ("other_msgs/Odd", b"abc")


def test_rospy_publishes_generated_classes():
    """It takes classes whose type is ``type`` only."""
    cls = message_class(parse_definition("other_msgs/Some", "int8 n"))
    assert type(cls) is type
    assert type(raw_class("other_msgs/Odd", "0" * 32)) is type
