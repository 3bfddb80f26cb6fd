# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Losses become rows: of one topic and kind together where they lie together in time."""

from __future__ import annotations

from cassandra_ros.recording.losses import LossLog
from cassandra_ros.store.registry import LossKind

SEC = 10**9
FULL, TABLE = LossKind.BUFFER_FULL, LossKind.NO_TABLE


def rows(log):
    return [
        (loss.topic, loss.kind, loss.first_ns, loss.last_ns, loss.count) for loss in log.unsaved()
    ]


def test_losses_that_lie_together_are_one_row():
    log = LossLog("husky", 7)
    for second in (100, 110, 169):
        log.add("/a", FULL, 2, second * SEC, second * SEC, "")
    log.add("/a", TABLE, 1, 120 * SEC, 120 * SEC, "no such field")
    log.add("/b", FULL, 1, 120 * SEC, 130 * SEC, "")
    log.add("/a", FULL, 5, 230 * SEC, 230 * SEC, "")  # more than a minute later
    log.add("/a", FULL, 1, 30 * SEC, 30 * SEC, "")  # time went back
    assert sorted(rows(log)) == sorted(
        [
            ("/a", FULL, 100 * SEC, 169 * SEC, 6),
            ("/a", FULL, 230 * SEC, 230 * SEC, 5),
            ("/a", FULL, 30 * SEC, 30 * SEC, 1),
            ("/a", TABLE, 120 * SEC, 120 * SEC, 1),
            ("/b", FULL, 120 * SEC, 130 * SEC, 1),
        ]
    )
    assert log.of("/a") == {FULL: 12, TABLE: 1}
    assert log.details("/a") == {TABLE: "no such field"}
    assert {(loss.node, loss.writer) for loss in log.unsaved()} == {("husky", 7)}


def test_threads_that_lose_by_turns_make_one_row():
    """One drops what has just come, another what has waited longest."""
    log = LossLog("", 7)
    for new, old in ((10, 5), (11, 6), (12, 4)):
        log.add("/a", FULL, 1, new * SEC, new * SEC, "")
        log.add("/a", FULL, 1, old * SEC, old * SEC, "")
    (loss,) = log.unsaved()
    assert (loss.first_ns, loss.last_ns, loss.count) == (4 * SEC, 12 * SEC, 6)
    # The store may know it by now, and where it begins is its key there.
    log.add("/a", FULL, 1, 3 * SEC, 3 * SEC, "")
    log.add("/a", FULL, 1, 100 * SEC, 100 * SEC, "")
    log.add("/a", FULL, 1, 13 * SEC, 13 * SEC, "")
    log.saved(loss)
    later = [(loss.first_ns // SEC, loss.last_ns // SEC, loss.count) for loss in log.unsaved()]
    assert later == [(3, 13, 2), (100, 100, 1)]


def test_what_has_grown_since_is_saved_again():
    log = LossLog("", 7)
    log.add("/a", FULL, 1, 0, 0, "")
    (first,) = log.unsaved()
    log.add("/a", FULL, 1, SEC, SEC, "")
    log.saved(first)
    (second,) = log.unsaved()
    assert (second.first_ns, second.last_ns, second.count) == (0, SEC, 2)  # the same row
    log.saved(second)
    assert log.unsaved() == []
    # A number that nobody knows.
    assert log.add("/a", LossKind.UNHEARD, 0, 5, 9, "") == 2
    (loss,) = log.unsaved()
    assert (loss.kind, loss.count, loss.first_ns, loss.last_ns) == (LossKind.UNHEARD, 0, 5, 9)
