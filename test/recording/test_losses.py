# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Losses become rows: those of one topic and kind that are near in time are one row."""

from __future__ import annotations

from collections import Counter

import pytest

from cassandra_ros.cli.recorder_report import closing_table
from cassandra_ros.cli.terminal_text import format_time
from cassandra_ros.recording.losses import LossLog, LossTotal
from cassandra_ros.recording.topic_counts import Counts, merge_reports
from cassandra_ros.store.tables.registry import LossKind

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
    assert log.of("/a") == {
        FULL: LossTotal(12, 30 * SEC, 230 * SEC),
        TABLE: LossTotal(1, 120 * SEC, 120 * SEC, "no such field"),
    }
    assert {(loss.node, loss.writer) for loss in log.unsaved()} == {("husky", 7)}


def test_threads_that_lose_by_turns_make_one_row():
    """One thread loses the newest message, another one the oldest."""
    log = LossLog("", 7)
    for new, old in ((10, 5), (11, 6), (12, 4)):
        log.add("/a", FULL, 1, new * SEC, new * SEC, "")
        log.add("/a", FULL, 1, old * SEC, old * SEC, "")
    (loss,) = log.unsaved()
    assert (loss.first_ns, loss.last_ns, loss.count) == (4 * SEC, 12 * SEC, 6)
    # The row may be stored by now, and its first time is its key.
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
    # An unknown number.
    assert log.add("/a", LossKind.UNHEARD, 0, 5, 9, "") == 2
    (loss,) = log.unsaved()
    assert (loss.kind, loss.count, loss.first_ns, loss.last_ns) == (LossKind.UNHEARD, 0, 5, 9)


def counted(losses):
    """Counts of a topic with five received messages and some losses."""
    counts = Counts(LossLog("", 7))
    for _ in range(5):
        counts.received("/a", b"")
    for kind, messages, second, detail in losses:
        counts.lost("/a", messages, kind, second * SEC, detail)
    return counts


@pytest.mark.parametrize("kind", list(LossKind))
def test_only_what_came_is_stored_or_lost(kind):
    """Messages that were not read or not heard were not received: the five are complete."""
    counts = counted([(kind, 2, 9, "")])
    never_came = kind in (LossKind.NOT_READ, LossKind.UNHEARD)
    (report,) = counts.reports({"/a": 1})
    assert report.waiting == (4 if never_came else 2)
    counts.count_rest_as_lost({"/a": 1}, 10 * SEC)
    (report,) = counts.reports({"/a": 1})
    wanted = Counter({kind: 2})
    wanted[LossKind.AT_END] += 4 if never_came else 2
    assert (report.waiting, report.reasons) == (0, wanted)


def test_the_closing_table_tells_each_reason_with_its_number_and_times():
    first = [
        (FULL, 2, 1_400_000_000, "option -b"),
        (LossKind.TABLE_LATE, 1, 1_400_000_005, ""),
        (FULL, 3, 1_400_000_060, "option -b"),
        (LossKind.REFUSED, 1, 1_400_000_070, "too large"),
    ]
    later = [(LossKind.REFUSED, 2, 1_400_000_080, "disk full"), (LossKind.UNHEARD, 0, 0, "")]
    runs = [counted(losses).reports({}) for losses in (first, later)]
    (report,) = merge_reports(runs)
    assert report.lost == 9
    at = {s: format_time((1_400_000_000 + s) * SEC) for s in (0, 5, 60, 70, 80)}
    assert closing_table([report]).splitlines()[-4:] == [
        f"/a: 5 lost: buffer full: option -b; {at[0]} to {at[60]}",
        f"/a: 1 lost: buffer full before its table stood; {at[5]}",
        f"/a: 3 lost: refused by the store: too large, and other causes; {at[70]} to {at[80]}",
        "/a: some lost: publisher not heard",
    ]
