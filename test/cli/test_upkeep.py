# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag rename, meta, delete --messages and info --all as they are typed."""

from __future__ import annotations

import io
import json
import sys

import pytest
import yaml
from std_msgs.msg import Int64


@pytest.fixture
def topics(rosCas):
    """Two topics of three messages each."""
    for name in ("/cam/left", "/cam/right"):
        topic = rosCas.addTopic(name, format="binary", comment="a camera")
        for n in range(3):
            topic.addData(Int64(n), key=10**18 + n, nodeID="r1")
    return rosCas


class Terminal(io.StringIO):
    """Standard input at which a person types."""

    def isatty(self):
        return True


def test_rename_and_meta(topics, call):
    assert call("rename", "cam/left", "/front") == (
        0,
        "topic /cam/left is called /front now\n",
        "",
    )
    status, _, err = call("rename", "/front", "/cam/right")
    assert (status, err.count("\n")) == (1, 1) and "is stored already" in err
    assert call("rename", "/front")[0] == 2

    status, out, err = call("meta", "front", "site=lab", "lens=3.5", "comment=left = front")
    found = yaml.safe_load(out)
    assert (status, err) == (0, "")
    assert (found["site"], found["lens"], found["comment"]) == ("lab", 3.5, "left = front")
    assert (found["msg_type"], found["nodeIDs"]) == ("std_msgs/Int64", ["r1"])
    assert "definition" not in found
    out = call("meta", "/front", "--remove", "site", "--remove", "comment", "--json")[1]
    found = json.loads(out)
    assert "site" not in found and (found["lens"], found["comment"]) == (3.5, "")
    assert call("meta", "/front", "--definition")[1] == found["definition"] + "\n" == "int64 data\n"
    status, _, err = call("meta", "/front", "md5sum=0")
    assert (status, err.count("\n")) == (1, 1)
    assert call("meta", "/front", "site")[0] == 2


def test_all_messages_are_deleted_and_the_topics_stay(topics, call, monkeypatch):
    topics.getTopic("/cam/left").setMeta(lens=3.5)
    assert call("delete", "--messages")[0] == 2
    monkeypatch.setattr(sys, "stdin", io.StringIO("y\n"))
    status, out, err = call("delete", "/cam/left", "--messages")
    assert (status, out) == (1, "") and "--yes" in err
    for answer in ("\n", "n\n", ""):
        monkeypatch.setattr(sys, "stdin", Terminal(answer))
        status, out, err = call("delete", "--messages", "-e", "/(cam/l.*|cam/.*)")
        assert (status, out) == (1, "")
        asked = f"Delete 6 messages of 2 topics in keyspace {topics.keyspace}, and keep the topics?"
        assert asked in err
        assert [line.split() for line in err.splitlines()[1:3]] == [
            ["/cam/left", "3", "24", "B"],
            ["/cam/right", "3", "24", "B"],
        ]
        assert err.endswith("nothing was deleted\n")
    status, out, err = call("delete", "/cam/left", "--messages", "--dry-run")
    assert (status, err) == (0, "") and out.endswith("3 messages of 1 topic would be deleted\n")
    assert topics.getTopic("/cam/left").countTopicData() == 3
    monkeypatch.setattr(sys, "stdin", Terminal("y\n"))
    answer = json.loads(call("delete", "/cam/left", "--messages", "--json")[1])
    assert answer == {"deleted": {"/cam/left": 3}, "with_topics": False, "dry_run": False}
    assert call("delete", "/cam/left", "--messages", "-q", "--yes") == (0, "", "")
    names = ("/cam/left", "/cam/right")
    assert [topics.getTopic(name).countTopicData() for name in names] == [0, 3]
    assert topics.getTopic("/cam/left").getMeta["lens"] == 3.5
    # With a choice of messages it says the same as without the option.
    assert call("delete", "--messages", "--end", "1000000000.000000001", "-q", "-y") == (0, "", "")
    assert topics.getTopic("/cam/right").countTopicData() == 1


def test_the_keyspaces_of_a_cluster(topics, call, new_keyspace):
    status, out, err = call("info", "--all")
    assert (status, err) == (0, "")
    mine = next(line for line in out.splitlines() if line.startswith("*"))
    assert mine.split() == ["*", topics.keyspace, "2", "2", "datacenter1", "1"]
    # It needs no keyspace, and makes none.
    wanted = {"name": topics.keyspace, "topics": 2, "tables": 2, "copies": {"datacenter1": 1}}
    for form, read in (("--json", json.loads), ("--yaml", yaml.safe_load)):
        answer = read(call("info", "--all", form, keyspace=new_keyspace)[1])
        keyspaces = {keyspace["name"]: keyspace for keyspace in answer}
        assert keyspaces[topics.keyspace] == wanted and new_keyspace not in keyspaces
    for words in (["/cam/left"], ["--node-id", "r1"], ["--store", "home"], ["--run", "x"]):
        status, _, err = call("info", "--all", *words)
        assert (status, "--all lists keyspaces: it goes without" in err) == (2, True)
