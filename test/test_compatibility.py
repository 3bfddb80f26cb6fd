# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What doc/compatibility.md promises of services and messages, and that it names tests that exist.

A client that was built with another md5sum is refused by ROS. So a message or a service of 1.x is
never changed: what needs other fields gets another name.
"""

from __future__ import annotations

import importlib
import re

import pytest
from conftest import ROOT

MD5SUMS = {
    "cassandra_ros/CopiedTopic": "7aa424b63b7a4afe1d09aff4047df4c4",
    "cassandra_ros/PlayedTopic": "ce6323de8761e5b7f36c5039474e6afe",
    "cassandra_ros/RecordedTopic": "478d25362ebf194d2392402a73a6e34c",
    "cassandra_ros/Row": "b574a4a611cba2b6cf401af98173eb55",
    "cassandra_ros/StoredMessage": "5ac40c02571d88e1379073643ba606e0",
    "cassandra_ros/StoredTopic": "1e91e7eac3791f71d248d8c7f6a9a4f1",
    "cassandra_ros/AddData": "898ff797a81943e1152608c6f752885d",
    "cassandra_ros/ExecuteCQL": "2d2194a467c109b3c55d4358b9adadf6",
    "cassandra_ros/ExplainCQL": "bfcf19738391fa3bd970ed1b8ada8179",
    "cassandra_ros/GetData": "8124e18ea6cdb0d909bc1f6a3a457c80",
    "cassandra_ros/Info": "167aee25def68c26a0c43f575942a618",
    "cassandra_ros/LookupTransform": "820d17e1d1b427a82b0585d6f580fe9f",
    "cassandra_ros/Mark": "4e428f261adf8db9bcb32cc4f1f6572d",
    "cassandra_ros/PlayerStatus": "1cf9d059b7474f8aeb009aaebf4b8c84",
    "cassandra_ros/Range": "7572f262756c02770bf58b31813cac12",
    "cassandra_ros/RecordTopics": "371374c54b468eb912924b0e26b813c9",
    "cassandra_ros/RecorderStatus": "b7655945020ddda00c759c328a6026db",
    "cassandra_ros/RemoveData": "ecacfc566f81eeaae45249273bafc76f",
    "cassandra_ros/ReplicatorStatus": "c17ccf54849a132aa442ab0bc486c8d3",
    "cassandra_ros/Seek": "be7a08abb32779874183a69929082eff",
    "cassandra_ros/SetRate": "b32a3c75ca7f14c8fb463ac9ca4f174c",
    "cassandra_ros/Snapshot": "36642b074fd8ba5e875c1c83ef53e514",
    "cassandra_ros/Sql": "9f9e48a69090ba84c41ca8cd0a80116b",
    "cassandra_ros/Step": "199617f5cf022affe9db34cba6d16920",
}


def test_every_message_and_service_is_listed():
    files = [*(ROOT / "msg").glob("*.msg"), *(ROOT / "srv").glob("*.srv")]
    assert {f"cassandra_ros/{path.stem}" for path in files} == set(MD5SUMS)


@pytest.mark.parametrize("name", MD5SUMS)
def test_a_message_or_service_is_as_it_was(name):
    short = name.split("/")[1]
    kind = "msg" if (ROOT / f"msg/{short}.msg").exists() else "srv"
    module = importlib.import_module(f"cassandra_ros.{kind}")
    assert getattr(module, short)._md5sum == MD5SUMS[name]


def test_the_tests_that_the_page_names_exist():
    page = (ROOT / "doc/compatibility.md").read_text(encoding="utf-8")
    named = re.findall(r"`(test/[\w/.]+)`", page)
    assert named and all((ROOT / name).exists() for name in named)
