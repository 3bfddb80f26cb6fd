# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The API as it is used where Python is typed: what objects print, list, count and take."""

from __future__ import annotations

import code
import pickle
import rlcompleter
from datetime import datetime, timedelta, timezone

import genpy
import numpy as np
import pandas
import pytest
from geometry_msgs.msg import Twist
from std_msgs.msg import Duration, Header, String

from cassandra_ros.errors import InvalidKey
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.printable import NOTEBOOK_ROWS

SEC = 10**9
T0 = 1_368_021_980 * SEC
KEYS = [T0 + n * SEC + n for n in range(5)]


def twist(n):
    msg = Twist()
    msg.linear.x = float(n)
    return msg


@pytest.fixture(scope="module")
def store(fresh):
    with fresh() as store:
        topic = store.addTopic("/cmd_vel", "packed", msg_type="geometry_msgs/Twist")
        for n, t in enumerate(KEYS):
            topic.addData(twist(n), key=genpy.Time(0, t), nodeID="husky")
        store.addTopic("/empty", msg_type="std_msgs/Header")
        store.addTopic("/untyped")
        names = store.addTopic("/maps", key_format="manual")
        names.addData(String(data="<b>"), key="kitchen")
        yield store


@pytest.fixture(scope="module")
def topic(store):
    return store.getTopic("/cmd_vel")


def test_objects_say_what_they_are(store, topic, cassandra):
    first, last = iso_time(KEYS[0]), iso_time(KEYS[-1])
    assert repr(store) == (
        f"<RosCassandra {cassandra.host} port {cassandra.port}: "
        f"4 topics in keyspace {store.keyspace}>"
    )
    assert repr(topic) == (
        "<CassandraTopic /cmd_vel: geometry_msgs/Twist in format packed, messages: 5 "
        f"from {first} to {last}, robots: husky>"
    )
    assert repr(store.getTopic("/empty")) == (
        "<CassandraTopic /empty: std_msgs/Header in format ros, messages: 0>"
    )
    assert repr(store.getTopic("/untyped")) == (
        "<CassandraTopic /untyped: no type yet, its first message fixes it>"
    )
    maps = store.getTopic("/maps")
    assert "String in format ros, messages: under names (manual)>" in repr(maps)
    (row,) = store.readMessages("/maps")
    assert repr(row).startswith("<StoredRow /maps 'kitchen' 20")
    assert repr(row).endswith("Z: std_msgs/String, 7 bytes>")
    assert repr(row.key) == f"RowName('kitchen' stored at {row.t} ns)"
    row = next(store.readMessages("/cmd_vel"))
    assert repr(row) == f"<StoredRow /cmd_vel {first}: geometry_msgs/Twist, 48 bytes of husky>"
    assert repr(row.key) == f"Stamp[{KEYS[0]}: {first} of husky]"
    (info,) = store.info("/cmd_vel")
    assert repr(info) == (
        "<TopicInfo /cmd_vel of husky: geometry_msgs/Twist in format packed, messages: 5, "
        f"bytes: 240, from {first} to {last}>"
    )
    explained = store.explainCQL("select linear.x from /cmd_vel")
    assert repr(explained).startswith("select linear.x from /cmd_vel\ntopic:         /cmd_vel\n")
    assert repr(topic.format) == "<CassandraTopic_packed of geometry_msgs/Twist>"
    assert repr(store.upkeep).startswith(f"<Upkeep of keyspace {store.keyspace}")
    assert repr(store.cassandra) == f"<Cassandra {cassandra.host} port {cassandra.port}>"
    assert "<TopicTable t_" in repr(row.table)
    result = store.iterCQL("select linear.x from /cmd_vel")
    assert repr(result) == "<QueryResult of 'select linear.x from /cmd_vel': rows of linear.x>"


def test_at_a_prompt(store, capsys):
    names = {"rosCas": store}
    console = code.InteractiveConsole(names)
    for line in (
        "fix = rosCas.getTopic('cmd_vel')",
        "fix",
        "len(fix), fix.first()",
        "for topic, msg, t in rosCas.readMessages('/cmd_vel', to_key=fix.first()):",
        "    print(topic, msg.linear.x, t)",
        "",
        "rosCas.info('/cmd_vel')",
    ):
        console.push(line)
    first = iso_time(KEYS[0])
    shown = capsys.readouterr().out.splitlines()
    assert shown[0].startswith("<CassandraTopic /cmd_vel: geometry_msgs/Twist in format packed")
    assert shown[1:3] == [f"(5, Stamp[{KEYS[0]}: {first} of husky])", f"/cmd_vel 0.0 {KEYS[0]}"]
    assert shown[3].startswith("[<TopicInfo /cmd_vel of husky: geometry_msgs/Twist in format")
    completer = rlcompleter.Completer(names)
    offered = [completer.complete("rosCas.get", n) for n in range(9)]
    assert {"rosCas.getTopic(", "rosCas.getAllTopics("} <= set(offered)


def test_a_repr_never_raises(connect, store):
    with connect(keyspace=store.keyspace) as other:
        topic = other.getTopic("/cmd_vel")
    assert "is closed; make another RosCassandra>" in repr(other)
    assert repr(topic).startswith("<CassandraTopic /cmd_vel: it cannot be read now: the conn")
    with connect() as other:
        assert repr(other).endswith(
            "no keyspace is connected: call connectToKeyspace('ros') first>"
        )


def test_results_are_lists_and_say_how_long_they_are(store, topic):
    rows = store.executeCQL("select KEY, linear.x from /cmd_vel")
    assert repr(rows) == repr(list(rows))
    many = store.executeCQL("select KEY, linear.x from /cmd_vel")
    many.extend(rows[1:] * NOTEBOOK_ROWS)
    assert repr(many).endswith(f", … {len(many)} rows of KEY, linear.x]")
    assert repr(many).count("Stamp[") == NOTEBOOK_ROWS


def test_a_notebook_shows_tables(store, topic):
    html = store.executeCQL("select KEY, linear.x from /cmd_vel limit 1")._repr_html_()
    assert html == (
        "<table><thead><tr><th>KEY</th><th>linear.x</th></tr></thead><tbody>"
        f"<tr><td>{iso_time(KEYS[0])}</td><td>0.0</td></tr></tbody></table>"
    )
    assert "<td>&lt;b&gt;</td>" in store.executeCQL("select data from /maps")._repr_html_()
    assert "<tr><td>robots</td><td>husky</td></tr>" in topic._repr_html_()
    assert store.info()._repr_html_() == store._repr_html_()
    assert "<td>/cmd_vel</td><td>geometry_msgs/Twist</td><td>packed</td>" in store._repr_html_()
    assert pickle.loads(pickle.dumps(store.info())) == store.info()  # noqa: S301 (our own)
    assert store.runs()._repr_html_().startswith("<table><thead><tr><th>run</th>")
    rows = store.executeCQL("select KEY from /cmd_vel")
    rows.extend(list(rows) * NOTEBOOK_ROWS)
    assert rows._repr_html_().endswith(f"<p>{NOTEBOOK_ROWS} of {len(rows)} rows</p>")


def test_dir_lists_what_a_person_uses(store, topic):
    assert {"getTopic", "executeCQL", "readMessages", "keyspace"} <= set(dir(store))
    assert {"getData", "items", "getMeta", "name"} <= set(dir(topic))
    row = next(store.readMessages("/cmd_vel"))
    assert {"t", "wire", "message", "topic", "key", "connection"} <= set(dir(row))
    listed = [*dir(store), *dir(topic), *dir(row)]
    assert not {"catalog", "cassandra", "statements", "tables", "rows"}.intersection(listed)
    assert not [name for name in listed if name.startswith("_")]


def test_a_topic_is_counted_and_walked_through(store, topic):
    assert len(topic) == 5
    assert [key.ns for key, _ in topic] == KEYS
    assert [msg.linear.x for _, msg in topic] == [0, 1, 2, 3, 4]
    assert KEYS[2] in topic
    assert KEYS[2] + 1 not in topic
    empty = store.getTopic("/empty")
    assert len(empty) == 0
    assert empty  # as before it could be counted
    assert list(empty) == []


def test_rows_unpack_like_those_of_rosbag(store):
    read = [(topic, msg.linear.x, t.to_nsec()) for topic, msg, t in store.readMessages("/cmd_vel")]
    assert read == [("/cmd_vel", n, t) for n, t in enumerate(KEYS)]
    ((_, msg, t),) = store.readMessages("/maps")
    assert (msg.data, type(t).__name__) == ("<b>", "Stamp")


def test_each_call_takes_the_times_that_others_return(store, topic):
    """Each way to get the time of the second message gives a time that getData accepts."""
    frame = topic.toDataFrame()
    row = list(store.readMessages("/cmd_vel"))[1]
    (info,) = store.info("/cmd_vel")
    returned = [
        frame.index[1],
        frame.index.values[1],
        topic.getArrays("KEY")["KEY"][1],
        topic.getArrays("KEY")["KEY"].view("M8[ns]")[1],
        store.executeCQL("select KEY from /cmd_vel")[1][0],
        row.key,
        row.t,
        row.received,
        str(row.key),
        iso_time(row.t),
        info.first_ns + SEC + 1,
        topic.first() + pandas.Timedelta(1, "s") + genpy.Duration(0, 1),
        topic.first() + timedelta(seconds=1) + np.timedelta64(1, "ns"),
    ]
    for t in returned:
        assert topic.getData(t).linear.x == 1, t
        assert [msg.linear.x for _, msg in topic.items(t, t)] == [1], t
        assert store.executeCQL("select linear.x from /cmd_vel where KEY = ?", [t]) == [(1,)], t
        assert [r.t for r in store.readMessages("/cmd_vel", t, t)] == [KEYS[1]], t
    noon = datetime.fromtimestamp(KEYS[0] // SEC, timezone.utc)
    for t in (noon, noon.replace(tzinfo=None), noon.astimezone(timezone(timedelta(hours=9)))):
        assert topic.getData(t).linear.x == 0
    paired = store.nearestMessages("/cmd_vel", "/cmd_vel", timedelta(milliseconds=1))
    assert len(list(paired)) == 5
    written = store.addTopic("/written", "binary")
    key = written.addData(Header(), key=frame.index[3])
    assert key.ns == KEYS[3]


def test_conditions_take_the_lengths_of_time_that_frames_hold(store):
    topic = store.addTopic("/lengths", "ros", msg_type="std_msgs/Duration")
    for n in (-2, 3):
        topic.addData(Duration(data=genpy.Duration(n)), key=T0 + n)
    for n, length in enumerate(topic.toDataFrame()["data"]):
        forms = (length, length.to_pytimedelta(), length.to_numpy(), genpy.Duration((-2, 3)[n]))
        for form in forms:
            assert topic.countTopicData(where=("data = ?", [form])) == 1, form
            assert topic.countTopicData(where=("data >= ?", [form])) == 2 - n, form


def test_seconds_given_as_nanoseconds_are_refused_where_they_would_find_everything(store, topic):
    seconds = KEYS[0] // SEC
    for ask in (
        lambda: topic.items(seconds),
        lambda: topic.getData(seconds, seconds + 5),
        lambda: topic.countTopicData(None, seconds),
        lambda: topic.removeData(seconds, seconds + 9),
        lambda: topic.getArrays("linear.x", key=seconds),
        lambda: store.readMessages("/cmd_vel", seconds),
        lambda: store.upkeep.delete("/cmd_vel", to_key=seconds),
    ):
        with pytest.raises(InvalidKey, match=rf"seconds are written {seconds}\.0"):
            ask()
    assert topic.countTopicData(float(seconds)) == topic.countTopicData(0) == len(topic) == 5
