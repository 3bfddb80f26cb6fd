# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Route of the marks on a timeline: starts and ends of recordings, and losses.

A snapshot is a recording that starts when it is requested. Imports have no marks, because only the
time of the import is known, not that of the recording of its bag.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterable, Iterator, Mapping

from cassandra_ros.messages.stamps import to_ns
from cassandra_ros.read import Read
from cassandra_ros.store.tables.registry import Loss, Run
from cassandra_ros.viewing.answers import Json
from cassandra_ros.viewing.api_call import END, NODES, RUNS, START, ApiCall, whose_of
from cassandra_ros.viewing.catalog_routes import MAX_LISTED, listed_at_most
from cassandra_ros.viewing.event_routes import within
from cassandra_ros.viewing.route import Parameter, Route

_USUAL_MARKS = 2000


@dataclass(frozen=True)
class TimelineMark:
    """An event at a time or in a time range."""

    kind: str
    """'begin' or 'end' of a recording, or 'loss'."""
    first_ns: int
    last_ns: int
    """End of a loss, included, ns; the same as first_ns for other kinds."""
    node: str
    run: str
    """Name of the run, or its writer id if it has no name."""
    text: str
    """Labels of a recording, or reason of a loss."""
    topic: str = ""
    """Name of the topic; '' = all topics."""
    count: int | None = None
    """Number of lost messages; None = not known."""

    def answer(self) -> dict[str, Json]:
        """Return the mark as JSON."""
        return {
            "kind": self.kind,
            "start": str(self.first_ns),
            "end": str(self.last_ns),
            "node": self.node,
            "run": self.run,
            "text": self.text,
            "topic": self.topic,
            "count": self.count,
        }


def _marks(call: ApiCall) -> Json:
    keyspace, read = call.catalog.keyspace, Read(within(call), whose_of(call))
    losses = keyspace.runs.losses(call.texts("topics") or None, read)
    return listed_marks(call, keyspace.registry.runs(), losses, read)


def listed_marks(
    call: ApiCall, all_runs: Iterable[Run], losses: Iterable[Loss], read: Read
) -> dict[str, Json]:
    """Return as JSON the losses, and the starts and ends of those runs that a read selects."""
    limit, whose, time_range = listed_at_most(call), read.whose, read.time_range
    runs = {(run.writer, run.node): run for run in all_runs}
    marks = [_of_loss(loss, runs) for loss in losses]
    for run in runs.values():
        if (whose.nodes is None or run.node in whose.nodes) and (
            whose.writers is None or run.writer in whose.writers
        ):
            marks += [
                mark for mark in _of_run(run) if time_range.low <= mark.first_ns <= time_range.high
            ]
    marks.sort(key=lambda mark: (mark.first_ns, mark.kind, mark.topic))
    listed: list[Json] = [mark.answer() for mark in marks[:limit]]
    return {"marks": listed, "left_off": max(len(marks) - limit, 0)}


def _of_loss(loss: Loss, runs: Mapping[tuple[int, str], Run]) -> TimelineMark:
    run = runs.get((loss.writer, loss.node))
    return TimelineMark(
        kind="loss",
        first_ns=loss.first_ns,
        last_ns=loss.last_ns,
        node=loss.node,
        run=run.name if run is not None and run.name else str(loss.writer),
        text=loss.kind.value,
        topic=loss.topic,
        count=loss.count or None,
    )


def _of_run(run: Run) -> Iterator[TimelineMark]:
    if run.kind == "import":
        return
    name = run.name or str(run.writer)
    labels = sorted(run.public_labels.items())
    text = ", ".join(f"{key}={value}" if value else key for key, value in labels)
    for kind, time in (("begin", run.started), ("end", run.ended)):
        if time is not None:
            ns = to_ns(time)
            yield TimelineMark(kind, ns, ns, run.node, name, text)


ROUTES: tuple[Route, ...] = (
    Route(
        "/api/marks",
        _marks,
        "Starts and ends of recordings, and losses, the earliest first.",
        (
            START,
            END,
            Parameter("topics", "texts", "Topics whose losses are listed; missing: all topics."),
            NODES,
            RUNS,
            Parameter(
                "limit", "count", f"Maximum number of marks, to {MAX_LISTED}.", default=_USUAL_MARKS
            ),
        ),
    ),
)
