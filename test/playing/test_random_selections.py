# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Any selection of random recordings is played as a search through all their messages says."""

from __future__ import annotations

import random
from collections import defaultdict
from contextlib import ExitStack
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from playing.robots import SEC, T0, Robot, text_of
from suites import search

from cassandra_ros import Fleet
from cassandra_ros.errors import InvalidOption, MessageNotFound
from cassandra_ros.playing.play_selection import PlaySelection
from cassandra_ros.playing.play_stream import PlayStream
from cassandra_ros.playing.played_fleet import PlayedFleet
from cassandra_ros.playing.played_store import PlayedKeyspace

RUNS = {1: ("r1", 0), 2: ("r1", 7), 3: ("r2", 100), 4: ("", 103)}
"""Writer id -> nodeID and second of the beginning."""
TOPICS = ("/a", "/b", "/map")


class SentMessage(NamedTuple):
    """A message: sorts as the store orders."""

    t: int
    node: str
    writer: int
    count: int
    topic: str
    caller: str
    text: str


@pytest.fixture(scope="module", params=["keyspace", "fleet"])
def recordings(request, fresh):
    """Four runs on a grid of half seconds, with many equal stamps; /map is latched by two.

    In a fleet one of two stores has a message, or both have it.
    """
    rand, sent = random.Random(7), []
    with ExitStack() as stack:
        stores = [stack.enter_context(fresh()) for _ in range(1 + (request.param == "fleet"))]
        for writer, (node, begin) in RUNS.items():
            with ExitStack() as robots:
                each = [robots.enter_context(Robot(store, writer, node)) for store in stores]
                for count, half in enumerate(sorted(rand.choices(range(24), k=40))):
                    topic = rand.choice(TOPICS)
                    caller = rand.choice("xy") if topic == "/map" else "x"
                    text = rand.choice("klmnopq")
                    latched, t = topic == "/map", begin + half / 2
                    for robot in rand.sample(each, rand.randint(1, len(each))):
                        robot.send(topic, t, text, caller, latched=latched, count=count)
                    t = T0 + (2 * begin + half) * SEC // 2
                    sent.append(SentMessage(t, node, writer, count, topic, caller, text))
        if len(stores) == 1:
            yield PlayedKeyspace(stores[0].catalog), sorted(sent)
            return
        places = [f"{s.cassandra.hosts[0]}:{s.cassandra.port}/{s.keyspace}" for s in stores]
        yield PlayedFleet(stack.enter_context(Fleet(places))), sorted(sent)


def shifts(sent, align):
    """Return how far the messages of each writer are shifted."""
    if not align:
        return dict.fromkeys(RUNS, 0)
    group = {w: node if align == "node" and node else w for w, (node, _) in RUNS.items()}
    first = defaultdict(list)
    for each in sent:
        first[group[each.writer]].append(each.t)
    start = min(map(min, first.values()))
    return {w: start - min(first[group[w]]) for w in RUNS if group[w] in first}


def windows_of(hits, before, after, low, high):
    """Return the windows around hits, ns."""
    found = []
    for hit in hits:
        one = [max(low, hit - before), min(high, hit + after)]
        if found and one[0] <= found[-1][1] + 1:
            found[-1][1] = max(one[1], found[-1][1])
        else:
            found.append(one)
    return found


def latched_by(every, shift, topics, low, high):
    """Return the last message of each latching publisher before low, of runs in [low, high]."""
    buckets = defaultdict(list)
    for e in every:
        buckets[e.writer, e.topic, e.t // SEC].append(e.t + shift.get(e.writer, 0))
    runs = {w for (w, *_), ts in buckets.items() if min(ts) <= high and max(ts) >= low}
    last = {}
    for e in every:
        if e.topic == "/map" and e.topic in topics and e.writer in runs and e.writer in shift:
            if e.t + shift[e.writer] < low:
                last[e.writer, e.caller] = e
    return last


def expected(every, selection):
    """Return [(time, message)] as they are to be played, or the error."""
    sent = [e for e in every if e.topic in selection.topics]
    shift = shifts(sent, selection.align_start)
    timed = sorted((e.t + shift[e.writer], e[1:], e) for e in sent)
    first, last = timed[0][0], timed[-1][0]
    low = first + round((selection.start or 0) * SEC)
    if low > last:
        return InvalidOption
    length = selection.duration
    high = last if length is None else min(last, low + round(length * SEC))
    inside = [(t, e) for t, _, e in timed if low <= t <= high]
    if selection.around is None:
        return inside
    topic, (_, wanted) = selection.around
    hits = sorted(
        e.t + shift[e.writer]
        for e in every
        if e.topic == topic and e.text in wanted and e.writer in shift
        if low <= e.t + shift[e.writer] <= high
    )
    if not hits:
        return MessageNotFound
    before, after = (round(s * SEC) for s in (selection.before, selection.after))
    played, out = [], {}
    for number, window in enumerate(windows_of(hits, before, after, low, high)):
        latched = latched_by(every, shift, selection.topics, *window)
        new = [e for key, e in latched.items() if out.get(key) != e]
        out.update(latched)
        if number:
            order = [(e.t + shift[e.writer], e[1:], e) for e in new]
            played += [(window[0], e) for *_, e in sorted(order)]
        for t, e in inside:
            if window[0] <= t <= window[1]:
                played.append((t, e))
                if e.topic == "/map":
                    out[e.writer, e.caller] = e
    return played


HALVES = st.integers(0, 40).map(lambda n: n / 2)
SELECTIONS = st.builds(
    PlaySelection,
    topics=st.sets(st.sampled_from(TOPICS), min_size=1).map(sorted),
    start=st.none() | HALVES,
    duration=st.none() | HALVES,
    align_start=st.sampled_from([False, "run", "node"]),
    around=st.none()
    | st.tuples(
        st.sampled_from(TOPICS),
        st.tuples(
            st.just("data IN (?, ?)"), st.lists(st.sampled_from("klmnopqz"), min_size=2, max_size=2)
        ),
    ),
    before=st.sampled_from([0, 0.25, 1]),
    after=st.sampled_from([0, 0.25, 1.5]),
)


@pytest.mark.suite("all", "a search; make test asks some of its cases")
@search(30)
@given(selection=SELECTIONS, at=HALVES)
def test_what_is_played(recordings, selection, at):
    store, every = recordings
    wanted = expected(every, selection)
    if isinstance(wanted, type):
        with pytest.raises(wanted):
            PlayStream(store, selection)
        return
    stream = PlayStream(store, selection)
    found = list(stream.messages())

    def shown(played):
        rows = ((p.t, p.row) for p in played)
        return [
            (
                t,
                row.received,
                row.node,
                row.seq >> 32,
                row.seq & 0xFFFFFFFF,
                row.topic,
                text_of(row),
            )
            for t, row in rows
        ]

    assert shown(found) == [(t, e.t, *e[1:5], e.text) for t, e in wanted]
    assert all(p.window.low <= p.t <= p.window.high for p in found)
    lows = [window.low for window in stream.windows]
    assert lows == sorted(lows) and lows[0] == stream.start_ns
    assert {p.window.low for p in found} <= set(lows)
    shift = shifts([e for e in every if e.topic in selection.topics], selection.align_start)

    def at_their_times(played):
        return shown(p for p in played if p.t == p.row.received + shift[p.row.seq >> 32])

    # From anywhere on: the same messages, but for what is latched as that begins.
    t = stream.start_ns + round(at * SEC)
    assert at_their_times(stream.messages(t)) == at_their_times(p for p in found if p.t >= t)
