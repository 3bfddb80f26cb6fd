# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The services of the node recorder: they unpack a request, call Recorder and pack the answer."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Callable, Iterator, Mapping, Sequence

from cassandra_ros.arguments import check_pairs
from cassandra_ros.errors import CassandraRosError, InvalidOption
from cassandra_ros.msg import RecordedTopic
from cassandra_ros.nodes.mark_answer import pack_event, read_values
from cassandra_ros.nodes.recorder import Recorder
from cassandra_ros.recording.option_values import read_label
from cassandra_ros.recording.recording_status import RecordingStatus
from cassandra_ros.recording.topic_counts import TopicReport
from cassandra_ros.srv import (
    Mark,
    MarkRequest,
    MarkResponse,
    RecorderStatus,
    RecorderStatusRequest,
    RecorderStatusResponse,
    RecordTopics,
    RecordTopicsRequest,
    RecordTopicsResponse,
    Snapshot,
    SnapshotRequest,
    SnapshotResponse,
)

_log = logging.getLogger(__name__)

TOPIC_SERVICES = ("start", "stop", "pause", "resume")
"""Services that take names of topics. Each is called as its handler."""
OTHER_SERVICES: Mapping[str, type] = {
    "status": RecorderStatus,
    "snapshot": Snapshot,
    "mark": Mark,
}
"""The other services with their classes."""


def services_of(recorder: Recorder) -> Iterator[tuple[str, type, Callable[..., object]]]:
    """Return the services of a recorder: of each its name, its class and its handler."""
    services = _Services(recorder)
    for name in TOPIC_SERVICES:
        yield f"~{name}", RecordTopics, services.of_topics(getattr(services, name))
    for name, kind in OTHER_SERVICES.items():
        yield f"~{name}", kind, getattr(services, name)


@dataclass(frozen=True)
class _Services:
    """The handlers of the services of one recorder. Thread-safe."""

    recorder: Recorder

    def of_topics(
        self, work: Callable[[RecordTopicsRequest], None]
    ) -> Callable[[RecordTopicsRequest], RecordTopicsResponse]:
        """Return a handler that calls ``work`` and answers its error and the name of the run."""

        def handle(request: RecordTopicsRequest) -> RecordTopicsResponse:
            problem = _attempt(lambda: work(request))
            run = self.recorder.run
            return RecordTopicsResponse(success=not problem, message=problem, run=run)

        return handle

    def start(self, request: RecordTopicsRequest) -> None:
        labels = read_labels(request.labels)
        self.recorder.start(request.topics, name=request.name, labels=labels)

    def stop(self, request: RecordTopicsRequest) -> None:
        self.recorder.stop(request.topics)

    def pause(self, request: RecordTopicsRequest) -> None:
        self.recorder.pause(request.topics)

    def resume(self, request: RecordTopicsRequest) -> None:
        self.recorder.resume(request.topics)

    def status(self, request: RecorderStatusRequest) -> RecorderStatusResponse:
        """Answer RecorderStatus."""
        response = RecorderStatusResponse(success=True)

        def work() -> None:
            status = self.recorder.status()
            response.state, response.run, response.writer = status.state, status.run, status.writer
            response.topics = [_pack(report, status) for report in status.topics]
            response.held_bytes, response.bound_bytes = status.held_bytes, status.bound_bytes
            disk = status.on_disk
            response.spooled_messages, response.spooled_bytes = disk.messages, disk.nbytes
            response.behind_seconds = disk.behind_sec
            response.held_seconds = status.held_sec
            response.held_messages = status.held_messages

        response.message = _attempt(work)
        response.success = not response.message
        return response

    def snapshot(self, request: SnapshotRequest) -> SnapshotResponse:
        """Answer Snapshot."""
        response = SnapshotResponse()

        def work() -> None:
            response.run, response.messages = self.recorder.snapshot(
                name=request.name,
                labels=read_labels(request.labels),
                after=request.after,
                topics=request.topics,
            )

        response.message = _attempt(work)
        response.success = not response.message
        return response

    def mark(self, request: MarkRequest) -> MarkResponse:
        """Answer Mark."""
        response = MarkResponse()

        def work() -> None:
            if request.node_id:
                raise InvalidOption(
                    "a recorder marks events of its own robot: leave node_id out, or ask the "
                    "query_server"
                )
            labels, values = read_labels(request.labels), read_values(request.values)
            event = self.recorder.mark(request.name, labels=labels, values=values)
            pack_event(event, response)

        response.message = _attempt(work)
        response.success = not response.message
        return response


def read_labels(texts: Sequence[str]) -> Mapping[str, str]:
    """Read labels KEY=VALUE, each key once; raises InvalidOption or InvalidName."""
    return check_pairs("labels", map(read_label, texts))


def _attempt(work: Callable[[], None]) -> str:
    """Call ``work``; return the error as a text, '' = no error."""
    try:
        work()
    except CassandraRosError as exc:
        return str(exc)
    except Exception as exc:  # noqa: BLE001 - an error of the package must not end the node
        _log.exception("a service of the recorder failed")
        return f"internal error: {type(exc).__name__}: {exc}; the node's log has more"
    return ""


def _pack(report: TopicReport, status: RecordingStatus) -> RecordedTopic:
    return RecordedTopic(
        topic=report.topic,
        types=list(report.types),
        received=report.received,
        stored=report.stored,
        lost=report.lost,
        reasons=[f"{kind.value}: {count}" for kind, count in report.reasons.items()],
        left_out=report.left_out,
        paused=report.paused,
        bytes=report.bytes,
        rate=report.rate_hz,
        is_paused=report.topic in status.paused,
        subscribed=report.topic in status.subscribed,
    )
