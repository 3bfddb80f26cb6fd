# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rules say what is copied, how, in which order; what they leave out is not said to be there."""

from __future__ import annotations

import pytest
from conftest import ROOT
from copying.test_replicator import SEC, T0, home, messages  # noqa: F401
from std_msgs.msg import Int64
from upkeep.test_convert import fill

from cassandra_ros.errors import InvalidOption
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.stores.copying.copy_status import copy_status
from cassandra_ros.stores.copying.replicator import Bandwidth, Replicator
from cassandra_ros.stores.copying.rules import CopyRule, read_bandwidth, read_rules, read_rules_file


def states(store):
    return {
        each.topic: (each.copied, each.left_out, each.waiting)
        for each in copy_status(store.catalog)
    }


def copy(source, target, text):
    return Replicator(source, target, rules=read_rules(text)).copy()


def test_the_example_can_be_read():
    rules = read_rules_file(str(ROOT / "config/replicator.yaml"))
    assert rules.rate == 4 << 20
    assert rules.of("/odom").format == "packed"
    assert rules.of("/front/image_raw") == CopyRule(
        "/.*/(image_raw|image_color|points).*", order=9, every_ns=SEC, rate=2 << 20
    )
    assert rules.of("/clock") is None
    assert rules.of("/any").order == 5
    assert read_rules_file("") is None


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "a mapping with topics"),
        ("topics: []", "topics must be a list"),
        ("topics: [{pattern: '('}]", "not a regular expression"),
        ("topics: [{pattern: a, evry: 1s}]", "did you mean every?"),
        ("topics: [{pattern: a, every: 1}]", "not a length of time"),
        ("topics: [{pattern: a, every: 0s}]", "not a period"),
        ("topics: [{pattern: a, before: 5s}]", "need an event"),
        ("topics: [{pattern: a, event: ''}]", "name of an event"),
        ("topics: [{pattern: a, order: x}]", "not a whole number"),
        ("topics: [{pattern: a, format: bag}]", "bag"),
        ("topics: [{pattern: a, label: x}]", "not a label"),
        ("topics: [{pattern: a, skip: 1}]", "neither true nor false"),
        ("{topics: [{pattern: a}], rate: fast}", "not a bandwidth"),
        ("{topics: [{pattern: a}], more: 1}", "perhaps rate"),
        ("[", "cannot be used"),
    ],
)
def test_what_cannot_be_used_is_told(text, reason):
    with pytest.raises(InvalidOption, match="x.yaml cannot be used") as caught:
        read_rules(text, "x.yaml")
    assert reason in str(caught.value)


def test_a_bandwidth_is_read():
    found = [read_bandwidth(text) for text in ("500", "1k", "1.5k", "2M", "2MB/s", "3B/s", 7)]
    assert found == [500, 1024, 1536, 2 << 20, 2 << 20, 3, 7]
    with pytest.raises(InvalidOption):
        Bandwidth(0.0)


def test_topics_are_chosen_by_the_first_pattern(rosCas, home):  # noqa: F811
    for topic in ("/a", "/b", "/c"):
        fill(rosCas, "ros", 10, topic=topic)
    report = copy(
        rosCas,
        home,
        """
        topics:
          - {pattern: /b, skip: true}
          - {pattern: '/[ab]', format: packed}
          - {pattern: /never}
        """,
    )
    assert report.unused == ["/never"]
    assert report.complete
    assert [(each.topic, each.format) for each in home.info()] == [("/a", "packed")] * 2
    assert states(rosCas) == {"/a": (20, 0, 0), "/b": (0, 20, 0), "/c": (0, 20, 0)}
    copy(rosCas, home, "topics: [{pattern: .*}]")
    assert states(rosCas) == {"/a": (20, 0, 0), "/b": (20, 0, 0), "/c": (20, 0, 0)}


@pytest.mark.parametrize(
    ("rule", "names"),
    [
        ("run: test", ["test"]),
        ("run: test.*", ["test", "test 2", "tested"]),
        ("run: (test|b)", ["test", "b"]),
        ("run: test, label: site=lab", []),
        ("label: site=", ["b"]),
        ("label: site=la", []),
        ("label: site=lab", ["test 2", "a test", ""]),
    ],
)
def test_a_rule_takes_runs_by_their_whole_names_and_labels(rule, names):
    """A run called like the beginning of another is not that one."""
    sites = {"test": {}, "test 2": {"site": "lab"}, "tested": {"site": "labs"}}
    sites.update({"a test": {"site": "lab", "x": ""}, "b": {"site": ""}, "": {"site": "lab"}})
    runs = [Run("r", n, "recording", name=name, labels=sites[name]) for n, name in enumerate(sites)]
    (only,) = read_rules(f"topics: [{{pattern: a, {rule}}}]").rules
    assert [run.name for run in runs if only.takes(run)] == names


def test_runs_are_chosen_by_name_and_label(rosCas, home):  # noqa: F811
    for writer_id, name, site in ((1, "patrol 1", "lab"), (2, "patrol 2", "hall"), (3, "x", "lab")):
        run = Run("r", writer_id, "recording", name=name, labels={"site": site})
        with rosCas.messageWriter(writer_id=writer_id, nodeID="r", run=run) as writer:
            handle = writer.connect(api_connection("/t", definition_of(Int64), "/n"))
            writer.write(handle, T0 + writer_id, 0, serialize(Int64(writer_id)))
    copy(rosCas, home, "topics: [{pattern: .*, run: patrol.*, label: site=lab}]")
    assert [row[2] >> 32 for row in messages(home)] == [1]
    assert states(rosCas) == {"/t": (1, 2, 0)}
    assert [run.name for run in home.runs()] == ["patrol 1"]
    copy(rosCas, home, "topics: [{pattern: .*}]")
    assert messages(home) == messages(rosCas)
    assert states(rosCas) == {"/t": (3, 0, 0)}


@pytest.mark.parametrize("fmt", ["ros", "packed"])
def test_messages_are_chosen_by_condition_and_thinned(rosCas, home, fmt):  # noqa: F811
    topic = rosCas.addTopic("/t", fmt)
    for n in range(100):
        topic.addData(Int64(n), key=T0 + n * SEC // 10)
    rosCas.catalog.adder.close()
    rules = "topics: [{pattern: .*, every: 1s, where: data >= 50}]"
    report = copy(rosCas, home, rules)
    assert report.complete
    assert [row.message().data for row in home.getTopic("/t").rows()] == [50, 60, 70, 80, 90]
    assert states(rosCas) == {"/t": (5, 95, 0)}
    assert copy(rosCas, home, rules).messages == 0
    topic.addData(Int64(1000), key=T0 + 500 * SEC)
    rosCas.catalog.adder.close()
    assert states(rosCas)["/t"][2] == 1
    assert copy(rosCas, home, rules).messages == 1
    copy(rosCas, home, "topics: [{pattern: .*}]")
    assert messages(home) == messages(rosCas)
    assert states(rosCas) == {"/t": (101, 0, 0)}


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("fmt", ["ros", "packed"])
def test_a_period_goes_on_in_the_next_bucket(rosCas, home, fmt):  # noqa: F811
    with rosCas.messageWriter(writer_id=1, format=fmt) as writer:
        handle = writer.connect(api_connection("/t", definition_of(Int64), "/n"), bucket_ns=SEC)
        for n in range(60):
            writer.write(handle, T0 + n * SEC // 2, n, serialize(Int64(n)))
    rules = "topics: [{pattern: .*, every: 10s}]"
    copy(rosCas, home, rules)
    assert [row.message().data for row in home.getTopic("/t").rows()] == [0, 20, 40]
    assert copy(rosCas, home, rules).messages == 0
    home.removeTopic("/t")
    later = Replicator(rosCas, home, key=Stamp.from_ns(T0 + 5 * SEC), rules=read_rules(rules))
    later.copy()
    assert [row.message().data for row in home.getTopic("/t").rows()] == [10, 20, 40]


@pytest.mark.parametrize("fmt", ["ros", "packed"])
def test_messages_around_events_are_copied(rosCas, home, fmt):  # noqa: F811
    for writer_id, node in ((1, "husky"), (2, "jackal")):
        with rosCas.messageWriter(writer_id=writer_id, nodeID=node, format=fmt) as writer:
            connection = api_connection("/t", definition_of(Int64), f"/{node}")
            handle = writer.connect(connection, bucket_ns=10 * SEC)
            for n in range(60):
                writer.write(handle, T0 + n * SEC, n, serialize(Int64(n)))
    rules = "topics: [{pattern: .*, event: bump, before: 1s, after: 1s}]"

    def there():
        return sorted((row.node, row.message().data) for row in home.getTopic("/t").rows())

    def bump(first, last, node):
        rosCas.addEvent("bump", T0 + first * SEC, T0 + last * SEC, nodeID=node)

    assert copy(rosCas, home, rules).messages == 0
    assert states(rosCas) == {"/t": (0, 120, 0)}
    bump(12, 13, "husky")
    rosCas.addEvent("door", T0, T0 + 50 * SEC)
    assert copy(rosCas, home, rules).messages == 4
    expected = [("husky", n) for n in (11, 12, 13, 14)]
    assert there() == expected
    assert states(rosCas) == {"/t": (4, 116, 0)}
    assert copy(rosCas, home, rules).messages == 0
    # Events that are added later, of all robots, and in a bucket of which some messages are there.
    bump(41, 42, "")
    bump(15, 16, "husky")
    assert copy(rosCas, home, rules).messages == 11
    expected += [("husky", n) for n in (15, 16, 17)]
    expected += [(node, n) for node in ("husky", "jackal") for n in (40, 41, 42, 43)]
    assert there() == sorted(expected)
    assert states(rosCas) == {"/t": (15, 105, 0)}
    assert [event.name for event in home.events()] == ["door", "bump", "bump", "bump"]
    copy(rosCas, home, "topics: [{pattern: .*}]")
    assert messages(home) == messages(rosCas)
    assert states(rosCas) == {"/t": (120, 0, 0)}


def test_topics_go_in_order_and_as_long_as_there_is_time(rosCas, home):  # noqa: F811
    for topic in ("/a", "/b"):
        fill(rosCas, "ros", 10, topic=topic)
    rules = read_rules("topics: [{pattern: /a, order: 2}, {pattern: /b, order: 1}]")
    replicator = Replicator(rosCas, home, rules=rules)
    told = []
    replicator.copy(
        lambda done, total: told.append(
            (done, [t.name for t in home.getAllTopics() if t.countTopicData()])
        )
    )
    assert told[0][1] == ["/b"]
    report = Replicator(rosCas, home, rules=rules).copy(again=True, max_sec=0)
    assert not report.complete
    assert report.messages == 0
    assert report.topics["/a"].left == 20
