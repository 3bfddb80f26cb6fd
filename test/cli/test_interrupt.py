# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Ctrl-C ends the waits for each store that a program has open."""

from __future__ import annotations

import os
import signal

import pytest

from cassandra_ros.cli.options import hurry_on_interrupt


class Wait:
    hurried = False

    def hurry(self):
        self.hurried = True


@pytest.fixture
def handled():
    """Returns a function that sets the handler of Ctrl-C; it is put back."""
    before = signal.getsignal(signal.SIGINT)
    yield lambda handler: signal.signal(signal.SIGINT, handler)
    signal.signal(signal.SIGINT, before)


def test_each_of_two_stores_is_hurried(handled):
    handled(signal.default_int_handler)
    waits = [Wait(), Wait()]
    for wait in waits:
        hurry_on_interrupt(wait)
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
    assert [wait.hurried for wait in waits] == [True, True]


def test_a_program_that_handles_it_itself_keeps_its_handler(handled):
    handled(signal.SIG_IGN)
    wait = Wait()
    hurry_on_interrupt(wait)
    os.kill(os.getpid(), signal.SIGINT)
    assert not wait.hurried
