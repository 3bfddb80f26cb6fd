# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The fault table in its short form: whatever fails, each message is stored or accounted for."""

from __future__ import annotations

import pytest

from cassandra_ros.store.blocks.codec import pack_block
from faults import page
from faults.account import Contents, account_of, gone_with_keyspace, text_of_wire, wires_of_block
from faults.numbered import LOG_LINE, Published, count_published, read_log, text_of, topic_of
from faults.results import RESULTS, Results
from faults.table import FAULTS, SHORT, try_fault
from faults.world import World

LONGEST = (
    "copies_at_once",
    "copy_source_killed",
    "copy_store_killed",
    "copy_target_killed",
    "deletions_repeated",
    "disk_full",
    "home_full",
    "home_killed",
    "robot_store_killed",
    "store_away_with_a_spool",
    "topic_converted",
    "topic_removed_at_home",
    "topic_removed_at_robot",
)
"""Faults that take more than a minute also in their short form."""
VARIANTS = (
    "clock_set_forward",
    "connections_silent",
    "conversion_back_killed",
    "converted",
    "copy_killed",
    "copy_killed_converting",
    "copy_killed_packed",
    "deletion_killed_packed",
    "import_killed_packed",
    "indexed",
    "many_topics",
    "messages_deleted",
    "network_silent",
    "other_topics_at_home",
    "recorder_killed_packed",
    "replicators_at_once",
    "simulated_clock_set_back",
    "store_away_longer_than_the_buffer",
    "store_comes_late",
    "store_slow",
    "topic_renamed_on_both_sides",
    "truncated",
    "type_changes",
)
"""Faults of which another one, or a test of a recorder, takes the same way through the code."""


def suite_of(fault):
    """Return the mark of a fault of the table."""
    if fault.group == "cluster" or fault.name in LONGEST:
        return pytest.mark.suite("campaign", "several Cassandras, or more than a minute")
    if fault.name in VARIANTS:
        return pytest.mark.suite("campaign", "another fault takes the same way")
    return pytest.mark.suite("all", "it kills or cuts something, and waits until all is stored")


@pytest.fixture(scope="module")
def world(tmp_path_factory, ros_env):
    with World(tmp_path_factory.mktemp("faults"), ros_env) as made:
        yield made


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=suite_of(fault)) for name, fault in FAULTS.items()]
)
def test_every_message_is_accounted_for(world, name):
    result = try_fault(world, name, *SHORT, short=True)
    if result.skipped:
        pytest.skip(result.skipped)
    assert result.clean, page.summary(result)


def test_a_further_topic_begins_after_each_step():
    assert {topic_of("/n", number, 1, 5) for number in range(100)} == {"/n"}
    begun = [{topic_of("/n", number, 3, 10) for number in range(end)} for end in (10, 20, 30, 90)]
    assert [len(names) for names in begun] == [1, 2, 3, 3]
    assert [topic_of("/n", number, 3) for number in (0, 4, 8)] == ["/n_0", "/n_1", "/n_2"]


def test_the_page_shows_the_last_run():
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.fill(text, Results.load(RESULTS)) == text, "make faults PAGE=1 fills it"


def test_the_account_reads_a_block_as_the_package_writes_it():
    numbers = range(5, 1029)
    wires = [len(text_of(n)).to_bytes(4, "little") + text_of(n).encode() for n in numbers]
    block = pack_block(list(numbers), list(numbers), wires)
    found = [text_of_wire(wire) for wire in wires_of_block(block, len(numbers))]
    assert found == [text_of(number) for number in numbers]


def test_a_log_without_its_last_line(tmp_path):
    path = tmp_path / "log"
    lines = [Published(number, 10**18 + number, 1) for number in range(3)]
    path.write_text("".join(LOG_LINE.format(**line._asdict()) for line in lines)[:-5])
    assert list(read_log(path)) == lines[:2]
    assert count_published(path) == 2


SECOND = 10**9
PUBLISHED = [Published(number, number * SECOND // 10, 1) for number in range(100)]


def sums_of(stored, published=PUBLISHED, **case):
    case = {"kills": [], "removed": [], **case}
    own = account_of(published, Contents(dict(stored), 0), case)
    return {**own.sums, "missing": len(own.missing)}


def told(sums, *names):
    return [sums.get(name, 0) for name in names]


def test_the_account_finds_what_is_missing_doubled_or_unknown():
    stored = dict.fromkeys(range(100), 1)
    assert told(sums_of(stored), "stored", "missing", "doubled", "changed") == [100, 0, 0, 0]
    del stored[40]
    stored[41] = 2
    stored[200] = 1
    assert told(sums_of(stored), "stored", "missing", "doubled", "changed") == [99, 1, 1, 1]


def test_only_what_was_just_published_may_be_in_flight():
    """Killed at 5 s: the next recorder stores from 7 s on. Number 10 is too old, 80 too new."""
    stored = dict.fromkeys([*range(45), *range(70, 100)], 1)
    names = ("in_flight", "unheard", "missing")
    kill = {"kills": [5 * SECOND]}
    assert told(sums_of(stored, **kill), *names) == [5, 20, 0]
    del stored[10], stored[80]
    assert told(sums_of(stored, **kill), *names) == [5, 20, 2]


def test_what_was_published_without_a_subscriber_is_unheard():
    published = [line._replace(connections=int(line.number > 9)) for line in PUBLISHED]
    stored = dict.fromkeys(range(20, 100), 1)
    assert told(sums_of(stored, published), "unheard", "missing") == [10, 10]


def test_what_went_with_the_keyspace_is_not_counted_again_as_lost():
    """It was dropped at 5 s; 40 messages before and 3 after that are missing."""
    missing = [*range(0, 4 * SECOND, SECOND // 10), *range(7 * SECOND, 10 * SECOND, SECOND)]
    told_then = ("write failed", 49 * SECOND // 10, 5 * SECOND, 2)
    told_later = ("write failed", 7 * SECOND, 9 * SECOND, 3)

    def gone(*losses):
        return gone_with_keyspace(missing, list(losses), 5 * SECOND)

    assert gone() == 40
    assert gone(told_later) == 40
    assert gone(told_then, told_later) == 38
    assert gone(told_then) == 40, "one of three later messages is missing, and nobody told it"
    much_later = ("write failed", 60 * SECOND, 61 * SECOND, 3)
    assert gone(told_later, much_later) == 37, "which of them was on its way is not known"
    assert gone(much_later, much_later) == 40, "these were not: more is told than is missing"


def test_what_was_to_be_removed_and_is_there_is_told():
    stored = {number: 1 for number in range(100) if not 20 <= number <= 28}
    case = {"removed": [(2 * SECOND, 3 * SECOND - 1)]}
    assert told(sums_of(stored, **case), "removed", "not_removed", "missing") == [9, 1, 0]
