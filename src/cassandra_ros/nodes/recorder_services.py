# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The services of the node recorder: they unpack a request, call Recorder and pack the answer."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import Any, Callable, Iterator, Mapping, Sequence

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
OTHER_SERVICES: Mapping[str, tuple[type, Callable[..., Any]]] = {
    "status": (RecorderStatus, RecorderStatusResponse),
    "snapshot": (Snapshot, SnapshotResponse),
    "mark": (Mark, MarkResponse),
}
"""The other services: class, and class of the response."""


def services_of(recorder: Recorder) -> Iterator[tuple[str, type, Callable[..., object]]]:
    """Return the services of a recorder: of each its name, its class and its handler."""
    services = _Services(recorder)
    for name in TOPIC_SERVICES:
        handler = partial(_answer, getattr(services, name), services.topics_response)
        yield f"~{name}", RecordTopics, handler
    for name, (kind, response_class) in OTHER_SERVICES.items():
        yield f"~{name}", kind, partial(_answer, getattr(services, name), response_class)


def _answer(
    handler: Callable[[Any], Any], response_class: Callable[..., Any], request: object
) -> Any:
    """Call a handler; answer ``success: false`` for every error in it."""
    try:
        return handler(request)
    except CassandraRosError as exc:
        return response_class(success=False, message=str(exc))
    except Exception as exc:  # noqa: BLE001 - an error of the package must not end the node
        _log.exception("a service of the recorder failed")
        reason = f"internal error: {type(exc).__name__}: {exc}; the node's log has more"
        return response_class(success=False, message=reason)


@dataclass(frozen=True)
class _Services:
    """The handlers of the services of one recorder. Thread-safe."""

    recorder: Recorder

    def topics_response(self, success: bool = True, message: str = "") -> RecordTopicsResponse:
        """Return an answer of RecordTopics, with the name of the run that is recorded now."""
        return RecordTopicsResponse(success=success, message=message, run=self.recorder.run)

    def start(self, request: RecordTopicsRequest) -> RecordTopicsResponse:
        """Answer RecordTopics for ~start."""
        labels = read_labels(request.labels)
        self.recorder.start(request.topics, name=request.name, labels=labels)
        return self.topics_response()

    def stop(self, request: RecordTopicsRequest) -> RecordTopicsResponse:
        """Answer RecordTopics for ~stop."""
        self.recorder.stop(request.topics)
        return self.topics_response()

    def pause(self, request: RecordTopicsRequest) -> RecordTopicsResponse:
        """Answer RecordTopics for ~pause."""
        self.recorder.pause(request.topics)
        return self.topics_response()

    def resume(self, request: RecordTopicsRequest) -> RecordTopicsResponse:
        """Answer RecordTopics for ~resume."""
        self.recorder.resume(request.topics)
        return self.topics_response()

    def status(self, request: RecorderStatusRequest) -> RecorderStatusResponse:
        """Answer RecorderStatus."""
        status = self.recorder.status()
        return RecorderStatusResponse(
            success=True,
            state=status.state,
            run=status.run,
            writer=status.writer,
            topics=[_pack(report, status) for report in status.topics],
            held_bytes=status.held_bytes,
            bound_bytes=status.bound_bytes,
            spooled_messages=status.on_disk.messages,
            spooled_bytes=status.on_disk.nbytes,
            behind_seconds=status.on_disk.behind_sec,
            held_seconds=status.held_sec,
            held_messages=status.held_messages,
        )

    def snapshot(self, request: SnapshotRequest) -> SnapshotResponse:
        """Answer Snapshot."""
        run, messages = self.recorder.snapshot(
            name=request.name,
            labels=read_labels(request.labels),
            after=request.after,
            topics=request.topics,
        )
        return SnapshotResponse(success=True, run=run, messages=messages)

    def mark(self, request: MarkRequest) -> MarkResponse:
        """Answer Mark."""
        if request.node_id:
            raise InvalidOption(
                "a recorder marks events of its own robot: leave node_id out, or ask the "
                "query_server"
            )
        labels, values = read_labels(request.labels), read_values(request.values)
        response = MarkResponse(success=True)
        pack_event(self.recorder.mark(request.name, labels=labels, values=values), response)
        return response


def read_labels(texts: Sequence[str]) -> Mapping[str, str]:
    """Read labels KEY=VALUE, each key once; raises InvalidOption or InvalidName."""
    return check_pairs("labels", map(read_label, texts))


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
