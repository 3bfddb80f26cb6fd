# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What recorder and replicator say on /diagnostics of the maximum size of the store."""

from __future__ import annotations

from typing import Mapping, NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus

from cassandra_ros.stores.copying.quota import QuotaReport


class QuotaEntry(NamedTuple):
    """Level, text and values of an entry."""

    level: bytes
    text: str
    values: Mapping[str, str]


def quota_entry(report: QuotaReport) -> QuotaEntry:
    """Return the entry: WARN if what no other store has takes nearly all of the maximum size."""
    level = DiagnosticStatus.WARN if report.nearly_full else DiagnosticStatus.OK
    text = f"{report.share:.0%} of the maximum size is not copied"
    values = {
        "bytes": str(report.bytes),
        "maximum bytes": str(report.max_bytes),
        "bytes not copied": str(report.uncopied_bytes),
    }
    return QuotaEntry(level, text, values)
