# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""copy, copies and verify --with at a terminal."""

from __future__ import annotations

import json

import pytest
from std_msgs.msg import Int64, String

T0 = 1_500_000_000 * 10**9


@pytest.fixture
def place(cassandra, keyspaces):
    """Another keyspace of the server, as --to names it."""
    with keyspaces.lend() as name:
        yield f"{cassandra.host}:{cassandra.port}/{name}"


@pytest.fixture
def filled(rosCas):
    for n in range(5):
        rosCas.addTopic("/a").addData(String(str(n)), key=T0 + n)
    rosCas.addTopic("/b").addData(Int64(1), key=T0)
    rosCas.catalog.adder.close()
    return rosCas


def test_copies_topics_and_tells_of_each(call, filled, place):
    status, out, err = call("copy", "--to", place)
    assert (status, err) == (0, "")
    assert "/a" in out and f"6 messages copied to {place}" in out
    status, out, _ = call("copy", "/a", "--to", place, "--json")
    answer = json.loads(out)
    assert (status, answer["complete"], answer["to"]) == (0, True, place)
    assert [(t["topic"], t["messages"]) for t in answer["topics"]] == [("/a", 0)]


def test_the_books_are_shown_and_set_the_exit_status(call, filled, place):
    status, out, _ = call("copies")
    assert (status, out) == (
        1,
        "nothing was copied to another store; see 'cassandra_bag copy --help'\n",
    )
    assert call("copy", "/a", "--to", place, "-q") == (0, "", "")
    status, out, _ = call("copies", "--json")
    found = {each["topic"]: (each["copied"], each["waiting"]) for each in json.loads(out)}
    assert (status, found) == (1, {"/a": (5, 0), "/b": (0, 1)})
    assert call("copies", "/a", "-q") == (0, "", "")
    assert call("copy", "--to", place, "-q")[0] == 0
    status, out, _ = call("copies")
    assert status == 0
    assert place in out


def test_stores_are_compared(call, filled, place, connect):
    status, out, _ = call("verify", "--with", place)
    assert status == 1
    assert out.count("different: ") == 2
    status, out, _ = call("verify", "--with", place, "--repair")
    assert (status, out) == (
        0,
        f"equal: keyspace {filled.keyspace} and {place}, 6 messages in 2 buckets\n",
    )
    with connect(keyspace=place.rpartition("/")[2]) as home:
        home.getTopic("/a").removeData(T0, T0 + 1)
    status, out, _ = call("verify", "--with", place, "--json")
    answer = json.loads(out)
    assert (status, answer["equal"]) == (1, False)
    assert [each["here"]["messages"] for each in answer["differences"]] == [5]


def test_a_refused_topic_is_told_and_the_others_are_copied(call, filled, place, connect):
    with connect(keyspace=place.rpartition("/")[2]) as home:
        home.addTopic("/b", msg_type="std_msgs/String")
    status, out, _ = call("copy", "--to", place)
    assert status == 1
    assert "refused: topic /b is not copied: it has type std_msgs/Int64" in out
    assert "5 messages copied" in out


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["copy"], "--to HOST[:PORT][/KEYSPACE]"),
        (["copy", "--to", "a:b:c"], "is not the place of a store"),
        (["copy", "--to", "a:99999"], "is not a port"),
        (["verify"], "give FILE.bag, or --with another store"),
        (["verify", "x.bag", "--repair"], "--repair goes with --with"),
        (["verify", "--with", "127.0.0.1", "--content"], "go with FILE.bag"),
    ],
)
def test_wrong_usage_is_told(call, words, text):
    status, _, err = call(*words)
    assert status
    assert text in err


def test_a_store_is_not_copied_into_itself(call, filled, cassandra):
    place = f"{cassandra.host}:{cassandra.port}"
    status, _, err = call("copy", "--to", place)
    assert status == 1
    assert "is the store itself" in err


def test_retention_deletes_what_is_copied(call, filled, place):
    assert call("copy", "/a", "--to", place, "-q")[0] == 0
    words = ("retention", "--max-size", "9", "--copied", "only", "-y", "--json")
    status, out, _ = call(*words, "--dry-run")
    topics = {each["topic"]: each["dropped"] for each in json.loads(out)["topics"]}
    assert (status, topics) == (0, {"/a": 5, "/b": 0})
    assert call(*words)[0] == 0
    assert filled.getTopic("/a").countTopicData() == 0
    assert filled.getTopic("/b").countTopicData() == 1
    status, _, err = call("retention", "--max-age", "1d", "--copied", "only")
    assert (status, "--copied goes with --max-size" in err) == (2, True)


def test_rules_are_taken_from_a_file(call, filled, place, tmp_path):
    rules = tmp_path / "rules.yaml"
    rules.write_text("topics: [{pattern: /a}, {pattern: /never}]")
    status, out, err = call("copy", "--to", place, "--rules", rules)
    assert status == 0
    assert "5 messages copied" in out
    assert "no topic matches '/never'" in err
    status, _, err = call("copy", "--to", place, "--rules", tmp_path / "none.yaml")
    assert (status, "cannot be read" in err) == (1, True)
