# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the tests of nodes share."""

from __future__ import annotations

from contextlib import ExitStack

import pytest
from nodes.children import start_recorder


@pytest.fixture
def recorder(roscore, cassandra, keyspace, rosCas):
    """Start recorders of the test's keyspace; they are gone afterwards."""
    with ExitStack() as children:

        def start(*arguments, ready="recording ", **options):
            child = start_recorder(roscore, cassandra, keyspace, *arguments, **options)
            children.enter_context(child)
            if ready:
                child.await_line(ready)
            return child

        yield start
