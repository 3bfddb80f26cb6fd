# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Output of the recorder: a status line, the table at the end, the plan of --dry-run."""

from __future__ import annotations

import contextlib
import shutil
from typing import TYPE_CHECKING, Sequence, TextIO

from cassandra_ros.cli.terminal_text import counted, format_bytes, format_table, format_time
from cassandra_ros.printable import shown, shown_lines

if TYPE_CHECKING:
    from cassandra_ros.recording.dry_run import PlannedTopic
    from cassandra_ros.recording.losses import LossTotal
    from cassandra_ros.recording.recorder_options import RecorderOptions
    from cassandra_ros.recording.recording_status import Rates, RecordingStatus
    from cassandra_ros.recording.topic_counts import TopicReport
    from cassandra_ros.store.tables.registry import LossKind

_CLEAR = "\r\033[K"


class RecorderStatusLine:
    """A line at the bottom of the terminal with the state of the recording, and lines above it.

    A terminal that is gone, or a pipe whose reader has ended, does not end the recording.

    Args:
        terminal: The terminal, which is standard output; None = show no line.
    """

    def __init__(self, terminal: TextIO | None) -> None:
        self._terminal = terminal
        self._is_shown = False
        """Whether the line is on the terminal now, so that it must be cleared before another."""

    @property
    def shows(self) -> bool:
        """Whether there is a terminal."""
        return self._terminal is not None

    def say(self, text: str, quiet: bool) -> None:
        """Print a text in place of the status line, which comes below it again with ``show``."""
        if not quiet:
            with contextlib.suppress(OSError, ValueError):  # the terminal is gone
                print((_CLEAR if self._is_shown else "") + shown_lines(text), flush=True)
        self._is_shown = False

    def show(self, status: RecordingStatus, rates: Rates) -> None:
        """Update the line."""
        if self._terminal is not None:
            width = shutil.get_terminal_size().columns - 1
            with contextlib.suppress(OSError, ValueError):
                self._terminal.write(_CLEAR + status_text(status, rates)[:width])
                self._terminal.flush()
            self._is_shown = True


def status_text(status: RecordingStatus, rates: Rates) -> str:
    """Return the state of the recording as one line."""
    hertz, nbytes = rates.total
    topics = status.topics
    stored = f"{sum(report.stored for report in topics)} stored"
    if status.held_messages:  # of a snapshot: nothing is stored before it is asked for
        stored = f"{status.held_messages} kept of {status.held_sec:.0f} s"
    parts = [
        f"{status.state} {shown(status.run)}".rstrip(),
        counted(len(status.subscribed), "topic"),
        f"{hertz:.0f} msg/s",
        f"{format_bytes(int(nbytes))}/s",
        stored,
        f"{sum(report.lost for report in topics)} lost",
    ]
    parts.append(f"{format_bytes(status.held_bytes)} in memory")
    if status.on_disk.messages:
        disk = status.on_disk
        parts.append(f"{disk.messages} in the spool, {disk.behind_sec:.0f} s behind")
    if status.paused:
        parts.append(f"{len(status.paused)} paused")
    return ", ".join(parts)


def failures(reports: Sequence[TopicReport]) -> list[str]:
    """Return a sentence for each reason why something was not recorded or is not stored yet."""
    lost = sum(report.lost for report in reports)
    reasons = [f"{counted(lost, 'message')} {'was' if lost == 1 else 'were'} lost"] if lost else []
    for report in reports:
        if report.unheard_sec:
            reasons.append(
                f"for {report.unheard_sec:.0f} s publishers of {shown(report.topic)} were not "
                "heard, because the ROS master was started anew or a connection was broken"
            )
        if not report.published:
            reasons.append(f"no message came on {shown(report.topic)}: it had no publisher")
    if not reports:
        reasons.append("nothing was recorded: no topic that was asked for had a publisher")
    return reasons


def closing_table(reports: Sequence[TopicReport], *, rates: bool = True) -> str:
    """Return a table with the numbers of received, stored and lost messages by topic.

    Gaps in the sequence numbers of the publishers are not losses of the recorder; they have a
    column of their own, "seq gaps". A column without any number ("left out", "paused", "spooled")
    is left out. A line below the table gives each reason of a loss.

    Args:
        reports: The topics.
        rates: Whether to show rates; a snapshot, which is written at once, has none.
    """
    names = ["topic", "type", "received", "stored", "lost", "seq gaps", "bytes", "rate"]
    optional = [
        (name, [getattr(report, name.replace(" ", "_")) for report in reports])
        for name in ("left out", "paused", "spooled")
    ]
    extra = [(name, counts) for name, counts in optional if any(counts)]
    names[5:5] = [name for name, _ in extra]  # after "lost", as in the rows and the totals
    rows: list[Sequence[str]] = [
        (
            shown(r.topic),
            shown(", ".join(r.types)),
            *map(str, (r.received, r.stored, r.lost)),
            *(str(counts[number]) for _, counts in extra),
            "-" if r.gaps is None else str(r.gaps),
            format_bytes(r.bytes),
            f"{r.rate_hz:.1f} Hz" if rates else "-",
        )
        for number, r in enumerate(reports)
    ]
    sums = [[getattr(r, name) for r in reports] for name in ("received", "stored", "lost")]
    sums += [counts for _, counts in extra]
    sums.append([r.gaps or 0 for r in reports])
    totals = [str(sum(column)) for column in sums]
    rows.append(("total", "", *totals, format_bytes(sum(r.bytes for r in reports)), ""))
    lines = [format_table(names, rows, right=names[2:])]
    for report in reports:
        for kind, total in report.losses.items():
            lines.append(f"{shown(report.topic)}: {_loss_text(kind, total)}")
    return "\n".join(lines)


def _loss_text(kind: LossKind, total: LossTotal) -> str:
    """Return how many messages were lost for one reason, and their time range, in words."""
    why = ": ".join(filter(None, (kind.value, total.detail)))
    if total.varied:
        why += ", and other causes"
    times = [format_time(ns) for ns in sorted({total.first_ns, total.last_ns}) if ns]
    text = f"{total.count or 'some'} lost: {shown(why, None)}"
    return "; ".join(filter(None, (text, " to ".join(times))))


def plan_table(plan: Sequence[PlannedTopic], options: RecorderOptions) -> str:
    """Return a table of the topics that would be recorded, with their settings."""
    names = ("topic", "type", "format", "ttl", "table", "settings")
    rows = [
        (
            shown(topic_plan.topic),
            shown(topic_plan.msg_type or "?"),
            topic_plan.format,
            f"{topic_plan.ttl} s" if topic_plan.ttl else "never",
            "there" if topic_plan.stored else "new",
            shown("; ".join(topic_plan.settings)) or "-",
        )
        for topic_plan in plan
    ]
    lines = [f"run {shown(options.run_name(0))}"]
    lines += [f"label {shown(key)}={shown(value)}" for key, value in options.labels.items()]
    lines.append(format_table(names, rows) if rows else "no topic would be recorded now")
    for topic_plan in plan:
        lines += [
            f"{shown(topic_plan.topic)} {shown(text, None)}" for text in topic_plan.differences
        ]
    return "\n".join(lines)
