# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Imports as processes of their own: killed half-way, and measured for memory."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from bag.test_import_export import counts_agree, stored_rows
from bag.truth import string_connection, string_wire
from nodes.children import await_true
from proxy import BATCH, Proxy
from suites import sparing
from topics.test_run_states import age

from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.comparison import verify_bag
from cassandra_ros.files.bag.importer import import_bag

ROOT = Path(__file__).resolve().parents[2]
START = 1_700_000_000 * 10**9

IMPORT = """
import os, resource, signal, sys
from cassandra_ros import RosCassandra
from cassandra_ros.files.bag.importer import import_bag
host, port, keyspace, path, most, form = sys.argv[1:]
done = 0
def count(messages, size):
    global done
    done += messages
    if done > int(most):
        os.kill(os.getpid(), signal.SIGKILL)
with RosCassandra(host, int(port), keyspace=keyspace) as rosCas:
    report = import_bag(rosCas, path, format=form or None, progress=count)
print(report.messages, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def spawn_import(cassandra, keyspace, path, killed_after=10**9, form=""):
    """Import in a process that is killed after a number of messages."""
    where = (
        cassandra.host,
        str(cassandra.port),
        keyspace,
        str(path),
        str(int(killed_after)),
        form,
    )
    return subprocess.Popen(
        [sys.executable, "-c", IMPORT, *where],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        stdout=subprocess.PIPE,
        text=True,
    )


def write_bag(path, count, size, topics=4):
    """Write a bag with a number of messages of one size, 1000 a second on each topic."""
    with BagWriter(path) as writer:
        numbers = [writer.connection(string_connection(f"/topic{i}")) for i in range(topics)]
        wires = [string_wire(bytes([65 + i]) * (size - 4)) for i in range(26)]
        for i in range(count):
            writer.write(
                numbers[i % topics], START + i * 1_000_000 // topics, wires[i % len(wires)]
            )
    return path


def counts_are_told(ros_cas, cql):
    """Return whether the only run tells as many messages as there are rows."""
    (run,) = ros_cas.runs()
    return sum(run.stored.values()) == sum(counts_agree(ros_cas, cql).values())


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
def test_an_import_that_was_killed_is_completed_by_the_next(
    rosCas, cassandra, keyspace, cql, tmp_path
):
    count = 20_000
    path = write_bag(tmp_path / "a.bag", count, 100)
    for killed_at in (0.3, 0.6):
        child = spawn_import(cassandra, keyspace, path, killed_at * count)
        child.communicate(timeout=300)
        assert child.returncode == -signal.SIGKILL
        (run,) = rosCas.runs()  # at once: after a minute it is taken for interrupted
        assert run.state == "recording"
        # The server may still store what the process has sent.
        await_true(lambda: counts_are_told(rosCas, cql))
        (run,) = rosCas.runs()
        assert 0 < sum(run.stored.values()) < count
        assert run.ended is None
        assert not verify_bag(rosCas, path).equal
    age(cql, keyspace)
    assert [run.state for run in rosCas.runs()] == ["interrupted"]
    import_bag(rosCas, path)
    assert verify_bag(rosCas, path).equal
    assert sum(counts_agree(rosCas, cql).values()) == count
    (run,) = rosCas.runs()
    assert (run.state, sum(run.stored.values())) == ("ended", count)
    rows = stored_rows(rosCas)
    import_bag(rosCas, path)
    assert stored_rows(rosCas) == rows


@pytest.mark.suite("all", "hundreds of megabytes")
def test_memory_does_not_grow_with_the_bag(cassandra, keyspace, cql, rosCas, tmp_path):
    peaks = []
    for name, megabytes in (("small", 50), ("large", 500)):
        count = megabytes * 1_000_000 // 1000
        path = write_bag(tmp_path / f"{name}.bag", count, 1000)
        assert path.stat().st_size > megabytes * 1_000_000
        child = spawn_import(cassandra, keyspace, path)
        output, _ = child.communicate(timeout=1800)
        path.unlink()
        assert child.returncode == 0
        messages, peak_kb = map(int, output.split())
        assert messages == count
        peaks.append(peak_kb / 1000)
    assert peaks[1] <= peaks[0] + 50, f"peak RSS {peaks[0]:.0f} MB and {peaks[1]:.0f} MB"


@pytest.mark.suite("all", "hundreds of megabytes")
def test_opening_a_bag_of_many_chunks_takes_little_memory(tmp_path):
    import tracemalloc

    from cassandra_ros.files.bag.bag_reader import BagReader

    path = tmp_path / "a.bag"
    with BagWriter(path, chunk_bytes=1) as writer:
        number = writer.connection(string_connection())
        for i in range(20_000):
            writer.write(number, START + i, b"")
    tracemalloc.start()
    with BagReader(path) as reader:
        assert reader.chunk_count == 20_000
        assert tracemalloc.get_traced_memory()[0] < 20_000 * 60 + 200_000
    tracemalloc.stop()


def start_import(proxy, keyspace, path, *options):
    """Start the program that imports a bag by way of a proxy."""
    return subprocess.Popen(
        [
            *(sys.executable, str(ROOT / "scripts/cassandra_bag"), "import", str(path)),
            *("--host", proxy.host, "--port", str(proxy.port), "--keyspace", keyspace),
            *("--format", "binary", *options),
        ],
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


INTERRUPTED = "cassandra_bag: interrupted; the same command again completes the import\n"


def without_waits(errors):
    """Leave out what is said of answers that come late, as those that are held back do."""
    late = ("trying again", "tried again", "the store at ")
    return "".join(
        line for line in errors.splitlines(True) if not any(text in line for text in late)
    )


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.parametrize(
    "signal_number", sparing([signal.SIGINT, signal.SIGTERM], [signal.SIGTERM], "campaign")
)
@pytest.mark.fault
def test_a_signal_ends_an_import_and_the_next_completes_it(
    rosCas, cassandra, keyspace, cql, tmp_path, signal_number
):
    path = write_bag(tmp_path / "a.bag", 60_000, 100)  # more bytes than may wait for an answer
    with Proxy(cassandra.host, cassandra.port) as proxy:
        held = proxy.catch(lambda f: f.opcode == BATCH and b"A" * 90 in f.body, failed=False)
        held.hold()
        child = start_import(proxy, keyspace, path)
        held.wait()
        child.send_signal(signal_number)
        held.release()
        _, errors = child.communicate(timeout=300)
    assert child.returncode == 128 + signal_number
    assert without_waits(errors) == INTERRUPTED
    assert [run.state for run in rosCas.runs()] == ["interrupted"]
    import_bag(rosCas, path)
    assert verify_bag(rosCas, path).equal
    assert sum(counts_agree(rosCas, cql).values()) == 60_000


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.parametrize(
    "signal_number", sparing([signal.SIGINT, signal.SIGTERM], [signal.SIGINT], "campaign")
)
@pytest.mark.fault
def test_the_first_signal_ends_an_import_whose_store_is_silent(
    rosCas, cassandra, keyspace, cql, tmp_path, signal_number
):
    """It does not wait until what is on its way is given up, which would be another error."""
    path = write_bag(tmp_path / "a.bag", 60_000, 100)
    with Proxy(cassandra.host, cassandra.port) as proxy:
        held = proxy.catch(lambda f: f.opcode == BATCH and b"A" * 90 in f.body, failed=False)
        held.hold()
        child = start_import(proxy, keyspace, path)
        held.wait()
        proxy.freeze()
        child.send_signal(signal_number)
        _, errors = child.communicate(timeout=300)
    assert child.returncode == 128 + signal_number, errors
    assert without_waits(errors) == INTERRUPTED
    import_bag(rosCas, path)
    assert verify_bag(rosCas, path).equal
    assert sum(counts_agree(rosCas, cql).values()) == 60_000
