# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the programs say where a name or a command is not what was meant: it names the next step."""

from __future__ import annotations

import json
import shlex
import sys

import pytest
from std_msgs.msg import Int64
from topics.test_run_states import T0, begin

from cassandra_ros.cli import cassandra_bag, local_cassandra, player
from cassandra_ros.cli.options import strip_remappings
from cassandra_ros.errors import InvalidKey, InvalidOption, InvalidQuery, TopicNotFound
from cassandra_ros.local_server import LocalCluster
from cassandra_ros.tables.directory import STALE_SEC


@pytest.fixture
def store(rosCas):
    """Five messages on /n of a run that is called as a bag, by the robot husky."""
    begin(rosCas, 7, "drive 1.bag", "import").close()
    return rosCas


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("drive 1.bag", "it is the name of a run: --run 'drive 1.bag' (in Python run=)"),
        ("/data/drive 1.bag", "it is the name of a run: --run 'drive 1.bag' (in Python run=)"),
        ("husky", "it is a robot: --node-id husky (in Python nodeID=)"),
        ("other.bag", "a file is stored with 'cassandra_bag import'"),
        ("other.mcap", "a file is stored with 'cassandra_bag import'"),
        ("/m", "did you mean /n?"),
    ],
)
def test_a_name_that_is_no_topic_says_what_it_is(store, call, cassandra, monkeypatch, name, text):
    with pytest.raises(TopicNotFound) as caught:
        store.getTopic(name)
    assert f"topic {name!r} is not stored" in str(caught.value) and text in str(caught.value)
    for words in (["info", name], ["rename", name, "/x"], ["delete", name, "-y"]):
        status, _, err = call(*words)
        assert (status, text in err) == (1, True), err
    where = ("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", store.keyspace)
    monkeypatch.setattr(sys, "argv", ["player", *where, name])
    with pytest.raises(TopicNotFound, match="is not stored") as caught:
        player.main()
    assert text in str(caught.value)


@pytest.mark.parametrize(
    "line",
    [
        "query SELECT a.py b.py FROM /n",
        "query select count(*) from /n --json",
        "sql SELECT NODE FROM n",
        "plot SELECT data FROM /n -o x.png",
    ],
)
def test_a_statement_without_quotes(store, call, line):
    status, _, err = call(*line.split())
    assert (status, "put the statement in quotes" in err) == (2, True), err


def test_a_statement_of_one_word_is_told_where_it_ends(store, call):
    status, _, err = call("query", "SELECT")
    assert (status, "the statement ends here" in err) == (1, True)


def test_an_event_is_ended_by_its_name_once(store, call):
    first = store.addEvent("brake", T0)
    status, out, _ = call("event", "end", "brake", "--end", "1500000002")
    assert (status, out) == (0, f"event brake is ended; its key is {first.key}\n")
    status, _, err = call("event", "end", "brake", "--end", "1500000003")
    assert status == 1
    assert "event 'brake' has ended already, at 2017-07-14T02:40:02.000Z" in err
    assert f"give its key: {first.key}" in err
    assert call("event", "end", first.key, "--end", "1500000004", "-q") == (0, "", "")
    keys = [store.addEvent("brake", T0 + n).key for n in (1, 2)]
    status, _, err = call("event", "end", "brake")
    assert status == 1
    assert (
        f"2 events 'brake' last; to set the end of one of them, give its key: {', '.join(keys)}"
        in err
    )
    mine = store.addEvent("brake", T0, nodeID="husky")
    assert call("event", "end", "brake", "--node-id", "jackal")[0] == 1
    assert call("event", "end", mine.key)[0] == 0
    assert "there is no event 'bump'" in call("event", "end", "bump")[2]


def test_an_event_may_be_called_as_an_option(store, env, monkeypatch, capsys):
    for name in ("HOST", "PORT", "KEYSPACE"):
        monkeypatch.setenv(f"CASSANDRA_ROS_{name}", env[f"CASSANDRA_ROS_{name}"])
    assert cassandra_bag.main(["event", "add", "--start", "1500000000", "-q", "--", "-x"]) == 0
    (event,) = store.events("-x")
    assert cassandra_bag.main(["event", "delete", "--dry-run", "--json", "--", "-x"]) == 0
    assert json.loads(capsys.readouterr().out)["deleted"] == [event.key]
    assert cassandra_bag.main(["event", "delete", "-y", "--", "-x"]) == 0
    assert list(store.events()) == []


def test_verify_of_an_exported_window_names_start_and_end(store, call, tmp_path):
    window = ("--start", "1500000001", "--end", "1500000003")
    assert call("export", tmp_path / "w.bag", *window, "-q") == (0, "", "")
    status, out, _ = call("verify", tmp_path / "w.bag")
    assert (status, "--content --start T --end T" in out) == (1, True)
    assert call("verify", tmp_path / "w.bag", "--content", *window, "-q") == (0, "", "")


def test_a_run_that_goes_on_is_not_deleted_and_says_when_it_counts_as_ended(rosCas):
    with begin(rosCas, 8, "x"):
        with pytest.raises(InvalidOption, match=f"killed, try again in {STALE_SEC:.0f} s"):
            rosCas.upkeep.delete(run=8)


def test_a_stored_topic_that_ros_cannot_name_is_remapped():
    words = strip_remappings(["/a", "/my topic:=/mine", "cam-1:=cam", "/scan:=/old", "-l"])
    selection = player.read_selection(player.make_parser().parse_args(words))
    assert selection.topics == ["/a"]
    assert selection.remap == {"/my topic": "/mine", "cam-1": "cam"}
    words = strip_remappings(["/my topic:=/mine"])
    assert player.read_selection(player.make_parser().parse_args(words)).topics is None


def test_another_address_of_the_local_cassandra_is_told(tmp_path, capsys):
    usual, other = (LocalCluster(tmp_path / name, **at) for name, at in PLACES)
    local_cassandra._say_address(usual)
    assert capsys.readouterr().out == ""
    local_cassandra._say_address(other)
    told = "programs find it with:\n  export CASSANDRA_ROS_HOST=127.0.0.5 CASSANDRA_ROS_PORT=9999\n"
    assert capsys.readouterr().out == told


SELECTING = (
    "cat",
    "check",
    "delete -y",
    "event add brake",
    "event delete -y brake",
    "event list",
    "export {out}.bag",
    "map /n -o {out}.png",
    "plot 'SELECT data FROM /n' -o {out}.svg",
    "thumbs /n -o {out}.png",
    "copy --to {place}/far_copy",
    "export {out}2.bag --store {place} --no-latched",
)


def test_a_time_in_another_unit_is_refused_by_every_verb(store, call, cassandra, tmp_path):
    store.addEvent("brake", T0)
    texts = {"out": tmp_path / "x", "place": f"{cassandra.host}:{cassandra.port}"}
    for typed, unit in (("1500000002500", "milliseconds"), ("1500000002500000", "microseconds")):
        for line in SELECTING:
            words = [word.format(**texts) for word in shlex.split(line)]
            status, out, err = call(*words, "--start", typed)
            assert (status, out) == (1, ""), (line, err)
            assert f"--start {typed} means nanoseconds since 1970, 1970-01-" in err
            assert "long before the first stored message, 2017-07-14T02:40:00" in err
            assert f"{unit} are written in seconds, 1500000002.500" in err
    assert (store.getTopic("/n").countTopicData(), len(list(store.events()))) == (5, 1)


def test_a_time_far_outside_of_what_is_stored_is_told(store, call, tmp_path):
    status, out, err = call("cat", "--start", "2010-01-01", "--end", "2017-07-14T02:40:01Z")
    assert (status, out.count("data:")) == (0, 2)
    assert err == (
        "cassandra_bag: --start 2010-01-01 lies 7.5 years (237696000s) before the first stored "
        "message, 2017-07-14T02:40:00.000000000Z\n"
    )
    status, out, err = call("cat", "--start", "2017-07-20")
    assert (status, out, "lies 5.9 days" in err) == (0, "", True), err
    assert "after the last stored message, 2017-07-14T02:40:0" in err
    status, _, err = call("verify", tmp_path / "w.bag", "--content", "--end", "2016-01-01")
    assert status == 1  # there is no such file
    assert call("export", tmp_path / "w.bag", "-q", "--end", "2100-01-01") == (0, "", "")
    status, _, err = call("verify", tmp_path / "w.bag", "--content", "--end", "2100-01-01")
    assert (status, "after the last stored message" in err) == (0, True), err
    status, _, err = call("retention", "--max-age", "1d", "--dry-run", "--now", "1500000002500")
    assert (status, "milliseconds are written in seconds, 1500000002.500" in err) == (1, True)
    assert call("cat", "--start", "2017-07-01", "--end", "2017-08-01", "-n", "0") == (0, "", "")


def test_integers_in_another_unit_are_refused_or_told(store, caplog):
    topic = store.getTopic("/n")
    for key in (1500000002, 1500000002500, 1500000002500000, "1500000002", "1500000002500"):
        for act in (topic.countTopicData, topic.removeData):
            with pytest.raises(InvalidKey, match="nanoseconds since 1970, long before the first"):
                act(key, T0 + 10**12)
        with pytest.raises(InvalidKey, match=r"are written"):
            topic.addData(Int64(1), key=key)
        with pytest.raises(InvalidQuery, match=r"are written"):
            store.executeCQL("DELETE FROM /n WHERE KEY > ?", [key])
        caplog.clear()
        assert len(list(store.executeCQL("SELECT data FROM /n WHERE KEY > ?", [key]))) == 5
        assert f"KEY is compared with {key}, which means nanoseconds since 1970" in caplog.text
    assert topic.countTopicData() == 5


PLACES = (("a", {}), ("b", {"host": "127.0.0.5", "port": 9999}))


@pytest.mark.parametrize(
    "line",
    [
        ("query", "SELECT KEY FROM n WHERE NODE = 'huskey'"),
        ("query", "SELECT KEY FROM n", "--node-id", "huskey"),
        ("cat", "/n", "--node-id", "huskey"),
        ("info", "--node-id", "huskey"),
        ("delete", "/n", "--node-id", "huskey", "-y"),
    ],
)
def test_an_unknown_robot_is_told_with_the_nearest(store, call, line):
    err = call(*line)[2]
    assert "is of robot 'huskey'; did you mean husky?" in err


def test_an_unknown_run_is_told_with_the_nearest(store, call):
    err = call("query", "SELECT KEY FROM n WHERE RUN = 'drive.bag'")[2]
    assert "there is no run 'drive.bag' in keyspace" in err and "did you mean drive 1.bag?" in err
