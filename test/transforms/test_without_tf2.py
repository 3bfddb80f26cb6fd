# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A Python that has no tf2_py: the lookup says so, everything else works."""

from __future__ import annotations

import sys

import pytest
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from cassandra_ros.errors import MissingDependency


def test_a_lookup_names_the_python_and_what_to_install(rosCas, monkeypatch):
    monkeypatch.setitem(sys.modules, "tf2_py", None)
    monkeypatch.delitem(sys.modules, "cassandra_ros.places.transforms.tf_buffer", raising=False)
    made = TransformStamped(child_frame_id="base")
    made.header.frame_id = "map"
    made.header.stamp.secs = 7
    made.transform.rotation.w = 1.0
    rosCas.addTopic("/tf", msg_type="tf2_msgs/TFMessage")
    rosCas.getTopic("/tf").addData(TFMessage([made]), key=7 * 10**9)
    version = "{}.{}".format(*sys.version_info)
    with pytest.raises(MissingDependency, match=f"no tf2_py for Python {version}: .* python3-tf2"):
        rosCas.lookupTransform("map", "base", 7 * 10**9)
