# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag rename, meta, truncate and keyspaces as they are typed."""

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


def test_rename_meta_truncate_and_keyspaces(topics, call, monkeypatch, new_keyspace):
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

    monkeypatch.setattr(sys, "stdin", io.StringIO("y\n"))
    status, out, err = call("truncate", "/front")
    assert (status, out) == (1, "") and "--yes" in err
    for answer in ("\n", "n\n", ""):
        monkeypatch.setattr(sys, "stdin", Terminal(answer))
        status, out, err = call("truncate", "-e", "/(front|cam/.*)")
        assert (status, out) == (1, "") and "Remove all 6 messages of 2 topics in keyspace" in err
        assert err.endswith("nothing was deleted\n")
    status, out, err = call("truncate", "/front", "--dry-run")
    assert (status, err) == (0, "") and "3 messages of 1 topic" in out
    assert topics.getTopic("/front").countTopicData() == 3
    monkeypatch.setattr(sys, "stdin", Terminal("y\n"))
    assert json.loads(call("truncate", "/front", "--json")[1]) == {"removed": {"/front": 3}}
    assert call("truncate", "/front", "-q", "--yes") == (0, "", "")
    assert [topics.getTopic(n).countTopicData() for n in ("/front", "/cam/right")] == [0, 3]
    assert topics.getTopic("/front").getMeta["lens"] == 3.5

    status, out, err = call("keyspaces")
    assert (status, err) == (0, "")
    mine = next(line for line in out.splitlines() if line.startswith("*"))
    assert mine.split() == ["*", topics.keyspace, "2", "2", "datacenter1", "1"]
    # It needs no keyspace, and makes none.
    found = {
        each["name"]: each
        for each in json.loads(call("keyspaces", "--json", keyspace=new_keyspace)[1])
    }
    wanted = {"name": topics.keyspace, "topics": 2, "tables": 2, "copies": {"datacenter1": 1}}
    assert found[topics.keyspace] == wanted and new_keyspace not in found
