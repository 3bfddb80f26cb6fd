# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the programs and classes say of times in another unit, and of a statement that is none."""

from __future__ import annotations

import shlex

import pytest
from std_msgs.msg import Int64
from topics.test_run_states import T0, begin

from cassandra_ros.errors import InvalidKey, InvalidQuery


@pytest.fixture
def store(rosCas):
    """Five messages on /n of a run that is called as a bag, by the robot husky."""
    begin(rosCas, 7, "drive 1.bag", "import").close()
    return rosCas


def test_a_statement_of_one_word_is_told_where_it_ends(store, call):
    status, _, err = call("query", "SELECT")
    assert (status, "the statement ends here" in err) == (1, True)


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
