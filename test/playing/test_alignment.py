# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs of different days as if at once, each under its own prefix."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st
from playing.robots import SEC, T0, Robot, played, texts

from cassandra_ros.errors import InvalidOption
from cassandra_ros.playing.play_selection import PlaySelection
from cassandra_ros.playing.play_stream import PlayStream, source_names, valid_name
from cassandra_ros.playing.played_store import PlayedKeyspace
from cassandra_ros.playing.stored_ranges import StoredRange

DAY = 86_400


@pytest.fixture(scope="module")
def fleet(fresh):
    """Two robots on two days, and a recorder without a nodeID; r2 with two runs."""
    with fresh() as rosCas:
        for writer, node, begin, name in (
            (1, "r1", 0, "a"),
            (2, "r2", DAY, "b"),
            (3, "r2", DAY + 50, "c"),
            (4, "", 2 * DAY, "d"),
        ):
            with Robot(rosCas, writer, node) as robot:
                robot.send("/map", begin, f"{name}map", latched=True)
                for n in range(4):
                    # Equal stamps, of which the order of writing decides.
                    robot.send("/x", begin + n, f"{name}{n}")
                    robot.send("/y", begin + n, f"{name}y{n}")
        yield rosCas


def test_runs_begin_at_once(fleet):
    stream = PlayStream(PlayedKeyspace(fleet.catalog), PlaySelection(["/x"], align_start=True))
    assert (stream.start_ns, stream.end_ns) == (T0, T0 + 3 * SEC)
    assert [(t, text) for _, t, text in played(stream)] == [
        (t, f"{name}{t}") for t in range(4) for name in "dabc"
    ]


def test_equal_stamps_keep_their_order(fleet):
    stream = PlayStream(
        PlayedKeyspace(fleet.catalog), PlaySelection(["/x", "/y"], align_start="run", end=0)
    )
    assert [text for *_, text in played(stream)] == "d0 dy0 a0 ay0 b0 by0 c0 cy0".split()


def test_nodes_begin_at_once(fleet):
    found = played(
        PlayStream(
            PlayedKeyspace(fleet.catalog), PlaySelection(["/x"], align_start="node", start=3)
        )
    )
    assert [(t, text) for _, t, text in found] == [
        *((3, "d3"), (3, "a3"), (3, "b3")),
        *((50 + n, f"c{n}") for n in range(4)),
    ]


def test_seconds_count_on_the_common_line_and_dates_choose(fleet):
    selection = PlaySelection(["/x"], align_start=True, start=1, duration=1)
    assert [
        text for *_, text in played(PlayStream(PlayedKeyspace(fleet.catalog), selection))
    ] == "d1 a1 b1 c1 d2 a2 b2 c2".split()
    # From the second message of the second day on: what came before is not chosen.
    selection = PlaySelection(["/x"], align_start=True, start=T0 + (DAY + 1) * SEC)
    stream = PlayStream(PlayedKeyspace(fleet.catalog), selection)
    begin = DAY + 1
    assert [(t - begin, text) for _, t, text in played(stream)] == [
        *((0, "d0"), (0, "b1"), (0, "c0"), (1, "d1"), (1, "b2"), (1, "c1")),
        *((2, "d2"), (2, "b3"), (2, "c2"), (3, "d3"), (3, "c3")),
    ]


def test_a_condition_decides_what_comes_first(fleet):
    where = {"/x": "data LIKE '%2' OR data LIKE '%3'"}
    stream = PlayStream(
        PlayedKeyspace(fleet.catalog), PlaySelection(["/x"], align_start=True, where=where)
    )
    assert {p.t for p in stream.messages()} == {T0 + 2 * SEC, T0 + 3 * SEC}


def test_each_robot_has_its_prefix(fleet):
    stream = PlayStream(
        PlayedKeyspace(fleet.catalog), PlaySelection(["/x"], node_prefix=True, prefix="/day")
    )
    wanted = {f"/day{robot}/x" for robot in ("/r1", "/r2", "/run_4")}
    assert {p.topic for p in stream.messages()} == wanted
    assert {channel.topic for channel in stream.channels()} == wanted
    stream = PlayStream(
        PlayedKeyspace(fleet.catalog), PlaySelection(["/x"], node_prefix=True, align_start=True)
    )
    assert {p.topic: p.row.seq >> 32 for p in stream.messages()} == {
        "/r1/x": 1,
        "/r2_run_2/x": 2,
        "/r2_run_3/x": 3,
        "/run_4/x": 4,
    }


def test_what_each_latched_before_the_start(fleet):
    stream = PlayStream(PlayedKeyspace(fleet.catalog), PlaySelection(align_start=True, start=2))
    found = stream.latched(stream.start_ns)
    assert texts(p.row for p in found) == ["dmap", "amap", "bmap", "cmap"]
    assert {p.t for p in found} == {T0}


def test_windows_around_hits_of_all(fleet):
    selection = PlaySelection(
        ["/y"], align_start=True, around="/x: data IN ('a1', 'b3')", before=0, after=0
    )
    assert [text for *_, text in played(PlayStream(PlayedKeyspace(fleet.catalog), selection))] == (
        "dy1 ay1 by1 cy1 dy3 ay3 by3 cy3".split()
    )


def test_what_is_no_alignment_is_refused(fleet):
    with pytest.raises(InvalidOption, match="neither 'run' nor 'node'"):
        PlayStream(PlayedKeyspace(fleet.catalog), PlaySelection(align_start="day"))


@given(st.text())
def test_any_text_becomes_a_name(text):
    assert re.fullmatch(r"[A-Za-z]\w*", valid_name(text), re.ASCII)


SOURCES = st.sets(st.tuples(st.sampled_from(["", "r1", "r-1", "r_1", "ä"]), st.integers(1, 9)))


@given(SOURCES, st.sampled_from(["", "run", "node"]))
def test_who_is_told_apart_has_an_own_name(sources, align):
    stored_ranges = [StoredRange(None, node, writer, writer, writer) for node, writer in sources]
    names = source_names(stored_ranges, {1: "lab 1", 2: "lab_1"}, align)
    assert set(names) == set(sources)
    for one in sources:
        for two in sources:
            together = one[0] == two[0] != "" and align != "run"
            assert (names[one] == names[two]) == (one == two or together)
