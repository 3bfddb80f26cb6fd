# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs one after the other, and snapshots of the newest messages."""

from __future__ import annotations

import itertools
import threading
import time

import pytest
from nodes.children import await_true
from nodes.raw_publisher import header_of, message
from proxy import BATCH, EXECUTE, Proxy
from std_msgs.msg import String

from cassandra_ros import RosCassandra
from cassandra_ros.cli.recorder import local_space
from cassandra_ros.errors import InvalidOption
from cassandra_ros.recording import run_series as series_module
from cassandra_ros.recording.option_values import SnapshotBound
from cassandra_ros.recording.recorder_options import RecorderOptions
from cassandra_ros.recording.run_series import RunSeries, SpaceGuard
from cassandra_ros.recording.snapshot import ITEM_BYTES, MessageRing, Snapshots
from cassandra_ros.store.tables.registry import LossKind

SEC = 10**9
T0 = 1_400_000_000 * SEC
HEADER = header_of(String)
SLOW = header_of(String, name="/slow")
LATCHED = header_of(String, name="/map", latching="1")


def text(n):
    return message(String(str(n)))


def series_of(rosCas, **options):
    ticks = itertools.count(T0, SEC)
    begun = []
    made = RunSeries(
        rosCas.catalog, RecorderOptions(spool=False, **options), lambda: next(ticks), begun.append
    )
    return made, begun


def stored(rosCas, topic, run):
    return [row.wire for row in rosCas.getTopic(topic).rows(run=run)]


def test_a_split_goes_on_in_a_new_run(rosCas):
    series, begun = series_of(
        rosCas, output_name="drive", split=True, size=100_000, repeat_latched=True, limit=25
    )
    series.begin(labels={"site": "lab"})
    series.received("/map", LATCHED, text("map"))
    sent = [message(String(f"{n:>9}" + "x" * 10_000)) for n in range(30)]
    for number, wire in enumerate(sent, 1):
        series.received("/t", HEADER, wire)
        assert not series.poll()
        runs = min(number // 10, 2) + 1
        # A run goes on until the store has taken the next one.
        await_true(lambda runs=runs: not series.poll() and len(begun) == runs)
    series.end()
    assert [run.name for run in begun] == ["drive_0", "drive_1", "drive_2"]
    parts = [stored(rosCas, "/t", run.name) for run in begun]
    assert sum(parts, []) == sent[:25]  # the limit is that of all runs together
    assert [len(part) for part in parts] == [10, 10, 5]
    for run in begun:
        assert stored(rosCas, "/map", run.name) == [text("map")]
    assert [(r.topic, r.stored, r.lost) for r in series.reports()] == [
        ("/map", 3, 0),
        ("/t", 25, 0),
    ]
    runs = {run.name: run for run in rosCas.runs()}
    assert runs["drive_1"].labels == {"site": "lab"}
    assert all(run.ended for run in runs.values())


def test_only_the_last_runs_are_kept(rosCas):
    series, begun = series_of(rosCas, output_name="r", split=True, size=1000, max_splits=2)
    series.begin()
    for n in range(5):
        series.received("/t", HEADER, message(String(str(n) * 1000)))
        while len(begun) < n + 2:  # not more than two runs are ended at a time
            series.poll()
    series.end()
    left = [row.message().data[0] for row in rosCas.getTopic("/t").rows()]
    assert left == ["4"]
    assert sorted(run.name for run in rosCas.runs()) == ["r_4", "r_5"]
    assert series.reports()[0].stored == 5


def test_the_last_runs_are_kept_also_where_an_earlier_one_is_stored_later(cassandra, keyspace):
    with Proxy(cassandra.host, cassandra.port) as proxy:
        late = proxy.catch(lambda f: f.opcode == BATCH and b"1" * 1000 in f.body, failed=False)
        late.hold()
        with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as store:
            options = {"output_name": "r", "split": True, "size": 1000, "max_splits": 2}
            series, begun = series_of(store, **options)
            series.begin()
            for n in range(3):
                series.received("/t", HEADER, message(String(str(n) * 1000)))
                while len(begun) < n + 2:
                    series.poll()
            late.wait()
            await_true(lambda: [run.name for run in store.runs() if run.ended][-1:] == ["r_2"])
            late.release()
            series.end()
            assert [row.message().data[0] for row in store.getTopic("/t").rows()] == ["2"]
            assert sorted(run.name for run in store.runs()) == ["r_2", "r_3"]


def test_a_run_that_cannot_begin_keeps_nothing_from_ending(cassandra, keyspace, monkeypatch):
    with Proxy(cassandra.host, cassandra.port) as proxy:
        held = proxy.catch(lambda f: f.opcode == EXECUTE and b"r_1" in f.body, failed=False).hold()
        with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as store:
            series, begun = series_of(store, output_name="r", split=True, size=1000)
            series.begin()
            monkeypatch.setattr(series_module, "BEGIN_SEC", 0.1)
            for n in range(2):
                series.received("/t", HEADER, message(String(str(n) * 1000)))
                assert not series.poll()
            held.wait()
            (report,) = series.end()
            assert (report.stored, report.lost, len(begun)) == (2, 0, 1)
            held.release()
            await_true(lambda: [run.state for run in store.runs()] == ["ended", "ended"])


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize(
    "bound", [{"size": 1000}, {"duration": 0.05}, {"duration": 0.05, "repeat_latched": True}]
)
def test_a_pause_does_not_push_out_earlier_runs(rosCas, bound):
    """What is left out is not of the size of a run, and no run is empty."""
    series, begun = series_of(rosCas, output_name="r", split=True, max_splits=2, **bound)
    series.begin()
    series.received("/map", LATCHED, text("map"))
    series.received("/t", HEADER, message(String("x" * 900)))
    time.sleep(0.06)
    series.poll()
    for _ in range(20):
        series.received("/t", HEADER, message(String("y" * 900)), paused=True)
        time.sleep(0.01)
        assert not series.poll()
    series.received("/t", HEADER, message(String("z" * 900)))
    series.end()
    kept = [row.message().data[0] for row in rosCas.getTopic("/t").rows()]
    assert kept == ["x", "z"]
    assert len(begun) <= 2


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_no_run_begins_while_the_store_is_away(cassandra, keyspace, tmp_path):
    """It could not be deleted in its turn; the one before goes on in the spool."""
    options = {"split": True, "size": 1000, "max_splits": 2, "output_name": "r"}
    options.update(spool_dir=str(tmp_path / "spool"), keyspace=keyspace)
    with Proxy(cassandra.host, cassandra.port) as proxy:
        with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as store:
            begun = []
            series = RunSeries(
                store.catalog, RecorderOptions(**options), time.time_ns, begun.append
            )
            series.begin()
            series.received("/t", HEADER, text(0))
            await_true(lambda: series.reports()[0].stored == 1)
            proxy.cut()
            series.received("/t", HEADER, text(1))
            await_true(lambda: series.current.is_held_up)
            for _ in range(5):
                series.received("/t", HEADER, message(String("x" * 1000)))
                series.poll()
            assert len(begun) == 1
            proxy.mend()
            await_true(lambda: not series.current.is_held_up)
            await_true(lambda: series.poll() or len(begun) == 2)
            series.end()
            assert store.getTopic("/t").countTopicData() == 7


def test_the_limit_holds_while_runs_change(rosCas):
    series, begun = series_of(rosCas, split=True, size=5_000, limit=300)
    series.begin()

    def runs():
        return begun.index(series.current) + 1

    def publish():
        for n in range(300):
            while runs() < 3 and n >= 40 * runs():  # a run begins when the store is fast enough
                time.sleep(0.001)
            series.received("/t", HEADER, text(f"{n:>500}"))
            time.sleep(0.001)

    threads = [threading.Thread(target=publish) for _ in range(3)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        series.poll()
        time.sleep(0.002)
    series.end()
    (report,) = series.reports()
    assert (report.stored, report.lost) == (300, 0)
    assert len(begun) > 2


@pytest.fixture
def refusing(cassandra, keyspace):
    """A RosCassandra that never stores a message."""
    with Proxy(cassandra.host, cassandra.port) as proxy:
        proxy.catch(lambda frame: frame.opcode == BATCH)
        with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as store:
            yield store


def test_what_is_given_up_in_the_end_counts_in_all_runs(refusing):
    series, begun = series_of(refusing, split=True, size=1000)
    series.begin()
    for n in range(2):
        series.received("/t", HEADER, message(String(str(n) * 1000)))
        await_true(lambda n=n: series.poll() or len(begun) == n + 2)
    assert len(begun) == 3
    series.end(lambda: True)
    (report,) = series.reports()
    assert (report.received, report.stored) == (2, 0)
    assert report.reasons == {LossKind.AT_END: 2}


def test_size_without_split_ends(rosCas):
    series, _ = series_of(rosCas, size=1000)
    series.begin()
    assert not series.poll()
    series.received("/t", HEADER, message(String("x" * 1000)))
    assert series.poll()
    series.end()


def test_names(monkeypatch):
    assert RecorderOptions(output_name="a").run_name(0) == "a"
    assert RecorderOptions(output_name="a", split=True).run_name(3) == "a_3"
    date = RecorderOptions().run_name(0)
    assert RecorderOptions(output_prefix="p").run_name(0)[:2] == "p_"
    assert len(date) == len("2014-07-10-18-03-11")


def test_a_local_store_whose_folder_is_made_later_is_watched(monkeypatch, tmp_path):
    folder = tmp_path / "data"
    monkeypatch.setenv("CASSANDRA_ROS_DIR", str(folder))
    assert local_space(["127.0.0.1", "10.0.0.1"]) is None
    guard = SpaceGuard(local_space(["127.0.0.1"]), 1 << 62)
    assert guard.refusal() == ""
    folder.mkdir()
    assert "are free where the store keeps its data, less than" in guard.refusal()


def test_no_space_is_a_loss_that_is_told(rosCas):
    free = [100 << 20]
    series, _ = series_of(rosCas, free_space=lambda: free[0], min_space=50 << 20)
    series.begin()
    series.poll()
    series.received("/t", HEADER, text(1))
    free[0] = 10 << 20
    series._check_space_at = 0.0
    series.poll()
    series.received("/t", HEADER, text(2))
    (report,) = series.end()
    assert (report.stored, report.reasons) == (1, {LossKind.REFUSED: 1})
    assert "10 MB are free" in report.losses[LossKind.REFUSED].detail
    assert [loss.kind for loss in rosCas.losses()] == [LossKind.REFUSED]
    assert SpaceGuard(None, 5).refusal() == ""


def kept(t, size=0):
    return ("/t", HEADER, bytes(size), t)


def test_a_ring_keeps_the_newest():
    ring = MessageRing(SnapshotBound(seconds=10), 0)
    for second in range(100):
        ring.add(kept(second * SEC))
    assert [item[3] // SEC for item in ring.content(())] == list(range(89, 100))
    assert ring.seconds == 10
    ring.forget(105 * SEC)
    assert len(ring) == 5
    assert ring.content(("/other",)) == []
    ring.add(kept(3 * SEC))  # time went back: older messages now lie in the future
    assert [item[3] for item in ring.content(())] == [3 * SEC]


@pytest.mark.parametrize(
    "bound",
    [
        SnapshotBound(nbytes=1 << 20),
        SnapshotBound(nbytes=4 << 20),  # more than the memory that the ring may take
        SnapshotBound(seconds=1e6),
    ],
)
def test_a_ring_stays_within_its_bytes(bound):
    ring = MessageRing(bound, 1 << 20)
    for n in range(100):
        ring.add(kept(n, 100_000))
        assert ring.nbytes <= 1 << 20
    assert len(ring) == 10
    assert ring.short == bool(bound.seconds)


def snapshots_of(rosCas, seconds=5.0, **options):
    now = [T0]
    series = RunSeries(
        rosCas.catalog, RecorderOptions(spool=False, **options), lambda: now[0], lambda run: None
    )
    bound = SnapshotBound(seconds=seconds)
    return Snapshots(bound, 0, lambda: now[0], series.filters, series.single), now


def test_a_snapshot_is_a_run_of_its_own(rosCas):
    snapshots, now = snapshots_of(rosCas, rate_limit=[("/slow", 1.0)])
    for n in range(200):
        now[0] = T0 + n * SEC // 10
        snapshots.received("/t", HEADER, text(n))
        snapshots.received("/slow", SLOW, text(n))
    run, count = snapshots.write("crash", {"why": "bump"})
    assert (run.name, count) == ("crash", 51 + 5)
    assert stored(rosCas, "/t", "crash") == [text(n) for n in range(149, 200)]
    rows = list(rosCas.getTopic("/t").rows())
    assert rows[0].t == T0 + 149 * SEC // 10  # when it came, not when it was written
    (found,) = rosCas.runs()
    assert (found.labels, found.stored["/t"]) == ({"why": "bump"}, 51)
    run, count = snapshots.write("again", {}, topics=["/slow"])
    assert count == 5
    assert snapshots.close()


def test_what_comes_after_is_in_it_too(rosCas):
    snapshots, now = snapshots_of(rosCas)
    for n in range(10):
        snapshots.received("/t", HEADER, text(n))
    run, count = snapshots.write("event", {}, after_sec=3600.0)
    assert count == 10
    for n in range(10, 20):
        snapshots.received("/t", HEADER, text(n))
    for _ in range(3):
        snapshots.write("more", {}, after_sec=3600.0)
    with pytest.raises(InvalidOption, match="being written already"):
        snapshots.write("too many", {})
    assert snapshots.close()  # ends them: received messages are stored
    # All have one stamp: the order is that of arrival.
    assert stored(rosCas, "/t", "event") == [text(n) for n in range(20)]
    assert len(snapshots.reports) == 4


def test_a_snapshot_that_is_given_up_is_lost(refusing):
    snapshots, _ = snapshots_of(refusing, buffsize=1 << 20)
    for _ in range(4):
        snapshots.received("/t", HEADER, message(String("x" * 400_000)))
    snapshots.write("event", {}, after_sec=0.01)
    assert not snapshots.close(timeout_sec=0.5)
    snapshots.abandon()
    ((report,),) = snapshots.reports
    assert report.reasons == {LossKind.AT_END: 4}


def test_what_arrives_leaves_room_for_what_was_kept(rosCas):
    snapshots, _ = snapshots_of(rosCas, buffsize=8 << 20)
    wires = [message(String(f"{n:>300000}")) for n in range(30)]
    for wire in wires[:20]:
        snapshots.received("/t", HEADER, wire)
    snapshots.write("event", {}, after_sec=3600.0)
    for wire in wires[20:]:
        snapshots.received("/t", HEADER, wire)
    await_true(lambda: rosCas.getAllTopics("/t"))
    snapshots.close()
    ((report,),) = snapshots.reports
    assert (report.stored, report.lost) == (30, 0)
    assert stored(rosCas, "/t", "event") == wires


def test_what_was_latched_before_a_snapshot_goes_first():
    ring = MessageRing(SnapshotBound(seconds=5), 0)
    latching = {"topic": "/map", "latching": "1", "callerid": "/m"}
    ring.add(("/map", latching, b"old", 0))
    ring.add(("/map", latching, b"map", 10**9))
    for n in range(2, 20):
        ring.add(("/t", {}, b"x", n * 10**9))
    kept = ring.content(())
    assert kept[0] == ("/map", latching, b"map", 14 * 10**9)
    assert [t // 10**9 for _, _, _, t in kept[1:]] == [14, 15, 16, 17, 18, 19]
    ring.forget(10**12)
    assert [wire for _, _, wire, _ in ring.content(["/map"])] == [b"map"]
    assert ring.nbytes == 3 + ITEM_BYTES


def test_much_that_is_latched_leaves_room_for_what_is_new():
    ring = MessageRing(SnapshotBound(nbytes=10_000), 0)
    for n in range(20):
        ring.add(("/map", {"latching": "1", "callerid": f"/m{n}"}, b"m" * 1000, n))
    for n in range(20, 60):
        ring.add(("/t", {}, b"t" * 200, n))
    kept = ring.content(())
    assert [topic for topic, *_ in kept] == ["/map"] * 3 + ["/t"] * 12
    assert ring.nbytes == sum(len(wire) + ITEM_BYTES for _, _, wire, _ in kept) <= 10_000


def test_a_latched_message_that_is_sent_again_and_again_takes_room_once():
    ring = MessageRing(SnapshotBound(nbytes=10_000), 0)
    for n in range(0, 200, 2):
        ring.add(("/map", {"latching": "1", "callerid": "/m"}, b"m" * 1000, n))
        ring.add(("/t", {}, b"t" * 200, n + 1))
    ring.add(("/tf_static", {"latching": "1", "callerid": "/s"}, b"s" * 100, 200))
    for n in range(201, 300):
        ring.add(("/t", {}, b"t" * 200, n))
    kept = ring.content(())
    assert [topic for topic, *_ in kept[:3]] == ["/map", "/tf_static", "/t"]
    assert {topic for topic, *_ in kept[3:]} == {"/t"}
    assert ring.nbytes == sum(len(wire) + ITEM_BYTES for _, _, wire, _ in kept) <= 10_000


def test_the_end_waits_for_a_snapshot_that_begins(cassandra, keyspace):
    with Proxy(cassandra.host, cassandra.port) as proxy:
        held = proxy.catch(lambda f: f.opcode == EXECUTE and b"event" in f.body, failed=False)
        with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as store:
            snapshots, _ = snapshots_of(store)
            snapshots.received("/t", HEADER, text(1))
            held.hold()
            asking = threading.Thread(target=snapshots.write, args=("event", {}))
            asking.start()
            held.wait()
            assert not snapshots.close(timeout_sec=0.1)
            held.release()
            await_true(lambda: snapshots.close(timeout_sec=0.1))
            asking.join()
            assert stored(store, "/t", "event") == [text(1)]
