# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""An import by several processes: the same rows as by one, and a clean end where one fails."""

from __future__ import annotations

import contextlib

import psutil
import pytest
from bag.test_import_export import counts_agree, stored_rows
from bag.truth import string_connection, string_wire
from campaign import sparing

from cassandra_ros.bag import importer
from cassandra_ros.bag.bag_reader import BagReader
from cassandra_ros.bag.bag_writer import BagWriter
from cassandra_ros.bag.comparison import verify_bag
from cassandra_ros.bag.identity import read_content
from cassandra_ros.bag.importer import import_bag
from cassandra_ros.bag.jobs import spans_of_jobs
from cassandra_ros.errors import BagError, InvalidOption, WriteFailed

HOUR_NS = 3600 * 10**9


def sparse_bag(path, count=2000, late=5):
    """Write a bag of one busy topic by two publishers, for weeks, and two small ones.

    Every so many messages of the busy one may be hours late.
    """
    with BagWriter(path, "bz2", chunk_bytes=20_000) as writer:
        busy = [writer.connection(string_connection("/busy", callerid=c)) for c in ("/a", "/b")]
        small = [writer.connection(string_connection(topic)) for topic in ("/small", "/late")]
        for i in range(count):
            hour = i - i % 7 * (i % late == 0)
            writer.write(busy[i % 2], hour * HOUR_NS, string_wire("x" * 100))
            if not i % 50:
                writer.write(small[i % 4 // 2], i * HOUR_NS + 5, string_wire(f"text {i}"))
    return path


def children():
    """Return the processes that this one has started for an import."""
    found = []
    for child in psutil.Process().children():
        with contextlib.suppress(psutil.Error):  # it has ended meanwhile
            if any("bag.job_process" in word for word in child.cmdline()):
                found.append(child)
    return found


def cql_rows(rosCas, cql):
    """The keys of all rows as they lie there, also of those that hold many messages."""
    return {
        (table.name, *row)
        for topic in rosCas.getAllTopics()
        for table in topic.tables
        for row in cql.execute(
            f'SELECT "_bucket", "_t", "_seq", "_conn" FROM {rosCas.keyspace}."{table.name}"'
        )
    }


WAYS = [("binary", 5), ("packed", 5), ("packed", 10**6)]


@pytest.mark.parametrize(("form", "late"), sparing(WAYS, kept=[("packed", 5)]))
def test_several_processes_write_the_rows_of_one(rosCas, cql, tmp_path, monkeypatch, form, late):
    path, seen, spans = sparse_bag(tmp_path / "a.bag", late=late), [], []

    def divide(*args):
        spans.extend(spans_of_jobs(*args))
        return spans

    monkeypatch.setattr(importer, "spans_of_jobs", divide)

    def progress(messages, size):
        seen.append((messages, len(children())))

    report = import_bag(rosCas, path, format=form, jobs=3, progress=progress)
    # Blocks of a connection that is out of order are written by one process.
    parts_of_busy = {span[number] for span in spans for number in (0, 1) if number in span}
    assert len(parts_of_busy) == (1 if form == "packed" and late == 5 else 3)
    monkeypatch.undo()
    assert max(count for _, count in seen) > 1
    assert sum(messages for messages, _ in seen) == report.messages == 2040
    rows, keys = stored_rows(rosCas), cql_rows(rosCas, cql)
    counts = {info.topic: info.count for info in rosCas.info()}
    assert counts == {"/busy": 2000, "/small": 20, "/late": 20}
    assert verify_bag(rosCas, path).equal
    assert rosCas.runs()[0].stored == counts
    again = import_bag(rosCas, path, format=form)
    assert again == report
    assert (stored_rows(rosCas), cql_rows(rosCas, cql)) == (rows, keys)
    assert {info.topic: info.count for info in rosCas.info()} == counts


def test_what_lies_outside_of_the_times_of_the_index_is_not_divided(tmp_path, monkeypatch):
    """Messages are missed there, and then all are stored by one process: in the same blocks."""
    with BagReader(sparse_bag(tmp_path / "a.bag", 200, late=10**6)) as reader:
        assert not read_content(reader).unordered
        times = reader.chunk_times(0)
        monkeypatch.setattr(reader, "chunk_times", lambda chunk: (times[0], times[1] - 1))
        assert read_content(reader).unordered


def test_a_process_that_is_killed_ends_the_import(rosCas, cql, tmp_path):
    path = sparse_bag(tmp_path / "a.bag", 6000)
    killed, busy = [], {"format": "binary", "topics": ["/busy"], "jobs": 2}  # one topic, cut in two

    def kill(messages, size):
        if messages and not killed and len(children()) > 1:
            killed.append(children()[0])
            killed[0].kill()

    with pytest.raises(WriteFailed, match="has ended with status -9"):
        import_bag(rosCas, path, progress=kill, **busy)
    assert not children()
    (run,) = rosCas.runs()
    stored = counts_agree(rosCas, cql)
    assert run.state == "interrupted"
    assert sum(run.stored.values()) <= sum(stored.values()) < 6000
    import_bag(rosCas, path, **busy)
    assert counts_agree(rosCas, cql) == {"/busy": 6000}
    assert verify_bag(rosCas, path, topics=["/busy"]).equal


def test_an_interrupted_import_leaves_no_process(rosCas, cql, tmp_path):
    path = sparse_bag(tmp_path / "a.bag", 6000)

    def interrupt(messages, size):
        if messages:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_bag(rosCas, path, format="binary", jobs=2, progress=interrupt)
    assert not children()
    (run,) = rosCas.runs()
    assert 0 < sum(run.stored.values()) == sum(counts_agree(rosCas, cql).values())


def test_damage_in_a_part_leaves_the_others(rosCas, cql, tmp_path):
    path = sparse_bag(tmp_path / "a.bag")
    with BagReader(path) as reader:
        info = reader.chunk_info(reader.chunk_count - 2)
    changed = bytearray(path.read_bytes())
    changed[info.position + 200] ^= 0xFF
    path.write_bytes(changed)
    with pytest.raises(BagError, match="messages beside it are stored") as caught:
        import_bag(rosCas, path, format="binary", jobs=2)
    stored = sum(counts_agree(rosCas, cql).values())
    assert f"; {stored} messages beside it" in str(caught.value)
    assert stored > 1000


def test_jobs_are_checked(rosCas, tmp_path):
    with pytest.raises(InvalidOption, match="jobs=0 cannot be used: give a whole number of 1"):
        import_bag(rosCas, sparse_bag(tmp_path / "a.bag", 10), jobs=0)
