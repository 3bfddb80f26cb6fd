# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A store is kept under a size: first goes what another one has, and what goes with it is told."""

from __future__ import annotations

import pytest
from copying.test_replicator import SEC, T0, home, messages  # noqa: F401
from std_msgs.msg import Int64, String
from suites import FEW_FORMATS, sparing

from cassandra_ros.errors import InvalidOption
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.store.tables.registry import LossKind
from cassandra_ros.stores.copying import quota
from cassandra_ros.stores.copying.copy_status import copy_status
from cassandra_ros.stores.copying.quota import keep_under
from cassandra_ros.stores.copying.replicator import Replicator
from cassandra_ros.stores.copying.rules import CopyRule, CopyRules


def store(store, topic, first, fmt="ros", writer_id=1):
    """Store ten buckets of ten messages of 8 bytes, from a second on."""
    with store.messageWriter(writer_id=writer_id, format=fmt) as writer:
        connection = api_connection(topic, definition_of(Int64), "/n")
        handle = writer.connect(connection, bucket_ns=SEC)
        for n in range(100):
            writer.write(handle, T0 + first * SEC + n * SEC // 10, n, serialize(Int64(n)))


def times(ros_cas, topic):
    return [(row.t - T0) // SEC for row in ros_cas.getTopic(topic).rows()]


@pytest.mark.parametrize("fmt", sparing(FEW_FORMATS, kept=["packed"]))
def test_what_is_copied_goes_first_and_the_oldest_of_it(rosCas, home, fmt):  # noqa: F811
    store(rosCas, "/a", 0, fmt)
    store(rosCas, "/b", 5, fmt)
    Replicator(rosCas, home, "/b").copy()
    every = messages(home, "/b")
    for uncopied in (True, False):  # also where the older messages of /a may be lost
        report = keep_under(rosCas.catalog, 1200, uncopied=uncopied, dry_run=True)
        assert (report.topics["/b"].dropped, report.topics["/a"].dropped) == (50, 0)
    assert rosCas.getTopic("/b").countTopicData() == 100
    report = keep_under(rosCas.catalog, 1200)
    assert (report.bytes, report.uncopied_bytes) == (1200, 800)
    assert report.share == pytest.approx(2 / 3)
    assert times(rosCas, "/a") == [n // 10 for n in range(100)]
    assert times(rosCas, "/b") == [n // 10 + 5 for n in range(50, 100)]
    assert rosCas.losses() == []
    assert keep_under(rosCas.catalog, 1200).topics["/b"].dropped == 0
    # Neither repeated there, nor taken for something that is missing here.
    assert Replicator(rosCas, home, "/b", with_deletions=True).copy().complete
    assert messages(home, "/b") == every


def test_what_no_store_has_stays_unless_it_may_be_lost(rosCas, home):  # noqa: F811
    store(rosCas, "/a", 0)
    store(rosCas, "/b", 5)
    Replicator(rosCas, home, "/b").copy()
    report = keep_under(rosCas.catalog, 400)
    assert (report.bytes, report.topics["/b"].left, report.topics["/a"].left) == (800, 0, 100)
    report = keep_under(rosCas.catalog, 400, uncopied=True)
    assert (report.bytes, report.topics["/a"].left) == (400, 50)
    assert times(rosCas, "/a") == [n // 10 for n in range(50, 100)]
    losses = rosCas.losses()
    assert {loss.kind for loss in losses} == {LossKind.NO_ROOM}
    assert sum(loss.count for loss in losses) == 50
    assert {loss.topic for loss in losses} == {"/a"}


def test_a_bucket_that_was_added_to_since_is_not_deleted(rosCas, home):  # noqa: F811
    store(rosCas, "/a", 0)
    Replicator(rosCas, home).copy()
    store(rosCas, "/a", 0, writer_id=2)
    report = keep_under(rosCas.catalog, 0)
    assert report.bytes == report.uncopied_bytes == 800
    assert rosCas.getTopic("/a").countTopicData() == 100
    assert {row.seq >> 32 for row in rosCas.getTopic("/a").rows()} == {2}


def half_copied(rosCas, home, writer):  # noqa: F811
    """Copy 60 messages of a bucket that is being written; return the handle for more."""
    handle = writer.connect(api_connection("/a", definition_of(Int64), "/n"), bucket_ns=1000 * SEC)
    for n in range(60):
        writer.write(handle, T0 + n * SEC, n, serialize(Int64(n)))
    writer.flush()
    Replicator(rosCas, home).copy()
    return handle


@pytest.mark.parametrize("fmt", ["ros", "packed"])
def test_of_a_bucket_that_is_copied_in_part_only_the_rest_is_a_loss(rosCas, home, fmt):  # noqa: F811
    with rosCas.messageWriter(writer_id=1, format=fmt) as writer:
        handle = half_copied(rosCas, home, writer)
        for n in range(60, 100):
            writer.write(handle, T0 + n * SEC, n, serialize(Int64(n)))
    there = len(messages(home, "/a"))
    report = keep_under(rosCas.catalog, 10_000)
    assert (report.bytes, report.uncopied_bytes) == (800, 8 * (100 - there))
    assert keep_under(rosCas.catalog, 0, uncopied=True).uncopied_bytes == 0
    assert rosCas.getTopic("/a").countTopicData() == 0
    (loss,) = rosCas.losses()
    assert (loss.kind, loss.count) == (LossKind.NO_ROOM, 100 - there)
    assert (loss.first_ns, loss.last_ns) == (T0 + there * SEC, T0 + 99 * SEC)


@pytest.mark.parametrize("fmt", ["ros", "packed"])
def test_what_is_copied_counts_at_once_though_its_writer_goes_on(rosCas, home, fmt):  # noqa: F811
    """The directory counts a bucket only when its writer closes it, or is dead for a minute."""
    with rosCas.messageWriter(writer_id=1, format=fmt) as writer:
        handle = half_copied(rosCas, home, writer)
        (status,) = copy_status(rosCas.catalog)
        assert (status.copied, status.waiting) == (60, 0)
        writer.write(handle, T0 + 60 * SEC, 60, serialize(Int64(60)))
        writer.flush()
        (status,) = copy_status(rosCas.catalog)
        assert status.copied + status.waiting == 61
        assert status.waiting > 0


def copy_nothing_more(store, home, **options):  # noqa: F811
    """Look at the target as a replicator does that has no time to copy yet."""
    replicator = Replicator(store, home, **options)
    replicator.paused.set()
    replicator.copy()


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_keyspace_that_was_made_again_confirms_nothing(rosCas, connect, new_keyspace, cql):
    store(rosCas, "/a", 0)
    with connect(keyspace=new_keyspace) as home:  # noqa: F811
        Replicator(rosCas, home).copy()
    cql.execute(f"DROP KEYSPACE {new_keyspace}")
    with connect(keyspace=new_keyspace) as home:
        copy_nothing_more(rosCas, home)
        assert keep_under(rosCas.catalog, 0).uncopied_bytes == 800
        (status,) = copy_status(rosCas.catalog)
        assert (status.copied, status.waiting, status.refused) == (0, 100, "")
        Replicator(rosCas, home).copy()
        every = messages(home, "/a")
        assert len(every) == 100
        assert keep_under(rosCas.catalog, 0).bytes == 0
        assert messages(home, "/a") == every


def test_a_topic_that_was_removed_there_is_not_deleted_here(rosCas, home):  # noqa: F811
    store(rosCas, "/a", 0)
    Replicator(rosCas, home).copy()
    home.removeTopic("/a")
    copy_nothing_more(rosCas, home)
    (status,) = copy_status(rosCas.catalog)
    assert (status.copied, status.waiting, status.waiting_bytes) == (0, 100, 800)
    assert keep_under(rosCas.catalog, 0).uncopied_bytes == 800
    assert rosCas.getTopic("/a").countTopicData() == 100


@pytest.mark.parametrize("how", ["refused", "no rule"])
def test_a_topic_that_was_removed_there_and_is_not_copied_again_stays_here(
    rosCas,
    home,  # noqa: F811
    how,
):
    store(rosCas, "/a", 0)
    Replicator(rosCas, home).copy()
    home.removeTopic("/a")
    if how == "refused":
        home.addTopic("/a").addData(String("another type"))
        home.catalog.adder.close()
        assert not Replicator(rosCas, home).copy().complete
    else:
        Replicator(rosCas, home, rules=CopyRules([CopyRule("/b")])).copy()
    assert keep_under(rosCas.catalog, 0).uncopied_bytes == 800
    assert rosCas.getTopic("/a").countTopicData() == 100


def add(store, topic, second, counter, writer_id=1):
    """Store one more message of a writer in a bucket."""
    with store.messageWriter(writer_id=writer_id) as writer:
        handle = writer.connect(api_connection(topic, definition_of(Int64), "/n"), bucket_ns=SEC)
        writer.write(handle, T0 + second * SEC + 1, counter, serialize(Int64(counter)))


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("how", ["again", "late", "rule"])
def test_what_was_deleted_here_stays_there_whatever_happens_to_the_bucket(
    rosCas,
    home,  # noqa: F811
    how,
):
    store(rosCas, "/a", 0)
    Replicator(rosCas, home).copy()
    every = messages(home, "/a")
    keep_under(rosCas.catalog, 400)
    assert rosCas.getTopic("/a").countTopicData() == 50
    if how == "again":
        Replicator(rosCas, home).compare(repair=True)
    elif how == "rule":
        rules = CopyRules([CopyRule(run="none of them")])
        Replicator(rosCas, home, rules=rules).copy()
    add(rosCas, "/a", 2, 1000)
    for _ in range(2):
        assert Replicator(rosCas, home, with_deletions=True).copy().complete
        assert len(messages(home, "/a")) == len(every) + 1


def test_a_topic_that_is_removed_leaves_there_what_was_deleted_for_room(rosCas, home):  # noqa: F811
    store(rosCas, "/a", 0)
    Replicator(rosCas, home).copy()
    keep_under(rosCas.catalog, 400)
    rosCas.removeTopic("/a")
    Replicator(rosCas, home, with_deletions=True).copy()
    assert times(home, "/a") == [n // 10 for n in range(50)]


@pytest.mark.suite("all", "make test asks others of its kind")
def test_what_a_rule_took_stays_there_when_the_rest_is_deleted_for_room(
    rosCas,
    home,  # noqa: F811
    fresh,
):
    """The only copies of thinned messages; and a second store that has a part of them."""
    rules = CopyRules([CopyRule(every_ns=5 * SEC)])
    store(rosCas, "/a", 0)
    with fresh() as other:
        Replicator(rosCas, home, rules=rules).copy()
        Replicator(rosCas, other, to_key=Stamp.from_ns(T0 + 7 * SEC // 2)).copy()
        every, part = messages(home, "/a"), messages(other, "/a")
        assert (len(every), 30 < len(part) < 40) == (2, True)
        keep_under(rosCas.catalog, 0, uncopied=True)
        assert rosCas.getTopic("/a").countTopicData() == 0
        add(rosCas, "/a", 2, 1000)
        for _ in range(2):
            Replicator(rosCas, home, rules=rules, with_deletions=True).copy()
            Replicator(rosCas, other, with_deletions=True).copy()
        assert set(every) <= set(messages(home, "/a"))
        assert set(part) < set(messages(other, "/a"))


def test_what_is_read_from_too_few_copies_confirms_nothing(rosCas, home, connect):  # noqa: F811
    store(rosCas, "/a", 0)
    with connect(keyspace=rosCas.keyspace, consistency="ONE") as few:
        assert Replicator(few, home).copy().messages == 100
        assert keep_under(rosCas.catalog, 0).uncopied_bytes == 800
        with pytest.raises(InvalidOption, match="needs a consistency level of a quorum"):
            Replicator(few, home, with_deletions=True)
    Replicator(rosCas, home).copy()
    assert keep_under(rosCas.catalog, 0).bytes == 0
    assert len(messages(home, "/a")) == 100


def test_what_comes_while_room_is_made_stays(rosCas, home, monkeypatch):  # noqa: F811
    """A bucket of which more was stored since it was listed is not deleted."""
    store(rosCas, "/a", 0)
    Replicator(rosCas, home).copy()
    listed = quota._entries

    def late(*args):
        entries = listed(*args)
        add(rosCas, "/a", 0, 1000)
        return entries

    monkeypatch.setattr(quota, "_entries", late)
    keep_under(rosCas.catalog, 0)
    assert times(rosCas, "/a") == [0] * 11
