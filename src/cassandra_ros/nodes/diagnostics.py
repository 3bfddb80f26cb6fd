# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The status of a recorder on /diagnostics: entries for the store and for each topic."""

from __future__ import annotations

from typing import Mapping, NamedTuple, Sequence

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from cassandra_ros.recording.recording_status import WAITING, Rates, RecordingStatus
from cassandra_ros.recording.topic_counts import TopicReport
from cassandra_ros.stores.copying.quota import QuotaReport

FULL = 0.5
"""Share of the buffer in use above which the level is WARN."""


class KeyspaceAddress(NamedTuple):
    """The address of a store, as in the options: the store may not answer yet."""

    hosts: Sequence[str]
    keyspace: str


class StatusPublisher:
    """A publisher of the entries of a node on /diagnostics.

    Args:
        hosts: Hosts of the store that the entries are about; '' = none are named.
    """

    def __init__(self, hosts: str = "") -> None:
        self._hosts = hosts
        self._name = rospy.get_name().lstrip("/")
        self._publisher = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=1)

    def send(self, stamp: rospy.Time, entries: list[DiagnosticStatus]) -> None:
        """Publish entries with a time."""
        array = DiagnosticArray()
        array.header.stamp = stamp
        array.status = entries
        self._publisher.publish(array)

    def entry(
        self, level: bytes, what: str, text: str, values: Mapping[str, str]
    ) -> DiagnosticStatus:
        """Return the entry of a part of the node."""
        pairs = [KeyValue(key, value) for key, value in values.items()]
        return DiagnosticStatus(level, f"{self._name}: {what}", text, self._hosts, pairs)

    def quota_entries(self, report: QuotaReport | None) -> list[DiagnosticStatus]:
        """Return the entry of the maximum size of a store; [] = it has none.

        It is WARN if what no other store has takes nearly all of the maximum size.
        """
        if report is None:
            return []
        level = DiagnosticStatus.WARN if report.nearly_full else DiagnosticStatus.OK
        text = f"{report.share:.0%} of the maximum size is not copied"
        values = {
            "bytes": str(report.bytes),
            "maximum bytes": str(report.max_bytes),
            "bytes not copied": str(report.uncopied_bytes),
        }
        return [self.entry(level, "maximum size", text, values)]


class Diagnostics(StatusPublisher):
    """A publisher of the status. Losses have level ERROR while they go on, then WARN.

    Args:
        place: Address of the store.
    """

    def __init__(self, place: KeyspaceAddress) -> None:
        super().__init__(",".join(place.hosts))
        self._keyspace = place.keyspace
        self._lost_before: dict[str, int] = {}
        """Number of lost messages by topic at the last call of ``publish``."""

    def publish(self, status: RecordingStatus, rates: Rates) -> None:
        """Publish a status."""
        entries = [self._of_store(status, rates), *self.quota_entries(status.quota)]
        entries += [self._of_topic(report, status, rates) for report in status.topics]
        self._lost_before = {report.topic: report.lost for report in status.topics}
        self.send(rospy.Time.now(), entries)

    def _of_store(self, status: RecordingStatus, rates: Rates) -> DiagnosticStatus:
        """Return the entry of the store; of several reasons the last one below is shown."""
        fill = status.held_bytes / status.bound_bytes if status.bound_bytes else 0.0
        level, text = DiagnosticStatus.OK, status.state
        if status.run:
            text += f" run {status.run}"
        if status.state == WAITING:
            level = DiagnosticStatus.WARN
            text = f"the store does not answer yet, run {status.run} waits in memory"
        if status.held_up:
            level = DiagnosticStatus.WARN
            text = f"the store does not answer, messages of run {status.run} wait"
        if status.on_disk.messages:
            behind = status.on_disk.behind_sec
            level, text = DiagnosticStatus.WARN, f"the store is {behind:.0f} s behind"
        if fill > FULL and status.run:
            level, text = DiagnosticStatus.WARN, f"the buffer is {fill:.0%} full"
        lost = {report.topic: report.lost for report in status.topics}
        if any(count > self._lost_before.get(topic, 0) for topic, count in lost.items()):
            level, text = DiagnosticStatus.ERROR, "messages are being lost"
        hertz, nbytes = rates.total
        values = {
            "hosts": self._hosts,
            "keyspace": self._keyspace,
            "state": status.state,
            "run": status.run,
            "waiting bytes": str(status.held_bytes),
            "buffer bytes": str(status.bound_bytes),
            "spooled messages": str(status.on_disk.messages),
            "spooled bytes": str(status.on_disk.nbytes),
            "behind s": f"{status.on_disk.behind_sec:.0f}",
            "messages/s": f"{hertz:.1f}",
            "bytes/s": f"{nbytes:.0f}",
            "stored": str(sum(report.stored for report in status.topics)),
            "lost": str(sum(lost.values())),
        }
        return self.entry(level, "store", text, values)

    def _of_topic(
        self, report: TopicReport, status: RecordingStatus, rates: Rates
    ) -> DiagnosticStatus:
        hertz, nbytes = rates.of.get(report.topic, (0.0, 0.0))
        level, text = DiagnosticStatus.OK, "recording"
        if report.topic in status.paused:
            text = "paused"
        elif report.topic not in status.subscribed:
            text = "not recorded any more"
        elif not report.published:
            level, text = DiagnosticStatus.WARN, "it has no publisher"
        if report.lost > self._lost_before.get(report.topic, 0):
            level, text = DiagnosticStatus.ERROR, "messages are being lost"
        elif report.lost:
            level, text = DiagnosticStatus.WARN, "messages were lost"
        values = {
            "type": ", ".join(report.types),
            "received": str(report.received),
            "stored": str(report.stored),
            "lost": str(report.lost),
            "left out": str(report.left_out),
            "paused": str(report.paused),
            "messages/s": f"{hertz:.1f}",
            "bytes/s": f"{nbytes:.0f}",
        }
        values.update({f"lost, {kind.value}": str(n) for kind, n in report.reasons.items()})
        return self.entry(level, report.topic, text, values)
