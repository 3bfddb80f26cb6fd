# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Store one bag by several processes, in the same rows as by one process.

All processes use the bag's writer id, and the directory of buckets has one row per bucket and
writer. So no two processes may write to one bucket: the work is divided between tables, and between
the buckets of one table.
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
from cassandra_ros.bag.job_process import ImportTask, Span, TaskResult
from cassandra_ros.bag.message_file import MessageFile, MessageProgress
from cassandra_ros.errors import WriteFailed
from cassandra_ros.keys import MAX_NS
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.topics.message_writer import Handle

MAX_JOBS = 64
END_SEC = 20.0
"""Maximum time that a process has to store its buffered messages after it was told to end, s."""
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
        For each process the time range to store by connection number. The list is shorter than
        ``jobs`` if there is not enough to divide.
    """
    spans: list[dict[int, Span]] = [{} for _ in range(jobs)]
    loads, sizes = [0.0] * jobs, content.sizes
    moments = _moments(reader, sizes, jobs)
    tables: dict[str, list[int]] = {}
    for number, handle in handles.items():
        tables.setdefault(handle.table.name, []).append(number)
    # The largest table first. A table that cannot be divided goes to the least loaded process.
    for numbers in sorted(tables.values(), key=lambda n: -sum(map(sizes.__getitem__, n))):
        metadata = handles[numbers[0]].table.metadata
        # A block also ends before a message that is older than the one before it, so the blocks of
        # unordered messages depend on where the work is divided.
        loose = metadata.packed and not content.unordered.isdisjoint(numbers)
        cuts = [] if loose else _cuts(metadata, moments)
        size = sum(map(sizes.__getitem__, numbers))
        if cuts:
            edges = [0, *cuts, MAX_NS + 1]
            for job in range(jobs):
                spans[job].update(dict.fromkeys(numbers, (edges[job], edges[job + 1])))
                loads[job] += size / jobs
        else:
            job = loads.index(min(loads))
            spans[job].update(dict.fromkeys(numbers, (0, MAX_NS + 1)))
            loads[job] += size
    return [span for span in spans if span]


def _moments(reader: MessageFile, sizes: Mapping[int, int], jobs: int) -> list[int]:
    """Return the times, ns, that divide the bag into ``jobs`` parts of equal size."""
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
    """Return the bucket starts next to some times; [] = the table cannot be divided there."""
    if metadata.own_time or metadata.named:
        return []  # the buckets do not follow from the times in the bag
    length = metadata.bucket_ns
    cuts = [(moment + length // 2) // length * length for moment in moments]
    return cuts if len(set(cuts)) == len(cuts) and all(cuts) else []


class _Job:
    """A process that executes one task, and a thread that reads its output."""

    def __init__(self, task: ImportTask, lines: queue.Queue[tuple[_Job, str]]) -> None:
        self.result: TaskResult | None = None
        """The result of the task; None = the process has not reported it."""
        self._lines = lines
        self.process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, *filter(None, sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._listener = threading.Thread(target=self._listen, args=(task,), daemon=True)
        self._listener.start()

    def _listen(self, task: ImportTask) -> None:
        pipes = self.process.stdin, self.process.stdout
        if pipes[0] is None or pipes[1] is None:
            raise AssertionError("Popen was called with two pipes")
        try:
            pipes[0].write(task.to_line())
            pipes[0].flush()
            for line in pipes[1]:
                self._lines.put((self, line))
        except OSError:
            pass  # the process has ended; its exit status gives the reason
        finally:
            self.process.wait()
            self._lines.put((self, ""))

    def hear(self, line: str) -> None:
        """Take the result from a line of output; ignore lines of progress."""
        if line.startswith("{"):
            self.result = TaskResult.from_line(line)

    def end(self) -> None:
        """Tell the process to store its buffered messages and to end; wait for its end."""
        if self.process.poll() is None:
            self.process.terminate()
        try:
            self.process.wait(END_SEC)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self._listener.join()


def run_tasks(
    tasks: Iterable[ImportTask], progress: MessageProgress | None, counts: dict[int, list[int]]
) -> None:
    """Execute tasks, each in a process of its own; return when all processes have ended.

    Args:
        counts: Filled with the number and size (bytes) of acknowledged messages by connection
            number, also if an error is raised.

    Raises:
        BagError: A part of the bag is damaged. All messages before the damage are stored, and
            those of the other tasks.
        WriteFailed: A process was killed.
        CassandraRosError: Any other error of a process; all processes were ended.
    """
    lines: queue.Queue[tuple[_Job, str]] = queue.Queue()
    jobs: list[_Job] = []
    try:
        for task in tasks:
            jobs.append(_Job(task, lines))
        _listen_to_all(len(jobs), lines, progress)
    finally:
        for job in jobs:
            job.end()
        while not lines.empty():  # output after _listen_to_all has ended
            job, line = lines.get()
            job.hear(line)
        for job in jobs:
            for number, (messages, size) in job.result.counts.items() if job.result else ():
                count = counts.setdefault(number, [0, 0])
                count[0] += messages
                count[1] += size


def _listen_to_all(
    running: int, lines: queue.Queue[tuple[_Job, str]], progress: MessageProgress | None
) -> None:
    """Pass on the progress of ``running`` processes until all have ended; raise their errors."""
    damage: list[str] = []
    while running:
        try:
            job, line = lines.get(timeout=_POLL_SEC)
        except queue.Empty:
            line = "[0, 0]"  # call progress regularly: it may raise to stop the import
        if line.startswith("["):
            messages, size = json.loads(line)
            if progress is not None:
                progress(messages, size)
        elif line:
            job.hear(line)
        else:
            running -= 1
            result = job.result
            if result is None:
                raise WriteFailed(
                    f"a process that stored a part of the bag has ended with status "
                    f"{job.process.returncode}, before its end; what it stored stays, and the "
                    "same import again completes it"
                )
            if result.error.startswith("Bag"):
                damage.append(result.text)
            elif result.error:
                raise getattr(errors, result.error, WriteFailed)(result.text)
    if damage:
        raise errors.BagError("; ".join(damage))
