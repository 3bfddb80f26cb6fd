# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the files of a run miss is told once, also where an earlier drain has settled some."""

from __future__ import annotations

from itertools import product

import pytest
from spool.test_segments import LABELLED, connection

from cassandra_ros.files.spool.message_account import read_run
from cassandra_ros.files.spool.segment_reader import SegmentReader
from cassandra_ros.files.spool.segment_writer import SegmentWriter
from cassandra_ros.files.spool.spool_folder import SpoolFolder
from cassandra_ros.files.spool.spool_label import TopicTotal

FILES = 3
STAYS = "/t1"
"""Topic whose messages an earlier drain has left in the spool."""


@pytest.fixture
def run(tmp_path):
    """A run of several files, its messages by file, and the totals at the end of each file."""
    folder = SpoolFolder(tmp_path / "spool").begin(7)
    connections, totals = [connection(n) for n in range(2)], {}
    messages, ends, number = [], [], 0
    for _ in range(FILES):
        writer, mine = SegmentWriter(folder.new_file(), LABELLED, totals), []
        for _ in range(4):
            chunk = [(connections[n % 2], number + n, number + n, b"x" * 400) for n in range(6)]
            number += len(chunk)
            writer.append(chunk)
            mine += chunk
        writer.close()
        messages.append(mine)
        ends.append({t: TopicTotal(n.count, n.first_ns, n.last_ns) for t, n in totals.items()})
    yield folder, messages, ends
    folder.release()


def delete(folder, path, totals, mine):
    """All its messages were stored."""
    folder.delete_file(path, totals)
    return []


def thin(folder, path, totals, mine):
    """Those of a topic stay."""
    rest = [message for message in mine if message[0].topic == STAYS]
    kept = path.with_suffix(".kept")
    writer = SegmentWriter(kept, LABELLED)
    writer.append(rest)
    writer.close()
    folder.note_settled(path, totals)
    kept.replace(path)
    return rest


def note(folder, path, totals, mine):
    """Those of a topic were to stay; the process ended before the file was replaced."""
    folder.note_settled(path, totals)
    return mine


STEPS = [
    steps for count in range(FILES + 1) for steps in product((delete, thin, note), repeat=count)
]


@pytest.mark.parametrize(
    "steps", STEPS, ids=["-".join(step.__name__ for step in steps) or "none" for steps in STEPS]
)
def test_of_files_that_were_settled_nothing_is_missing(run, steps):
    folder, messages, ends = run
    expected, paths = [], folder.files()
    for step, path, totals, mine in zip(steps, paths, ends, messages):
        expected += step(folder, path, totals, mine)
    expected += [message for mine in messages[len(steps) :] for message in mine]
    parts = list(read_run(folder))
    assert [(part.damage, part.missing) for part in parts if part.damage or part.missing] == []
    found = [message for part in parts for message in part.messages]
    assert [(each.topic, *rest) for each, *rest in found] == [
        (each.topic, *rest) for each, *rest in expected
    ]


@pytest.mark.parametrize("first", [delete, thin, note])
def test_what_is_damaged_after_a_settled_file_is_told_once(run, first):
    folder, messages, ends = run
    one, two, three = folder.files()
    first(folder, one, ends[0], messages[0])
    data = bytearray(two.read_bytes())
    data[data.index(b"x" * 400)] ^= 1
    two.write_bytes(data)
    three.unlink()
    told = [each for part in read_run(folder) for each in part.missing]
    assert [(each.topic, each.messages) for each in told] == [("/t0", 3), ("/t1", 3)]
    read = SegmentReader(two).parts()
    assert sum(len(part.messages) for part in read) == len(messages[1]) - 6
