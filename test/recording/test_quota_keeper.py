# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A recorder keeps its store under a size while it grows."""

from __future__ import annotations

import contextlib
import logging
import re
from concurrent.futures import Future

import pytest
from copying.test_quota import store, times
from copying.test_replicator import home, messages  # noqa: F401
from nodes.children import await_true

from cassandra_ros.recording.quota_keeper import QuotaKeeper
from cassandra_ros.recording.store_future import store_future
from cassandra_ros.store.tables.registry import LossKind
from cassandra_ros.stores.copying.quota import Quota
from cassandra_ros.stores.copying.replicator import Replicator


@contextlib.contextmanager
def keeping(future, quota):
    keeper = QuotaKeeper(future, quota, period_sec=0.1)
    try:
        yield keeper
    finally:
        keeper.stop(180)


def sizes(keeper):
    return keeper.report.bytes, keeper.report.uncopied_bytes


def test_the_store_is_kept_under_its_size_while_it_grows(rosCas, home, caplog):  # noqa: F811
    store(rosCas, "/b", 0)
    Replicator(rosCas, home, "/b").copy()
    every = messages(home, "/b")
    connected = Future()
    with keeping(connected, Quota(1200)) as keeper, caplog.at_level(logging.WARNING):
        assert keeper.report is None  # the store does not answer yet
        connected.set_result(rosCas.catalog)
        await_true(lambda: keeper.report is not None)
        assert sizes(keeper) == (800, 0)
        assert not keeper.report.nearly_full
        store(rosCas, "/a", 5)
        await_true(lambda: sizes(keeper) == (1200, 800))
        assert times(rosCas, "/b") == [n // 10 for n in range(50, 100)]
        assert not keeper.report.nearly_full
        store(rosCas, "/c", 5)
        await_true(lambda: sizes(keeper) == (1600, 1600))
        assert keeper.report.nearly_full
    assert times(rosCas, "/b") == []
    assert len(times(rosCas, "/a")) == len(times(rosCas, "/c")) == 100
    # One warning; a check may have come in the middle of the writing.
    # A busy server may be late with an answer, which others warn of.
    (warned,) = (text for text in caplog.messages if "maximum size" in text)
    assert re.fullmatch(r"messages that no other store has take \d+% of the maximum size", warned)
    assert rosCas.losses() == []
    assert messages(home, "/b") == every


def test_what_no_store_has_is_lost_only_if_that_is_asked_for(rosCas):
    store(rosCas, "/a", 0)
    with keeping(store_future(rosCas.catalog), Quota(400)) as keeper:
        await_true(lambda: keeper.report is not None)
        assert keeper.report.share == pytest.approx(2.0)
        assert len(times(rosCas, "/a")) == 100
    with keeping(store_future(rosCas.catalog), Quota(400, uncopied=True)) as keeper:
        await_true(lambda: keeper.report is not None)
        assert keeper.report.bytes == 400
    assert times(rosCas, "/a") == [n // 10 for n in range(50, 100)]
    losses = rosCas.losses()
    assert {loss.kind for loss in losses} == {LossKind.NO_ROOM}
    assert sum(loss.count for loss in losses) == 50
