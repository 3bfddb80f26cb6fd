# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A recording whose store is away: what comes is kept on disk, and ends in the same rows."""

from __future__ import annotations

import errno
import os
import shutil
import time
from concurrent.futures import Future
from functools import partial
from itertools import islice
from pathlib import Path

import pytest
from cassandra import Unauthorized
from nodes.children import await_true
from nodes.raw_publisher import header_of, message
from proxy import Proxy
from rospy import Time
from std_msgs.msg import String
from suites import sparing

from cassandra_ros import RosCassandra
from cassandra_ros.errors import SpoolError, WriteFailed
from cassandra_ros.files.spool.segment_writer import SegmentWriter
from cassandra_ros.files.spool.spool_folder import RunFolder, SpoolFolder
from cassandra_ros.files.spool.spool_label import RunEnd, SpoolLabel
from cassandra_ros.messages.connection_header import live_connection
from cassandra_ros.recording import spool_drain
from cassandra_ros.recording.left_runs import lines_of
from cassandra_ros.recording.message_buffer import LONGEST_BUCKET_NS
from cassandra_ros.recording.recorder_options import SpoolPlan
from cassandra_ros.recording.recording import Recording
from cassandra_ros.recording.spool_drain import Drain, read_left
from cassandra_ros.recording.topic_settings import (
    RecordingSettings,
    TopicSettings,
    settings_as_json,
)
from cassandra_ros.store.tables.registry import LossKind

pytestmark = pytest.mark.suite("all", "it kills or cuts something, and waits")

FORMATS = ("ros", "binary", "packed")
LATER = pytest.mark.suite("campaign", "the spool does not know the format")
IN_EVERY_RUN = pytest.mark.suite("test", "promise 1, while the store is away")
WAYS = [
    pytest.param(
        format,
        journal,
        marks=[IN_EVERY_RUN] * ((format, journal) == ("packed", False))
        + [LATER] * ((format, journal) not in (("packed", False), ("ros", True))),
    )
    for format in FORMATS
    for journal in (False, True)
]
TOPICS = 30


def text(n):
    return message(String(str(n)))


def all_in(format):
    return RecordingSettings(TopicSettings(format))


@pytest.fixture
def proxy(cassandra):
    with Proxy(cassandra.host, cassandra.port) as running:
        yield running


@pytest.fixture
def store(proxy, keyspace):
    with RosCassandra(proxy.host, proxy.port, keyspace=keyspace) as connected:
        yield connected


@pytest.fixture
def folder(tmp_path):
    return SpoolFolder(tmp_path / "spool")


def send(recorder, numbers, topic="/text", header=None):
    header = header or header_of(String)
    for n in numbers:
        recorder.received(topic, header, text(n))


def rows_of(rosCas, topic="/text"):
    return [row.wire for row in rosCas.getTopic(topic).rows()]


def drain(rosCas, folder):
    done = []
    for left in folder.left():
        try:
            done.append(Drain(rosCas.catalog, read_left(left)).run())
        finally:
            left.release()
    return done


@pytest.mark.parametrize(("format", "journal"), WAYS)
def test_a_store_that_goes_away_and_comes_back(proxy, store, rosCas, folder, format, journal):
    plan = SpoolPlan(folder, journal=journal)
    recorder = Recording(store.catalog, settings=all_in(format), spool=plan)
    header = header_of(String)
    send(recorder, range(100), header=header)
    await_true(lambda: recorder.reports()[0].stored == 100)
    proxy.cut()
    send(recorder, range(100, 3000), header=header)
    await_true(lambda: recorder.is_held_up)
    send(recorder, range(3000, 5000), header=header)
    await_true(lambda: recorder.on_disk.messages > 0 or journal)
    proxy.mend()
    send(recorder, range(5000, 5100), header=header)
    await_true(lambda: recorder.reports()[0].stored == 5100)
    send(recorder, range(5100, 5200), header=header)
    (report,) = recorder.close()
    assert (report.received, report.stored, report.lost, report.spooled) == (5200, 5200, 0, 0)
    assert rows_of(rosCas) == [text(n) for n in range(5200)]
    assert folder.runs() == []
    assert rosCas.losses() == []


@pytest.mark.parametrize("journal", [False, True])
@pytest.mark.parametrize("format", sparing(FORMATS, ["packed"], "campaign"))
def test_a_store_that_is_away_at_the_end(proxy, store, rosCas, folder, caplog, format, journal):
    plan = SpoolPlan(folder, journal=journal)
    recorder = Recording(store.catalog, settings=all_in(format), node="husky", spool=plan)
    send(recorder, range(100))
    await_true(lambda: recorder.reports()[0].stored == 100)
    send(recorder, range(100, 200))
    proxy.cut()
    send(recorder, range(200, 3000))
    (report,) = recorder.close()
    assert report.lost == 0
    assert report.stored + report.spooled == 3000
    assert report.spooled > 2000
    for _ in range(2):
        for done in drain(rosCas, folder):
            assert done.complete and not done.lost
    assert "was not ended" not in caplog.text
    assert folder.runs() == []
    assert rows_of(rosCas) == [text(n) for n in range(3000)]
    assert [row.seq & 0xFFFFFFFF for row in rosCas.getTopic("/text").rows()] == [*range(3000)]
    (run,) = rosCas.runs()
    assert (run.state, run.stored, run.lost) == ("ended", {"/text": 3000}, {})
    assert rosCas.getTopic("/text").countTopicData() == 3000


def within_a_bucket():
    """Return a clock by which no bucket begins for minutes.

    A message that begins a bucket waits for the store in memory, and no other one is taken then.
    """
    offset = time.time_ns() % LONGEST_BUCKET_NS
    return lambda: time.time_ns() - offset


def await_out_of_memory(recorder):
    await_true(lambda: recorder.held_bytes == 0)


@pytest.mark.parametrize("ends", [False, True])
def test_topics_that_begin_one_after_the_other(proxy, store, rosCas, folder, ends):
    """Each stays what it is, though the files name a connection more than once."""
    plan, settings, clock = SpoolPlan(folder), all_in("packed"), within_a_bucket()
    recorder = Recording(store.catalog, settings=settings, clock=clock, spool=plan)
    sent = [0]
    send(recorder, sent, "/topic0")
    await_true(lambda: recorder.reports()[0].stored == 1)
    proxy.cut()

    def goes_to_files():
        sent.append(len(sent))
        send(recorder, sent[-1:], "/topic0")
        return recorder.on_disk.messages > 0

    # Until a block is on its way to the silent store, messages are still taken into memory.
    await_true(goes_to_files)
    await_out_of_memory(recorder)
    headers = [{**header_of(String), "callerid": f"/node{n}"} for n in range(TOPICS)]
    for step in range(TOPICS):
        kept = recorder.on_disk.messages
        for n in range(step + 1):
            send(recorder, [f"{n} {step}"], f"/topic{n}", headers[n])
        await_out_of_memory(recorder)
        assert recorder.on_disk.messages == kept + step + 1
    if ends:
        recorder.close()
        proxy.mend()
        (done,) = drain(rosCas, folder)
        assert done.complete and not done.lost
    else:
        proxy.mend()
        count = len(sent) + TOPICS * (TOPICS + 1) // 2
        await_true(lambda: sum(each.stored for each in recorder.reports()) == count)
        recorder.close()
    for n in range(TOPICS):
        early = sent if n == 0 else []
        later = [f"{n} {step}" for step in range(n, TOPICS)]
        assert rows_of(rosCas, f"/topic{n}") == [text(each) for each in [*early, *later]]


def test_what_is_damaged_does_not_wait_on_disk_any_more(proxy, store, rosCas, folder):
    sent = iter(range(100_000, 200_000))  # all of one size
    plan, settings, clock = SpoolPlan(folder), all_in("binary"), within_a_bucket()
    recorder = Recording(store.catalog, settings=settings, clock=clock, spool=plan)
    send(recorder, [next(sent)])
    await_true(lambda: recorder.reports()[0].stored == 1)

    def goes_to_files():
        send(recorder, [next(sent)])
        return recorder.on_disk.messages > 0

    proxy.cut()
    await_true(goes_to_files)
    send(recorder, islice(sent, 3000))
    await_out_of_memory(recorder)
    (run_folder,) = folder.runs()
    # A message: a file has also indexes, of which nothing is read.
    wire = text(101_500)
    path = next(path for path in run_folder.glob("*.mcap") if wire in path.read_bytes())
    with open(path, "r+b") as file:
        file.seek(path.read_bytes().index(wire))
        file.write(bytes(64))
    proxy.mend()
    await_true(lambda: not recorder.on_disk.messages)
    proxy.cut()
    await_true(goes_to_files)
    await_out_of_memory(recorder)
    assert recorder.on_disk.nbytes == recorder.on_disk.messages * len(text(100_000))
    proxy.mend()
    (report,) = recorder.close()
    assert report.lost > 0 and report.received == report.stored + report.lost


def left_behind(proxy, store, folder, numbers, **options):
    """Record numbers of which the last ones stay in the spool; return the report."""
    recorder = Recording(store.catalog, spool=SpoolPlan(folder), **options)
    send(recorder, [0])
    await_true(lambda: recorder.reports()[0].stored == 1)
    proxy.cut()
    send(recorder, numbers)
    (report,) = recorder.close()
    assert report.spooled == len(numbers)
    return report


@pytest.mark.parametrize("format", sparing(FORMATS, ["packed"], "campaign"))
def test_what_is_drained_twice_ends_in_the_same_rows(
    proxy, store, rosCas, folder, tmp_path, format
):
    """The second drain stands for one after a drain that was killed just before its end."""
    left_behind(proxy, store, folder, range(1, 2000), settings=all_in(format))
    shutil.copytree(folder.path, tmp_path / "copy")
    (done,) = drain(rosCas, folder)
    rows = [(row.position, row.wire) for row in rosCas.getTopic("/text").rows()]
    assert [wire for _, wire in rows] == [text(n) for n in range(2000)]
    drain(rosCas, SpoolFolder(tmp_path / "copy"))
    assert [(row.position, row.wire) for row in rosCas.getTopic("/text").rows()] == rows
    assert rosCas.getTopic("/text").countTopicData() == 2000
    (run,) = rosCas.runs()
    assert run.stored == {"/text": 2000}


def test_what_a_newer_table_keeps_from_being_stored_stays(proxy, store, rosCas, folder, cql):
    """An upgraded robot made a table in the shared keyspace, which this release cannot read."""
    left_behind(proxy, store, folder, range(1, 500))
    newer = f"{rosCas.keyspace}.newer"
    comment = '{"cassandra_ros": {"version": 99}}'
    cql.execute(f"CREATE TABLE {newer} (a int PRIMARY KEY) WITH comment = '{comment}'")
    (done,) = drain(rosCas, folder)
    assert (done.complete, done.lost, done.messages) == (False, {}, 0)
    assert "version 99" in done.stays["/text"]
    assert any("stay in the spool" in line for line in lines_of(done))
    cql.execute(f"DROP TABLE {newer}")
    (done,) = drain(rosCas, folder)
    assert (done.complete, done.stays) == (True, {})
    assert rows_of(rosCas) == [text(n) for n in range(500)]
    assert rosCas.losses() == []


class Denied:
    """A writer whose user has lost the right to write into a topic."""

    def __init__(self, writer, drained, topic):
        self._writer, self._drained, self._topic = writer, drained, topic

    def __getattr__(self, name):
        return getattr(self._writer, name)

    def write(self, handle, *rest):
        if handle.connection.topic != self._topic:
            return self._writer.write(handle, *rest)
        error = WriteFailed(f"1 message of {self._topic} was refused")
        error.__cause__ = Unauthorized("User ann has no MODIFY permission on <table ros.t>")
        return self._drained._on_refusal(self._topic, 1, error)


def test_a_topic_that_may_not_be_written_stays_alone(proxy, store, rosCas, folder):
    """The others are stored, and what is deleted of them does not come back."""
    recorder = Recording(store.catalog, spool=SpoolPlan(folder))
    send(recorder, [0])
    await_true(lambda: recorder.reports()[0].stored == 1)
    proxy.cut()
    for topic in ("/text", "/other"):
        send(recorder, range(1, 200), topic=topic)
    recorder.close()
    proxy.mend()
    (left,) = folder.left()
    drained = Drain(rosCas.catalog, read_left(left))
    written = {path: path.stat().st_mtime_ns for path in left.files()}
    made = drained._writer
    drained._writer = lambda number: Denied(made(number), drained, "/text")
    done = drained.run()
    left.release()
    assert (done.complete, list(done.stays), done.lost, done.messages) == (
        *(False, ["/text"]),
        *({}, 199),
    )
    assert left.files()
    assert all(written[path] == path.stat().st_mtime_ns for path in left.files())
    assert rows_of(rosCas, "/other") == [text(n) for n in range(1, 200)]
    rosCas.removeTopic("/other")
    (done,) = drain(rosCas, folder)
    assert (done.complete, done.messages) == (True, 199)
    assert rows_of(rosCas) == [text(n) for n in range(200)]
    assert not rosCas.existTopic("/other")
    (run,) = rosCas.runs()
    assert run.state == "ended"
    assert folder.runs() == []


@pytest.mark.suite("test", "promise 1: the counts of a run are right, however it was drained")
@pytest.mark.parametrize("ends", ["replaced", "killed", "no room"])
def test_what_is_lost_is_told_once_by_two_drains(rosCas, folder, monkeypatch, ends):
    """The first leaves a topic that may not be written, and perhaps its file with all messages."""
    left_with_damage(rosCas, folder)
    (left,) = folder.left()
    drained = Drain(rosCas.catalog, read_left(left))
    made = drained._writer
    drained._writer = lambda number: Denied(made(number), drained, "/other")

    def fail(*_):
        raise OSError(errno.ENOSPC, "no room")

    with monkeypatch.context() as patch:
        if ends == "killed":  # between the note that the file is settled and its replacement
            patch.setattr(Path, "replace", fail)
        elif ends == "no room":
            patch.setattr(spool_drain, "SegmentWriter", fail)
        done = drained.run()
    left.release()
    assert (done.complete, list(done.stays), done.messages) == (False, ["/other"], 35)
    assert done.lost == {"/text": 5, "/other": 5}
    rosCas.getTopic("/text").removeData(Time(0), Time(2**32 - 1))  # it does not come back as lost
    losses = rosCas.losses()
    assert [(each.topic, each.kind, each.count) for each in losses] == [
        (topic, LossKind.SPOOL_DAMAGED, 5) for topic in ("/text", "/other")
    ]
    (done,) = drain(rosCas, folder)
    assert done.complete
    assert [each for each in rosCas.losses() if each.kind == LossKind.SPOOL_DAMAGED] == losses
    (run,) = rosCas.runs()
    assert run.lost == {"/text": 5 + 2, "/other": 5}
    assert run.stored == {"/text": 35, "/other": 35}
    assert len(rows_of(rosCas, "/other")) == 35


def left_with_damage(rosCas, folder):
    """Leave a run of two files with 40 messages each of two topics; a chunk of ten is damaged."""
    begun = 1_600_000_000 * 10**9
    settings = settings_as_json(RecordingSettings())
    label = SpoolLabel(7, 7, rosCas.keyspace, "", begun, node="husky", settings=settings)
    run_folder, totals = folder.begin(7), {}
    connections = [live_connection(topic, header_of(String)) for topic in ("/text", "/other")]
    for first in (0, 40):
        segment = SegmentWriter(run_folder.new_file(), label, totals)
        for begin in range(first, first + 40, 10):
            numbers = range(begin, begin + 10)
            segment.append([(connections[n % 2], begun + n, n, text(f"{n:090}")) for n in numbers])
        if first:
            full = ("/text", LossKind.BUFFER_FULL.value, begun + 90, begun + 92, 2)
            stored = {"/text": 40, "/other": 40}
            segment.finish(RunEnd(begun + 100, stored, {"/text": 2}, [full]))
        segment.close()
    path = run_folder.files()[0]
    content = bytearray(path.read_bytes())
    content[content.index(f"{15:090}".encode())] ^= 1
    path.write_bytes(content)
    run_folder.release()


def test_the_end_that_is_missing_is_told_before_the_files_go(
    store, rosCas, folder, tmp_path, monkeypatch, caplog
):
    """A drain that is killed at its end leaves a run that the next one tells again."""
    recorder = Recording(store.catalog, node="husky", spool=SpoolPlan(folder, journal=True))
    send(recorder, range(100))
    await_true(lambda: recorder.reports()[0].stored == 100)
    shutil.copytree(folder.path, tmp_path / "killed")
    recorder.close()
    told = "was not ended: its last sign of life was at"

    def killed(folder):
        raise OSError(errno.EIO, "killed")

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "remove", killed)
        with pytest.raises(OSError, match="killed"):
            drain(rosCas, SpoolFolder(tmp_path / "killed"))
    assert caplog.text.count(told) == 1
    drain(rosCas, SpoolFolder(tmp_path / "killed"))
    assert caplog.text.count(told) == 2
    assert len(rows_of(rosCas)) == 100


def test_a_damaged_file_costs_what_it_hits(proxy, store, rosCas, folder):
    left_behind(proxy, store, folder, range(1, 9001))
    (run_folder,) = folder.runs()
    path = max(run_folder.glob("*.mcap"), key=lambda path: path.stat().st_size)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)
    (done,) = drain(rosCas, folder)
    stored = rows_of(rosCas)
    lost = 9001 - len(stored)
    assert 0 < lost < 5000
    assert done.lost == {"/text": lost}
    (loss,) = rosCas.losses()
    assert (loss.topic, loss.kind, loss.count) == ("/text", LossKind.SPOOL_DAMAGED, lost)
    (run,) = rosCas.runs()
    assert (run.stored, run.lost) == ({"/text": 9001 - lost}, {"/text": lost})
    assert folder.runs() == []


JOURNAL_BYTES = 800_000
"""Maximum size of a journal of which a file has an eighth, bytes."""
STEPS = 40
PAGE = 4096


def record_numbers(store, spool):
    """Record numbered messages of two topics with a journal, several files without a store."""
    recorder = Recording(store, node="husky", spool=SpoolPlan(spool, journal=True))
    headers = {topic: header_of(String) for topic in ("/a", "/b")}
    ends = [1, *range(50, STEPS * 50 + 1, 50)]
    # A chunk each, or more. The first is so small that the next one begins in the same page.
    for first, end in zip([0, *ends], ends):
        before = spool.nbytes()
        for n in range(first, end):
            recorder.received("/a", headers["/a"], message(String(f"{n:0200}")))
            if n % 10 == 0:
                recorder.received("/b", headers["/b"], message(String(f"{n:0200}")))
        await_true(partial(has_grown, spool, before + (end - first) * 200))
    return recorder


def has_grown(spool, nbytes):
    return spool.nbytes() > nbytes


@pytest.fixture(scope="module")
def waiting(tmp_path_factory):
    """A journal that had no store, as a kill -9 leaves it."""
    path = tmp_path_factory.mktemp("journal")
    spool = SpoolFolder(path / "spool", JOURNAL_BYTES)
    recorder = record_numbers(Future(), spool)
    shutil.copytree(spool.path, path / "killed")
    recorder.close()
    return path / "killed"


@pytest.fixture
def journal(waiting, tmp_path):
    return SpoolFolder(shutil.copytree(waiting, tmp_path / "journal"))


def zeroed(path, at):
    content = bytearray(path.read_bytes())
    content[at : at + PAGE] = bytes(min(PAGE, len(content) - at))
    path.write_bytes(content)


def first_definition(path):
    return path.read_bytes().index(b"std_msgs/String")


def page_of_the_definitions(first, second, last):
    zeroed(first, first_definition(first))


def page_in_the_middle(first, second, last):
    zeroed(second, second.stat().st_size // 2)


def page_at_the_beginning(first, second, last):
    zeroed(second, 0)


def both_files_cut(first, second, last):
    for path in (first, second):
        os.truncate(path, path.stat().st_size // 2)


def first_missing(first, second, last):
    first.unlink()


def second_missing(first, second, last):
    second.unlink()


def second_empty(first, second, last):
    os.truncate(second, 0)


def page_at_the_end_of_all(first, second, last):
    zeroed(last, last.stat().st_size - PAGE)


DAMAGES = {
    page_of_the_definitions: 3,
    page_in_the_middle: 2,
    page_at_the_beginning: 2,
    both_files_cut: STEPS,
    first_missing: STEPS,
    second_missing: STEPS,
    second_empty: STEPS,
}
"""What damages a journal, and the largest number of steps whose messages it may hit."""


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_damage_costs_is_told_by_topic_at_its_place(rosCas, journal, damage):
    (run_folder,) = journal.runs()
    files = sorted(run_folder.glob("*.mcap"))
    assert len(files) > 3
    damage(files[0], files[1], files[-1])
    (done,) = drain(rosCas, journal)
    assert done.complete
    (run,) = rosCas.runs()
    missing = 0
    for topic, step in (("/a", 1), ("/b", 10)):
        rows = list(rosCas.getTopic(topic).rows())
        stored = {int(row.wire[4:]): row.t for row in rows}
        lost = set(range(0, STEPS * 50, step)).difference(stored)
        missing += len(lost)
        assert run.lost.get(topic, 0) == done.lost.get(topic, 0) == len(lost)
        told = [e for e in rosCas.losses([topic]) if e.kind == LossKind.SPOOL_DAMAGED]
        assert sum(each.count for each in told) == len(lost)
        before = [t for n, t in stored.items() if lost and n < min(lost)]
        after = [t for n, t in stored.items() if lost and n > max(lost)]
        for each in told:
            assert max(before, default=0) <= each.first_ns <= each.last_ns
            assert each.last_ns <= min(after)
    assert 0 < missing <= DAMAGES[damage] * 55
    assert sum(done.lost.values()) == missing


def test_damage_whose_messages_nothing_counts_is_told_without_a_number(rosCas, journal):
    """At the end of the last file no totals follow."""
    (run_folder,) = journal.runs()
    page_at_the_end_of_all(None, None, max(run_folder.glob("*.mcap")))
    (done,) = drain(rosCas, journal)
    rows = {topic: len(rows_of(rosCas, topic)) for topic in ("/a", "/b")}
    lost = STEPS * 55 - sum(rows.values())
    assert lost > 0
    assert any("lost" in line for line in lines_of(done))
    told = [each for each in rosCas.losses() if each.kind == LossKind.SPOOL_DAMAGED]
    assert {each.topic for each in told} == {"/a", "/b"}
    assert sum(each.count for each in told) <= lost


@pytest.mark.parametrize("damage", [page_of_the_definitions, page_in_the_middle])
def test_damage_to_what_the_store_has_is_no_loss(rosCas, tmp_path, damage):
    """A journal holds messages that were stored before the recorder was killed."""
    folder, killed = SpoolFolder(tmp_path / "spool"), SpoolFolder(tmp_path / "killed")
    recorder = record_numbers(rosCas.catalog, folder)
    await_true(lambda: sum(each.stored for each in recorder.reports()) == STEPS * 55)
    shutil.copytree(folder.path, killed.path)
    recorder.close()
    (run_folder,) = killed.runs()
    last = max(run_folder.glob("*.mcap"))
    damage(last, last, last)
    (done,) = drain(rosCas, killed)
    assert (done.complete, done.lost) == (True, {})
    assert {each.kind for each in rosCas.losses()} == {LossKind.KILLED}
    assert len(rows_of(rosCas, "/a")) == STEPS * 50


def test_files_whose_messages_are_stored_are_not_missing(rosCas, journal):
    """The recorder has deleted the first ones, and a drain that was interrupted others."""
    (run_folder,) = journal.runs()
    files = sorted(run_folder.glob("*.mcap"))
    (left,) = journal.left()
    drained = Drain(rosCas.catalog, read_left(left))
    drained.run(lambda messages: files[1].exists() or drained.stop())
    left.release()
    assert not files[1].exists()
    assert files[-1].exists()
    for topic in ("/a", "/b"):  # retention has deleted what was stored
        rosCas.getTopic(topic).removeData(Time(0), Time(2**32 - 1))
    (done,) = drain(rosCas, journal)
    assert (done.complete, done.lost) == (True, {})
    assert {each.kind for each in rosCas.losses()} == {LossKind.KILLED}


def test_a_run_whose_notes_cannot_be_read_is_not_drained(rosCas, journal):
    """Nobody knows then which of the missing files were stored."""
    (run_folder,) = journal.runs()
    (run_folder / "settled").mkdir()
    with pytest.raises(SpoolError, match="settled: Is a directory.*make it readable"):
        drain(rosCas, journal)
    assert len(list(run_folder.glob("*.mcap"))) > 3
    (run_folder / "settled").rmdir()
    assert [done.complete for done in drain(rosCas, journal)] == [True]


@pytest.mark.parametrize("newest", [False, pytest.param(True, marks=IN_EVERY_RUN)])
def test_a_full_spool_tells_what_it_drops(proxy, store, rosCas, tmp_path, newest):
    folder = SpoolFolder(tmp_path / "spool", max_bytes=100_000)
    plan = SpoolPlan(folder, drops_newest=newest)
    recorder = Recording(store.catalog, clock=within_a_bucket(), spool=plan)
    send(recorder, [0])
    await_true(lambda: recorder.reports()[0].stored == 1)
    proxy.cut()
    send(recorder, range(1, 100))
    await_true(lambda: recorder.is_held_up)
    for first in range(100, 10_000, 450):  # some a time, or all would be one chunk
        send(recorder, range(first, first + 450))
        await_out_of_memory(recorder)  # they are written, or dropped
    await_true(lambda: recorder.reports()[0].lost > 1000)
    assert folder.nbytes() < 110_000
    proxy.mend()
    await_true(lambda: not recorder.reports()[0].waiting)
    send(recorder, [10_000])
    (report,) = recorder.close()
    assert (report.received, report.stored + report.lost) == (10_001, 10_001)
    assert report.reasons == {LossKind.SPOOL_FULL: report.lost}
    assert sum(loss.count for loss in rosCas.losses()) == report.lost
    stored = [int(wire[4:]) for wire in rows_of(rosCas)]
    assert stored[-1] == 10_000
    assert len(stored) == report.stored
    lost = sorted(set(range(10_001)).difference(stored))
    assert (sum(lost) / len(lost) > 5_000) == newest
    # The spool of 100 KB holds a thousand messages and more. A chunk that is smaller than those
    # which did not fit may still find room: so it is said of the first ones, not of the last.
    assert lost[0] > 1_000 if newest else 9_999 in stored


def test_a_disk_that_is_removed_is_told_and_costs_no_more(proxy, store, rosCas, folder, caplog):
    recorder = Recording(store.catalog, spool=SpoolPlan(folder))
    send(recorder, [0])
    await_true(lambda: recorder.reports()[0].stored == 1)
    proxy.cut()
    send(recorder, range(1, 100))
    await_true(lambda: recorder.is_held_up)
    send(recorder, range(100, 3000))
    await_true(lambda: recorder.on_disk.messages)
    folder.path.rename(folder.path.with_name("removed"))  # at once, while it is written to
    proxy.mend()
    await_true(lambda: not recorder.reports()[0].waiting)
    send(recorder, range(3000, 3100))
    (report,) = recorder.close()
    assert (report.received, report.stored + report.lost) == (3100, 3100)
    assert report.reasons == {LossKind.SPOOL_DAMAGED: report.lost}
    assert (
        "cannot be read: No such file or directory" in report.losses[LossKind.SPOOL_DAMAGED].detail
    )
    assert rows_of(rosCas)[-100:] == [text(n) for n in range(3000, 3100)]


@pytest.mark.parametrize("journal", [False, True])
def test_a_full_disk_is_told_and_memory_is_used(
    proxy, store, rosCas, folder, monkeypatch, caplog, journal
):
    def refuse(self, messages):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(SegmentWriter, "append", refuse)
    recorder = Recording(store.catalog, spool=SpoolPlan(folder, journal=journal))
    send(recorder, [0])
    await_true(lambda: recorder.reports()[0].stored == 1)
    proxy.cut()
    send(recorder, range(1, 100))
    await_true(lambda: recorder.is_held_up)
    send(recorder, range(100, 3000))
    await_true(lambda: "cannot be written: No space left on device" in caplog.text)
    proxy.mend()
    (report,) = recorder.close()
    assert (report.received, report.stored, report.lost) == (3000, 3000, 0)
    assert rows_of(rosCas) == [text(n) for n in range(3000)]


def test_a_journal_that_fills_its_disk_goes_on_when_its_messages_are_stored(
    rosCas, folder, monkeypatch, caplog
):
    append, disk_bytes = SegmentWriter.append, 100_000

    def write(self, messages):
        if folder.nbytes() > disk_bytes:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        append(self, messages)

    monkeypatch.setattr(SegmentWriter, "append", write)
    monkeypatch.setattr("cassandra_ros.recording.backlog.RETRY_SEC", 1.0)
    recorder = Recording(rosCas.catalog, spool=SpoolPlan(folder, journal=True))
    header, sent = header_of(String), 0

    def is_told(line):
        nonlocal sent
        send(recorder, range(sent, sent + 100), header=header)
        sent += 100
        return line in caplog.text

    await_true(partial(is_told, "without the journal until there is room"))
    await_true(partial(is_told, "is written again"))
    (report,) = recorder.close()
    assert (report.stored, report.lost) == (sent, 0)
    assert rows_of(rosCas) == [text(n) for n in range(sent)]


@pytest.mark.parametrize("fails", [True, False])
def test_what_no_file_takes_at_the_end_is_lost_and_told(
    proxy, store, rosCas, folder, monkeypatch, caplog, fails
):
    """The disk is full until the end, or again when the recording ends."""
    append, full = SegmentWriter.append, True

    def refuse(self, messages):
        if full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        append(self, messages)

    monkeypatch.setattr(SegmentWriter, "append", refuse)
    recorder = Recording(store.catalog, spool=SpoolPlan(folder))
    send(recorder, [0])
    await_true(lambda: recorder.reports()[0].stored == 1)
    proxy.cut()
    send(recorder, [1])
    await_true(lambda: recorder.is_held_up)
    send(recorder, range(2, 3000))
    await_true(lambda: "cannot be written: No space left on device" in caplog.text)
    full = fails
    (report,) = recorder.close()
    assert report.stored + report.spooled + report.lost == 3000
    assert (report.lost > 2000) == fails
    proxy.mend()
    for done in drain(rosCas, folder):
        assert done.complete and not done.lost
    (run,) = rosCas.runs()
    assert (run.stored["/text"], run.lost.get("/text", 0)) == (3000 - report.lost, report.lost)
    assert len(rows_of(rosCas)) == 3000 - report.lost


def test_no_message_goes_to_a_file_after_the_last_file_was_read(store, rosCas, folder):
    """The spool's thread had decided to write one just before."""
    recorder = Recording(store.catalog, spool=SpoolPlan(folder))
    recorder._backlog._is_needed = lambda: True
    for n in range(100):
        send(recorder, [n])
        time.sleep(0.01)
    (report,) = recorder.close()
    assert (report.stored, report.lost) == (100, 0)
    assert rows_of(rosCas) == [text(n) for n in range(100)]


def test_the_end_does_not_wait_for_a_silent_store_that_has_everything(
    proxy, store, rosCas, folder, monkeypatch
):
    monkeypatch.setattr("cassandra_ros.recording.recording.SLOW_STORE_SEC", 2.0)
    recorder = Recording(store.catalog, spool=SpoolPlan(folder))
    send(recorder, range(100))
    await_true(lambda: recorder.reports()[0].stored == 100)
    proxy.cut()
    (report,) = recorder.close()
    assert (report.stored, report.lost, report.spooled) == (100, 0, 0)
    assert rows_of(rosCas) == [text(n) for n in range(100)]
    assert rosCas.getTopic("/text").countTopicData() == 100


@pytest.mark.parametrize("journal", [False, True])
def test_a_spool_that_others_fill_leaves_the_memory(
    proxy, store, rosCas, tmp_path, caplog, journal
):
    folder = SpoolFolder(tmp_path / "spool", 100_000)
    (folder.path / "12345").mkdir(parents=True)
    (folder.path / "12345" / "000001.mcap").write_bytes(bytes(200_000))
    recorder = Recording(store.catalog, spool=SpoolPlan(folder, journal=journal))
    send(recorder, [0])
    await_true(lambda: recorder.reports()[0].stored == 1)
    await_true(lambda: ("without the journal until there is room" in caplog.text) == journal)
    proxy.cut()
    send(recorder, range(1, 100))
    await_true(lambda: recorder.is_held_up)
    send(recorder, range(100, 2000))
    time.sleep(2.0)  # the spool's thread tries more than once
    proxy.mend()
    await_true(lambda: recorder.reports()[0].stored == 2000)
    (report,) = recorder.close()
    assert (report.stored, report.lost) == (2000, 0)
    assert rows_of(rosCas) == [text(n) for n in range(2000)]


def test_a_run_that_begins_while_the_store_is_away(proxy, store, rosCas, folder):
    """As a snapshot does."""
    earlier = Recording(store.catalog, spool=SpoolPlan(folder))
    send(earlier, [0])
    await_true(lambda: earlier.reports()[0].stored == 1)
    proxy.cut()
    send(earlier, range(1, 10))
    await_true(lambda: earlier.is_held_up)
    later = Recording(store.catalog, name="later", spool=SpoolPlan(folder))
    assert not later.opened
    send(later, range(10, 100))
    proxy.mend()
    await_true(lambda: later.reports()[0].stored == 90)
    (report,) = later.close()
    assert (report.stored, report.lost) == (90, 0)
    earlier.close()
    assert sorted(int(wire[4:]) for wire in rows_of(rosCas)) == [*range(100)]
    (run,) = (run for run in rosCas.runs() if run.name == "later")
    assert (run.state, run.stored) == ("ended", {"/text": 90})


def test_a_store_that_comes_late(proxy, keyspace, rosCas, folder):
    """What came before it is on disk; tables and the run are made when it is there."""
    late: Future = Future()
    settings, plan = all_in("packed"), SpoolPlan(folder)
    recorder = Recording(late, settings=settings, name="early", spool=plan)
    send(recorder, range(2000))
    await_true(lambda: recorder.on_disk.messages == 2000)
    assert recorder.waiting()[0] == 2000
    late.set_result(rosCas.catalog)
    await_true(lambda: recorder.reports()[0].stored == 2000)
    (report,) = recorder.close()
    assert (report.stored, report.lost) == (2000, 0)
    assert rows_of(rosCas) == [text(n) for n in range(2000)]
    (run,) = rosCas.runs()
    assert (run.name, run.state) == ("early", "ended")


def test_a_run_that_got_another_robot_meanwhile_is_drained_as_that(
    proxy, store, rosCas, folder, monkeypatch
):
    left_behind(proxy, store, folder, range(1, 101))
    monkeypatch.setattr("cassandra_ros.topics.run_list.STALE_SEC", 0.0)
    (run,) = rosCas.runs()
    rosCas.upkeep.setRuns(run.writer, nodeID="turtle", name="patrol", labels={"k": "v"})
    (done,) = drain(rosCas, folder)
    rows = list(rosCas.getTopic("/text").rows())
    assert (done.complete, {row.node for row in rows}, len(rows)) == (True, {"turtle"}, 101)
    (run,) = rosCas.runs()
    assert (run.node, run.name, dict(run.labels)) == ("turtle", "patrol", {"k": "v"})
