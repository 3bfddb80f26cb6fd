# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs: which there are, how they began, what they lost; and every read of one of them alone."""

from __future__ import annotations

import re
import xmlrpc.client

import pytest
from geometry_msgs.msg import PointStamped
from suites import sparing

from cassandra_ros.errors import InvalidName, InvalidOption, MessageNotFound, RunNotFound
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.query.plan.pushdown import PLANS
from cassandra_ros.store.tables.context_blob import (
    NodeGraph,
    RunContext,
    decode_context,
    encode_context,
)
from cassandra_ros.store.tables.directory import FEW_BUCKETS
from cassandra_ros.store.tables.registry import Loss, LossKind, Run
from cassandra_ros.topics import removal

PARAMS = {
    "use_sim_time": True,
    "gains": {"p": 1.5, "i": 0, "d": -0.0, "table": [1, 2.0, "three", [], {}, None]},
    "robot_description": "<robot name='ä ☃ \ud83e'/>",
    "odd": {"$binary": "no", "nan": float("inf"), "": ""},
    "when": xmlrpc.client.DateTime("20260102T03:04:05"),
    "bytes": xmlrpc.client.Binary(b"\x00\xff"),
    "big": -(2**31),
}
GRAPH = NodeGraph({"/scan": ["/laser"]}, {"/scan": ["/rec", "/map"]}, {}, {"/scan": "a/B"})


def test_a_context_comes_back_as_it_was(connect, keyspace):
    with connect(keyspace=keyspace) as store:
        store.catalog.keyspace.side_tables.make()
        registry = store.catalog.keyspace.registry
        for writer, name in ((7, "corridor"), (8, "yard")):
            registry.put_run(Run("r", writer, "recording", name=name), started=True)
        registry.put_context(7, "r", RunContext(PARAMS, GRAPH))
        for run in ("corridor", 7, "7"):
            found = store.runContext(run)
            assert (found.params, found.graph) == (PARAMS, GRAPH)
            assert type(found.params["bytes"]) is xmlrpc.client.Binary
            assert type(found.params["big"]) is type(found.params["gains"]["i"]) is int
        assert found.graph.nodes == ["/laser", "/map", "/rec"]
        assert store.runContext("yard") is None
        registry.put_run(Run("r", 9, "recording", name="corridor"), started=True)
        assert store.runContext("corridor") is None  # the newest has none
        assert store.runContext(7).params == PARAMS
        with pytest.raises(RunNotFound, match="did you mean corridor"):
            store.runContext("coridor")
        for bad in (None, True, 1.5, b"x", 0, 2**31):
            with pytest.raises((InvalidName, RunNotFound)):
                store.runContext(bad)


@pytest.mark.parametrize("bad", [{"a": {1: 2}}, {"a": object()}, {"a": {2}}])
def test_what_no_parameter_server_holds_is_refused(bad):
    with pytest.raises(InvalidOption, match="/a is a"):
        encode_context(RunContext(bad))


def test_parameters_are_nested_as_deep_as_can_be_read_back():
    deep: object = 1
    for _ in range(150):
        deep = [deep]
    context = RunContext({"a": deep})
    assert decode_context(encode_context(context)) == context
    for _ in range(100):
        deep = [deep]
    with pytest.raises(InvalidOption, match="nested deeper"):
        encode_context(RunContext({"a": deep}))


def test_losses_are_kept_beside_the_data(connect, keyspace):
    kinds = list(LossKind)
    with connect(keyspace=keyspace) as store:
        store.catalog.keyspace.side_tables.make()
        registry = store.catalog.keyspace.registry
        assert store.losses() == []
        registry.put_run(Run("r", 7, "recording", name="one"))
        first = Loss("/scan", "r", 7, kinds[0], 10, 20, 3)
        more = [Loss("/scan", "", 8, kind, 30, 40, 0) for kind in kinds]
        for loss in [first, first, *more, Loss("tf", "r", 8, kinds[1], 5, 90, 1)]:
            registry.put_loss(loss)
        assert len(store.losses()) == len(kinds) + 2
        registry.put_loss(Loss("/scan", "r", 7, kinds[0], 10, 25, 9))
        assert store.losses(run="one") == [Loss("/scan", "r", 7, kinds[0], 10, 25, 9)]
        assert {loss.kind for loss in store.losses("scan", nodeID="")} == set(kinds)
        assert [loss.topic for loss in store.losses(key=41)] == ["tf"]
        assert [loss.topic for loss in store.losses(["/tf", "nowhere"], to_key=5)] == ["tf"]
        assert store.losses(key=91) == store.losses(to_key=4) == []


def test_the_description_of_a_run_counts_its_own_losses(rosCas):
    for writer_id, name in ((7, "one"), (8, "two")):
        run = Run("r", writer_id, "api", name=name)
        with rosCas.messageWriter(writer_id=writer_id, nodeID="r", run=run) as writer:
            handle = writer.connect(connection_of("/p", PointStamped))
            writer.write(handle, T0, 0, serialize(PointStamped()))
        loss = Loss("/p", "r", writer_id, LossKind.NO_TABLE, 10, 20, writer_id)
        rosCas.catalog.keyspace.registry.put_loss(loss)
    assert [info.lost for info in rosCas.info(run="one")] == [7]
    assert [info.lost for info in rosCas.info()] == [7 + 8]


def test_names_and_labels_are_texts(rosCas):
    for wrong in (
        Run("", 7, "api", name=7),
        Run("", 7, "api", name="\udcff"),
        Run("", 7, "api", labels=["a"]),
        Run("", 7, "api", labels={"a": 1}),
        Run("", 7, "api", labels={1: "a"}),
        Run("", 7, "api", labels={"": "a"}),
    ):
        with pytest.raises(InvalidName, match="give"):
            rosCas.messageWriter(run=wrong)
    assert rosCas.runs() == []
    for name in ("", "ä ☃\n'\"%_", "7"):
        run = Run("", 7, "api", name=name, labels={"ü": "☃", "empty": ""})
        with rosCas.messageWriter(writer_id=7, run=run) as writer:
            handle = writer.connect(connection_of("/p", PointStamped))
            writer.write(handle, T0, 0, serialize(PointStamped()))
        assert len(list(rosCas.readMessages(run=name or "7"))) == 1
        rows = rosCas.executeCQL("SELECT RUN FROM p WHERE RUN = ?", [name or "7"])
        assert rows == [(name or "7",)]
        (found,) = rosCas.runs()
        assert (found.name, found.labels) == (name, {"ü": "☃", "empty": ""})


def test_losses_follow_their_topic(rosCas):
    for topic in ("/a", "/b"):
        rosCas.addTopic(topic, msg_type="std_msgs/String")
        rosCas.catalog.keyspace.registry.put_loss(Loss(topic, "r", 7, LossKind.NO_TABLE, 10, 20, 3))
    rosCas.renameTopic("/a", "/c")
    assert [(loss.topic, loss.count) for loss in rosCas.losses()] == [("/b", 3), ("/c", 3)]
    rosCas.truncateTopic("/b")
    assert [loss.topic for loss in rosCas.losses()] == ["/c"]
    rosCas.removeTopic("/c")
    assert rosCas.losses() == []


T0 = 1_500_000_000 * SECOND_NS
NAMES = ("morning", "evening", "")
"""Names of the runs of three writers that write at once; '' = no name. A fourth has no run."""


class Recorded:
    """Messages of one topic, of four writers, which share some buckets."""

    def __init__(self, store, format):
        self.store = store
        self.rows = []
        connection = connection_of("/point", PointStamped)
        for number, name in enumerate([*NAMES, None]):
            writer = 100 + number
            run = None if name is None else Run("r", writer, "recording", name=name)
            with store.messageWriter(writer_id=writer, format=format, run=run) as each:
                handle = each.connect(connection, bucket_ns=10 * SECOND_NS)
                # The first has the first minute for itself, and its last second is everybody's.
                for n in range(40 if number else 100):
                    t = T0 + (n if not number else n + 80) * SECOND_NS
                    msg = PointStamped()
                    msg.point.x, msg.header.frame_id = float(n % 10), f"w{writer}"
                    each.write(handle, t, n, serialize(msg))
                    self.rows.append((t, writer, n % 10))
        self.rows.sort()

    def of(self, *writers):
        return [row for row in self.rows if row[1] in writers]


def connection_of(topic, kind):
    header = {"type": kind._type, "md5sum": kind._md5sum, "message_definition": kind._full_text}
    return live_connection(topic, header)


def test_a_run_is_found_among_many_writers_of_one_bucket(rosCas):
    """More writers than the directory gives in its first answer to a read of few rows."""
    writers = range(1, FEW_BUCKETS + 3)
    for writer_id in writers:
        run = Run("", writer_id, "recording", name=f"run {writer_id}")
        with rosCas.messageWriter(writer_id=writer_id, run=run) as writer:
            handle = writer.connect(connection_of("/point", PointStamped), bucket_ns=SECOND_NS)
            writer.write(handle, T0 + writer_id, 0, serialize(PointStamped()))
    topic = rosCas.getTopic("/point")
    for reverse in (False, True):
        for writer_id in writers:
            found = topic.items(run=f"run {writer_id}", limit=1, reverse=reverse)
            assert [key.ns for key, _ in found] == [T0 + writer_id]


RUNS = {"morning": 100, "evening": 101, 102: 102, "103": 103}


@pytest.fixture(scope="module", params=sparing(["ros", "binary"], ["ros"], "campaign"))
def recorded(request, connect, keyspaces):
    with keyspaces.lend() as name, connect(keyspace=name) as store:
        made = Recorded(store, request.param)
        store.getTopic("/point").createIndex("point.x")
        yield made


@pytest.mark.parametrize("run", RUNS)
def test_every_read_tells_runs_apart(recorded, run):
    store, topic = recorded.store, recorded.store.getTopic("point")
    own = recorded.of(RUNS[run])
    times = [t for t, _, _ in own]
    first, last = times[0], times[-1]

    def found(rows):
        return [(row.t, row.seq >> 32) for row in rows]

    expected = [row[:2] for row in own]
    assert found(topic.rows(run=run)) == found(store.readMessages(run=run)) == expected
    assert found(topic.rows(run=run, reverse=True)) == expected[::-1]
    assert found(store.readMessages("/point", received=True, run=run)) == expected
    assert [key.to_nsec() for key, _ in topic.items(run=run)] == times
    assert (topic.first(run=run).ns, topic.last(run=run).ns) == (first, last)
    assert {m.header.frame_id for m in topic.getData(0, T0 * 2, run=run)} == {f"w{RUNS[run]}"}
    shared = T0 + 85 * SECOND_NS
    assert topic.getData(shared, run=run).header.frame_id == f"w{RUNS[run]}"
    assert topic.getRow(shared + 1, nearest="before", run=run).seq >> 32 == RUNS[run]
    third = [row[:2] for row in own if row[2] == 3]
    where = {"/point": "point.x = 3"}
    assert found(store.readMessages(where=where, run=run)) == third
    assert topic.countTopicData(run=run) == len(own)
    assert topic.countTopicData(first + 1, last - 1, run=run) == len(own) - 2
    assert topic.countTopicData(where="point.x = 3", run=run) == len(third)
    arrays = topic.getArrays(["KEY", "RUN", "point.x"], run=run)
    assert arrays["KEY"].tolist() == times and set(arrays["RUN"]) == {str(run)}
    assert len(topic.toDataFrame("point.x", where="point.x = 3", run=run)) == len(third)
    pairs = list(store.nearestMessages("point", "point", 0.0, run=run))
    assert found(a for a, _ in pairs) == found(b for _, b in pairs) == expected
    (info,) = store.info(run=run)
    assert (info.count, info.first_ns, info.last_ns) == (len(own), first, last)
    for plan in PLANS:
        select = store.statements.select
        text = "SELECT KEY, RUN FROM point WHERE point.x = 3"
        rows = [(t, str(run)) for t, _ in third]
        assert [(k.ns, r) for k, r in select(text, plan=plan, run=run)] == rows
        text += " AND RUN = ?"
        assert [(k.ns, r) for k, r in select(text, [str(run)], plan=plan)] == rows
    assert store.executeCQL("SELECT count(*) FROM point", run=run) == [(len(own),)]
    assert store.iterCQL("SELECT count(*) FROM point WHERE RUN = ?", [str(run)]).counted


def test_buckets_of_other_runs_are_not_read(recorded):
    store = recorded.store
    text = "SELECT point.y FROM point WHERE RUN = ?"
    assert store.explainCQL(text, ["evening"]).rows_returned == 40
    # Only the buckets in which it is listed, as the counter of the pages' rows says.
    whole = store.explainCQL("SELECT point.x FROM point WHERE point.z = 0", run="evening")
    assert (whole.filtered + whole.whole, whole.buckets) == (4, 12)


def test_RUN_in_conditions(recorded):
    store, topic = recorded.store, recorded.store.getTopic("point")
    names = {100: "morning", 101: "evening", 102: "102", 103: "103"}
    for text, test in {
        "RUN != 'morning'": lambda w, x: names[w] != "morning",
        "NOT RUN = 'morning'": lambda w, x: names[w] != "morning",
        "RUN IN ('morning', '103')": lambda w, x: names[w] in ("morning", "103"),
        "RUN LIKE '%ning' AND point.x = 3": lambda w, x: names[w].endswith("ning") and x == 3,
        "RUN = '102' OR point.x = 3": lambda w, x: w == 102 or x == 3,
        "RUN = '100'": lambda w, x: False,
        "RUN = 'morning' AND RUN = 'evening'": lambda w, x: False,
        "RUN > '10' AND RUN < '103'": lambda w, x: w == 102,
        "RUN IS NULL": lambda w, x: False,
    }.items():
        expected = [t for t, w, x in recorded.rows if test(w, x)]
        assert [k.to_nsec() for k, _ in topic.items(where=text)] == expected, text
        assert topic.countTopicData(where=text) == len(expected)
    found = store.executeCQL("SELECT min(RUN), max(RUN), count(RUN) FROM point")
    assert found == [("102", "morning", len(recorded.rows))]
    assert store.executeCQL("SELECT KEY FROM point WHERE RUN = 'morning'", run="evening") == []


def test_unknown_runs(recorded):
    store, topic = recorded.store, recorded.store.getTopic("point")
    for ask in (
        lambda: store.readMessages(run="evenin"),
        lambda: topic.countTopicData(run="evenin"),
        lambda: topic.removeData(run="evenin"),
        lambda: store.executeCQL("SELECT KEY FROM point", run="evenin"),
        lambda: store.info(run="evenin"),
    ):
        with pytest.raises(RunNotFound, match="did you mean evening"):
            ask()
    with pytest.raises(RunNotFound, match="no run 104"):
        topic.getData(1, 2, run=104)
    with pytest.raises(InvalidName):
        topic.rows(run=1.5)
    with pytest.raises(MessageNotFound, match="of this run"):
        topic.getData(T0 + 1, run="morning")


@pytest.mark.parametrize(
    ("condition", "text"),
    [
        ("RUN = 'mornin'", "there is no run 'mornin' in keyspace .*; did you mean morning"),
        ("RUN = '100'", "there is no run '100' .*; did you mean morning, run 100"),
        ("RUN IN ('mornin', 'x') AND point.x = 3", "no run 'mornin'.*no run 'x'"),
        (
            "NODE = 'R' AND point.x >= 0",
            "no message in keyspace .* is of robot 'R'; did you mean r",
        ),
        ("EVENT 'bmup'", "there is no event 'bmup' in keyspace .*; did you mean bump"),
        ("EVENT LIKE 'x%'", "there is no event 'x%'"),
    ],
)
def test_a_condition_with_an_unknown_name_says_so(recorded, caplog, condition, text):
    store, topic = recorded.store, recorded.store.getTopic("point")
    if not list(store.events()):
        store.addEvent("bump", T0, T0 + 1)
    for ask in (
        lambda: store.executeCQL(f"SELECT KEY FROM point WHERE {condition}"),
        lambda: store.executeCQL(f"SELECT count(*) FROM point WHERE {condition}")[0][0] or [],
        lambda: list(topic.items(where=condition)),
        lambda: topic.removeData(where=condition) or [],
    ):
        caplog.clear()
        assert ask() == []
        assert re.search(text, " ".join(caplog.messages)), caplog.messages


@pytest.mark.parametrize(
    "condition",
    [
        "RUN = 'morning' AND RUN = 'evening'",
        "RUN = '103' AND point.x > 99",
        "NODE = 'r' AND KEY < '1980-01-01'",
    ],
)
def test_a_condition_of_known_names_that_finds_nothing_warns_of_none(recorded, caplog, condition):
    assert recorded.store.executeCQL(f"SELECT KEY FROM point WHERE {condition}") == []
    assert caplog.messages == []


def test_a_robot_without_messages_is_told(recorded, connect, caplog):
    with connect(keyspace=recorded.store.keyspace) as store:
        for node in ("rr", "rr", "r", ""):
            store.getTopic("point").countTopicData(nodeID=node)
    (message,) = caplog.messages
    assert "no message in keyspace" in message and "is of robot 'rr'; did you mean r?" in message


def test_runs_of_one_name_are_told_apart(rosCas):
    connection = connection_of("/point", PointStamped)
    for writer, node in ((7, "husky"), (8, "jackal")):
        run = Run(node, writer, "import", name="run.bag", source=f"/{node}/run.bag")
        with rosCas.messageWriter(writer_id=writer, nodeID=node, run=run) as each:
            each.write(each.connect(connection), T0, 1, serialize(PointStamped()))
    topic, runs = rosCas.getTopic("/point"), rosCas.catalog.keyspace.runs
    assert topic.countTopicData(run="run.bag") == 2
    for run in (8, "8", "/jackal/run.bag", "/jackal/../jackal/run.bag"):
        assert [row.node for row in topic.rows(run=run)] == ["jackal"]
    with pytest.raises(RunNotFound, match="one of these: 7 of robot husky .*, 8 of robot"):
        topic.countTopicData(run="/other/run.bag")
    text = runs.describe_several("run.bag")
    assert text.startswith("2 runs are called run.bag: ")
    assert "7 of robot husky (from /husky/run.bag)" in text
    assert runs.describe_several("8") == ""


@pytest.mark.parametrize("how", ["remove", "between", "where", "statement", "argument"])
def test_a_delete_of_a_run_removes_its_rows_alone(rosCas, how):
    made = Recorded(rosCas, "ros")
    topic = rosCas.getTopic("point")
    gone = made.of(101)
    if how == "remove":
        assert topic.removeData(run="evening") == len(gone)
    elif how == "between":
        low, high = T0 + 85 * SECOND_NS, T0 + 99 * SECOND_NS
        gone = [row for row in gone if low <= row[0] <= high]
        assert topic.removeData(low, high, run="evening") == len(gone) == 15
    elif how == "where":
        gone = [row for row in gone if row[2] == 3]
        assert topic.removeData(where="point.x = 3", run="evening") == len(gone) == 4
    elif how == "statement":
        text = "DELETE FROM point WHERE RUN = 'evening'"
        assert rosCas.executeCQL(text) == [(len(gone),)]
    else:
        text = "DELETE FROM point WHERE KEY > 0"
        assert rosCas.executeCQL(text, run="evening") == [(len(gone),)]
    left = [row for row in made.rows if row not in gone]
    assert [(row.t, row.seq >> 32) for row in topic.rows()] == [row[:2] for row in left]
    assert topic.countTopicData() == len(left)
    assert topic.countTopicData(run="evening") == 40 - len(gone)
    assert topic.removeData(run="morning") == 100
    assert topic.countTopicData() == len(left) - 100


def test_a_run_is_listed_until_all_of_it_is_deleted(rosCas):
    Recorded(rosCas, "ros")
    low, high = T0 + 85 * SECOND_NS, T0 + 99 * SECOND_NS
    assert rosCas.upkeep.delete(key=low, to_key=high, run="evening") == {"/point": 15}
    assert "evening" in [run.name for run in rosCas.runs()]
    assert rosCas.upkeep.delete(run="evening") == {"/point": 25}
    assert "evening" not in [run.name for run in rosCas.runs()]


def test_the_key_of_one_run_removes_nothing_of_another(rosCas):
    connection = connection_of("/point", PointStamped)
    for writer, node in ((7, ""), (8, "r2")):
        with rosCas.messageWriter(
            writer_id=writer, nodeID=node, run=Run(node, writer, "api")
        ) as each:
            each.write(each.connect(connection), T0, 1, serialize(PointStamped()))
    topic = rosCas.getTopic("/point")
    first, second = (row.key for row in topic.rows())
    for key, whose in ((first, {"run": 8}), (second, {"run": "7"}), (first, {"nodeID": "r2"})):
        with pytest.raises(MessageNotFound):
            topic.removeData(key, **whose)
    assert topic.countTopicData() == 2
    assert topic.removeData(first, run=7) == 1
    assert [row.key for row in topic.rows()] == [second]


@pytest.mark.parametrize("key_format", ["manual", "hash", "msg_part"])
def test_runs_of_topics_with_other_keys(rosCas, key_format):
    part = {"key_part": "header.frame_id"} if key_format == "msg_part" else {}
    topic = rosCas.addTopic(
        "/map", msg_type="geometry_msgs/PointStamped", key_format=key_format, **part
    )
    for number, name in enumerate(NAMES):
        run = Run("", 100 + number, "recording", name=name)
        with rosCas.messageWriter(writer_id=100 + number, run=run) as writer:
            handle = writer.connect(connection_of("/map", PointStamped))
            for n in range(3):
                msg = PointStamped()
                msg.header.frame_id, msg.point.x = f"frame{n}", number
                writer.write(handle, T0 + n, n, serialize(msg), f"frame{n}")
    for number, run in enumerate(("morning", "evening", 102)):
        assert [m.point.x for _, m in topic.items(run=run)] == [number] * 3
        assert topic.countTopicData(run=run) == 3
        where = f"RUN = '{run}' AND point.y = 0"
        assert [m.point.x for _, m in topic.items(where=where)] == [number] * 3
        if key_format != "hash":
            assert [m.point.x for _, m in topic.items("frame1", run=run)] == [number]
            assert topic.getData("frame1", run=run).point.x == number
        (info,) = rosCas.info(run=run)
        assert info.count == 3
    assert topic.removeData(run="evening") == 3
    assert {m.point.x for _, m in topic.items()} == {0, 2}


def test_who_opens_the_bucket_during_a_delete_of_a_run_keeps_what_he_writes(rosCas, monkeypatch):
    connection, mark = connection_of("/point", PointStamped), removal._mark_deleted

    def put(writer, times):
        with rosCas.messageWriter(writer_id=writer, run=Run("", writer, "api")) as each:
            handle = each.connect(connection)
            for n, t in enumerate(times):
                each.write(handle, T0 + t, n, serialize(PointStamped()))

    def marked(space, table, node, bucket, but=()):
        found = mark(space, table, node, bucket, but)
        if not but:  # the run is the only one that is listed there, and its rows are known
            put(8, [2])
        return found

    put(7, [1, 3])
    monkeypatch.setattr(removal, "_mark_deleted", marked)
    topic = rosCas.getTopic("/point")
    assert topic.removeData(run="7") == 2
    assert [row.t - T0 for row in topic.rows()] == [2]
    assert topic.countTopicData() == 1


def test_the_numbers_of_a_run_follow_a_renamed_topic(rosCas):
    run = Run("r", 7, "recording", name="patrol")
    with rosCas.messageWriter(writer_id=7, nodeID="r", run=run) as writer:
        handle = writer.connect(connection_of("/point", PointStamped))
        writer.write(handle, T0, 1, serialize(PointStamped()))
    rosCas.renameTopic("/point", "/place")
    (stored,) = rosCas.runs()
    assert stored.stored == {"/place": 1} and stored.ended is not None
