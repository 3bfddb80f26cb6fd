# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A drive through a room, and a viewer of it; modules with other messages make their own."""

from __future__ import annotations

import pytest
from mapping.room import Drive
from viewers import running_viewer


@pytest.fixture(scope="module")
def store(fresh):
    with fresh() as made:
        Drive().store(made, ("/tf", "/tf_static", "/odom", "/scan"), "robot")
        yield made


@pytest.fixture(scope="module")
def viewer(store):
    with running_viewer(store) as running:
        yield running
