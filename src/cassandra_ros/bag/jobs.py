# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Several processes that store one bag together, in the same rows as one alone.

All write under the bag's writer id, and the directory of buckets has one row for each writer. So
the work is cut where no bucket is shared: between tables, and between the buckets of one table.
"""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from typing import Iterable, Mapping, Sequence

from cassandra_ros import errors
from cassandra_ros.bag.identity import BagContent
from cassandra_ros.bag.job_process import ImportTask, Span, Stored
from cassandra_ros.bag.message_file import MessageFile, MessageProgress
from cassandra_ros.errors import WriteFailed
from cassandra_ros.keys import MAX_NS
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.topics.message_writer import Handle

MAX_JOBS = 64
END_SEC = 20.0
"""So long a process may take to store what it has on its way when it is told to end."""
_POLL_SEC = 0.2
# Our search path, not its own: that begins with the folder in which the user happens to be.
_PROGRAM = (
    "import sys; sys.path[:] = sys.argv[1:]; from cassandra_ros.bag.job_process import main; "
    "sys.exit(main())"
)


def spans_of_jobs(
    reader: MessageFile, handles: Mapping[int, Handle], content: BagContent, jobs: int
) -> list[dict[int, Span]]:
    """Divide the messages of a bag among processes, about equally by bytes.

    Returns:
        For each process from which time on and before which one it stores a connection's
        messages; fewer than ``jobs`` where there is not enough to divide.
    """
    parts: list[dict[int, Span]] = [{} for _ in range(jobs)]
    loads, sizes = [0.0] * jobs, content.sizes
    moments = _moments(reader, sizes, jobs)
    tables: dict[str, list[int]] = {}
    for number, handle in handles.items():
        tables.setdefault(handle.table.name, []).append(number)
    # The largest first: what cannot be cut goes to whoever has the least so far.
    for numbers in sorted(tables.values(), key=lambda n: -sum(map(sizes.__getitem__, n))):
        metadata = handles[numbers[0]].table.metadata
        # Blocks end where buckets do, and wherever a message is older than the one before it.
        loose = metadata.packed and not content.unordered.isdisjoint(numbers)
        cuts = [] if loose else _cuts(metadata, moments)
        size = sum(map(sizes.__getitem__, numbers))
        if cuts:
            edges = [0, *cuts, MAX_NS + 1]
            for job in range(jobs):
                parts[job].update(dict.fromkeys(numbers, (edges[job], edges[job + 1])))
                loads[job] += size / jobs
        else:
            job = loads.index(min(loads))
            parts[job].update(dict.fromkeys(numbers, (0, MAX_NS + 1)))
            loads[job] += size
    return [part for part in parts if part]


def _moments(reader: MessageFile, sizes: Mapping[int, int], jobs: int) -> list[int]:
    """Return the times, ns, between which equal parts of the bag lie, as its index tells."""
    means = {number: sizes[number] / count for number, count in reader.counts.items()}
    chunks = sorted(map(reader.chunk_info, range(reader.chunk_count)), key=lambda c: c.start_ns)
    weights = [sum(n * means[number] for number, n in chunk.counts.items()) for chunk in chunks]
    total, before, found = sum(weights), 0.0, [0]
    for chunk, weight in zip(chunks, weights):
        while len(found) < jobs and before >= total * len(found) / jobs:
            found.append(chunk.start_ns)
        before += weight
    return found[1:]


def _cuts(metadata: TopicMetadata, moments: Sequence[int]) -> list[int]:
    """Return the beginnings of buckets near some times, all different; empty = keep it whole."""
    if metadata.own_time or metadata.named:
        return []  # the buckets, where there are any, are not those of the times in the bag
    length = metadata.bucket_ns
    cuts = [(moment + length // 2) // length * length for moment in moments]
    return cuts if len(set(cuts)) == len(cuts) and all(cuts) else []


class _Job:
    """One process, and a thread that hears what it says."""

    def __init__(self, part: ImportTask, heard: queue.Queue[tuple[_Job, str]]) -> None:
        self.stored: Stored | None = None
        """What it said at its end."""
        self._heard = heard
        self.process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, *filter(None, sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._listener = threading.Thread(target=self._listen, args=(part,), daemon=True)
        self._listener.start()

    def _listen(self, part: ImportTask) -> None:
        pipes = self.process.stdin, self.process.stdout
        if pipes[0] is None or pipes[1] is None:
            raise AssertionError("both were asked for")
        try:
            pipes[0].write(part.to_line())
            pipes[0].flush()
            for line in pipes[1]:
                self._heard.put((self, line))
        except OSError:
            pass  # it has ended; its status says how
        finally:
            self.process.wait()
            self._heard.put((self, ""))

    def hear(self, line: str) -> None:
        """Take what it said at its end; other lines are passed over."""
        if line.startswith("{"):
            self.stored = Stored.from_line(line)

    def end(self) -> None:
        """Have it store what it has on its way, and end."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            self.process.wait(END_SEC)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._listener.join()


def run_parts(
    parts: Iterable[ImportTask], progress: MessageProgress | None, counts: dict[int, list[int]]
) -> None:
    """Store parts of a bag, each in a process of its own; return when all of them have ended.

    Args:
        counts: Gets, also where this raises, by number of the connection the messages and bytes
            that are known to be acknowledged.

    Raises:
        BagError: A part of the bag is damaged; the others are stored, and so is what stands
            before the damage.
        WriteFailed: A process was ended by somebody.
        CassandraRosError: What else ended one of them; then the others were ended, too.
    """
    heard: queue.Queue[tuple[_Job, str]] = queue.Queue()
    jobs: list[_Job] = []
    try:
        for part in parts:
            jobs.append(_Job(part, heard))
        _hear(len(jobs), heard, progress)
    finally:
        for job in jobs:
            job.end()
        while not heard.empty():  # what they said after we stopped listening
            job, line = heard.get()
            job.hear(line)
        for job in jobs:
            for number, (messages, size) in job.stored.counts.items() if job.stored else ():
                count = counts.setdefault(number, [0, 0])
                count[0] += messages
                count[1] += size


def _hear(
    running: int, heard: queue.Queue[tuple[_Job, str]], progress: MessageProgress | None
) -> None:
    """Pass on the progress of so many processes until all have ended; raise what ended one."""
    damage: list[str] = []
    while running:
        try:
            job, line = heard.get(timeout=_POLL_SEC)
        except queue.Empty:
            line = "[0, 0]"  # whoever is told may want to end
        if line.startswith("["):
            messages, size = json.loads(line)
            if progress is not None:
                progress(messages, size)
        elif line:
            job.hear(line)
        else:
            running -= 1
            stored = job.stored
            if stored is None:
                raise WriteFailed(
                    f"a process that stored a part of the bag has ended with status "
                    f"{job.process.returncode}, before its end; what it stored stays, and the "
                    "same import again completes it"
                )
            if stored.error.startswith("Bag"):
                damage.append(stored.text)
            elif stored.error:
                raise getattr(errors, stored.error, WriteFailed)(stored.text)
    if damage:
        raise errors.BagError("; ".join(damage))
