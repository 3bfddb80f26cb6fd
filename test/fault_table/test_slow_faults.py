# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The faults that need several servers, or minutes: beside the others, on another worker."""

from __future__ import annotations

import pytest
from fault_table.test_faults import SLOW, try_short, world  # noqa: F401 - a fixture


@pytest.mark.suite("all", "several servers, or minutes")
@pytest.mark.parametrize("name", SLOW)
def test_every_message_is_accounted_for(world, name):  # noqa: F811
    try_short(world, name)
