# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Copies what is new, again and again, also while the target is away now and then."""

from __future__ import annotations

import logging
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Callable, Sequence

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import (
    AccessDenied,
    CassandraRosError,
    ConnectionFailed,
    InvalidOption,
    StoreUnavailable,
    UnsupportedSchema,
)
from cassandra_ros.stores.copying.copy_status import TopicStatus, copy_status
from cassandra_ros.stores.copying.quota import Quota, QuotaReport
from cassandra_ros.stores.copying.replicator import CopyReport, Replicator

_log = logging.getLogger(__name__)

PASS_SEC = 4.0
"""Time after which a pass over the topics begins anew, s, so that small topics do not wait for the
rest of large ones."""
PERIOD_SEC = 5.0
"""Interval between two passes if all is copied, s."""
AWAY_SEC = (1.0, 2.0, 5.0, 10.0)
"""Pauses between attempts while a store does not answer, s; the last one is repeated."""
CONNECTING, COPYING, FOLLOWING, AWAY, PAUSED = (
    "connecting",
    "copying",
    "following",
    "away",
    "paused",
)
"""States: a store is connected; there is more to copy; all is copied, and what comes is; a store
does not answer; nothing is copied because a client asked for that."""

Open = Callable[[], RosCassandra]
"""Function that connects to a store."""
Make = Callable[[RosCassandra, RosCassandra], Replicator]
"""Function that makes the replicator of a source and a target."""


@dataclass(frozen=True)
class FollowerStatus:
    """State of a follower at one time."""

    state: str
    """CONNECTING, COPYING, FOLLOWING, AWAY or PAUSED."""
    place: str
    """Address and keyspace of the target; '' = not connected yet."""
    reason: str = ""
    """Why a store does not answer; '' = both do."""
    bytes_per_sec: float = 0.0
    """Bytes sent in a second: while there is more to copy a mean in which the last pass counts with
    a share of 0.3, else those of the last pass."""
    topics: Sequence[TopicStatus] = field(default_factory=tuple)
    """What the books say of each topic, for this target."""
    unused: Sequence[str] = field(default_factory=tuple)
    """Patterns of rules that matched no topic."""
    quota: QuotaReport | None = None
    """Use of the maximum size of the source; None = it has no maximum."""

    @property
    def waiting(self) -> int:
        """Number of messages that wait."""
        return sum(topic.waiting for topic in self.topics)

    @property
    def waiting_bytes(self) -> int:
        """Serialised bytes of the messages that wait."""
        return sum(topic.waiting_bytes for topic in self.topics)

    @property
    def left_sec(self) -> float | None:
        """Expected time until all is copied, s; None = unknown."""
        if not self.waiting_bytes:
            return 0.0
        return self.waiting_bytes / self.bytes_per_sec if self.bytes_per_sec else None


class Follower:
    """Copies on a thread of its own while its context is entered.

    Only this thread asks the stores. It replaces ``status`` as a whole, so any thread may read it.

    Args:
        open_source, open_target: Connect to the stores; called again after a connection failed.
        make: Makes the replicator of two connected stores.
        period_sec: Interval between two passes if all is copied, s.
        quota: Maximum size of the source; None = no maximum.
    """

    def __init__(
        self,
        open_source: Open,
        open_target: Open,
        make: Make,
        period_sec: float = PERIOD_SEC,
        *,
        quota: Quota | None = None,
    ) -> None:
        self._quota = quota
        self._open_source, self._open_target, self._make = open_source, open_target, make
        self._period_sec = period_sec
        self._stores: list[RosCassandra] = []
        """Source and target, as long as they are connected."""
        self._replicator: Replicator | None = None
        self._status = FollowerStatus(CONNECTING, "")
        self._paused, self._ending = threading.Event(), threading.Event()
        self._wake = threading.Event()
        """Ends the pause between two passes."""
        self._told: set[str] = set()
        """Warnings that were logged, each once."""
        self.problem = ""
        """Error that ended the copying, because a repetition cannot help; '' = there was none."""
        self._thread = threading.Thread(target=self._run, name="cassandra_ros-follow", daemon=True)

    def __enter__(self) -> Follower:
        self._thread.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._ending.set()
        self._pause_replicator(True)
        self._wake.set()
        for store in self._stores:
            store.cassandra.outage.hurry()
        self._thread.join()
        self._close()

    @property
    def status(self) -> FollowerStatus:
        """State after the last pass, or after the last failure."""
        return self._status

    @property
    def ended(self) -> bool:
        """Whether it has ended by itself; ``problem`` says why."""
        return bool(self.problem)

    def pause(self) -> None:
        """Copy nothing until ``resume``; what was begun is completed. It does not wait for that."""
        self._paused.set()
        self._pause_replicator(True)
        self._wake.set()

    def resume(self) -> None:
        """Go on after ``pause``."""
        self._paused.clear()
        self._pause_replicator(self._ending.is_set())
        self._wake.set()

    def _pause_replicator(self, paused: bool) -> None:
        """Let the pass that runs end soon, or not. Called by any thread."""
        replicator = self._replicator
        if replicator is not None:
            (replicator.paused.set if paused else replicator.paused.clear)()

    def _run(self) -> None:
        try:
            self._follow()
        except BaseException as exc:
            self.problem = f"internal error: {exc!r}"
            raise

    def _follow(self) -> None:
        """Copy pass after pass, until the end or an error that a repetition cannot help."""
        failures = 0
        while not self._ending.is_set():
            begun = time.monotonic()
            try:
                has_more = self._pass(begun)
                failures = 0
                pause = 0.0 if has_more else self._period_sec - (time.monotonic() - begun)
            except (AccessDenied, InvalidOption, UnsupportedSchema) as exc:
                self.problem = str(exc)
                return
            except CassandraRosError as exc:  # a topic may have been removed meanwhile, too
                if isinstance(exc, ConnectionFailed) and exc.refused:
                    self.problem = str(exc)
                    return
                pause = self._away(exc, failures)
                failures += 1
            self._rest(pause)

    def _rest(self, seconds: float) -> None:
        """Wait, at most until another thread sets _wake."""
        self._wake.wait(max(0.0, seconds))
        self._wake.clear()

    def _pass(self, begun: float) -> bool:
        """Copy for some seconds; return whether to go on at once.

        Args:
            begun: Monotonic time at which the pass began, s.
        """
        replicator = self._connect()
        if self._paused.is_set():
            self._note(PAUSED, replicator, None, 0.0)
            return False
        before = replicator.sent_bytes
        report = replicator.copy(max_sec=PASS_SEC)
        has_more = any(topic.left for topic in report.topics.values())
        rate = (replicator.sent_bytes - before) / max(0.001, time.monotonic() - begun)
        state = PAUSED if self._paused.is_set() else COPYING if has_more else FOLLOWING
        self._note(state, replicator, report, rate)
        return has_more and state == COPYING

    def _note(
        self, state: str, replicator: Replicator, report: CopyReport | None, rate: float
    ) -> None:
        """Keep the source under its maximum size, set the status, and log new warnings.

        Args:
            report: What was copied; None = nothing, in a pause.
            rate: Bytes that were sent in a second of this pass.
        """
        statuses = copy_status(self._stores[0].catalog)
        topics = [topic for topic in statuses if topic.target == replicator.place]
        unused = self._status.unused if report is None else report.unused
        mean = 0.7 * self._status.bytes_per_sec + 0.3 * rate if state == COPYING else rate
        quota = self._keep_under()
        self._status = FollowerStatus(state, replicator.place, "", mean, topics, unused, quota)
        for text in [
            *(f"no topic matches {pattern!r} yet" for pattern in unused),
            *(topic.refused for topic in topics if topic.refused),
        ]:
            if text not in self._told:
                self._told.add(text)
                _log.warning("%s", text)

    def _keep_under(self) -> QuotaReport | None:
        """Keep the source under its maximum size; None = it has none, or is not connected."""
        if self._quota is None or not self._stores:
            return None
        self._quota.keep(self._stores[0].catalog)
        return self._quota.report

    def _connect(self) -> Replicator:
        """Return the replicator; connect to both stores and make it if necessary."""
        if self._replicator is None:
            self._close()  # an earlier attempt may have connected only the source
            for open_store in (self._open_source, self._open_target):
                self._stores.append(open_store())
            self._replicator = self._make(*self._stores)
            self._status = replace(self._status, place=self._replicator.place)
            _log.info("copying to %s", self._replicator.place)
        return self._replicator

    def _away(self, exc: CassandraRosError, failures: int) -> float:
        """Note that a store does not answer; return the pause until the next attempt, s.

        Args:
            failures: Number of failures directly before this one.
        """
        last = self._status
        if last.state != AWAY:
            _log.warning("copying goes on when both stores answer: %s", exc)
        quota = last.quota
        with suppress(CassandraRosError):  # the source may be the one that does not answer
            quota = self._keep_under()
        self._status = FollowerStatus(
            AWAY, last.place, str(exc), 0.0, last.topics, last.unused, quota
        )
        # Connections recover from a silent store by themselves; after other errors make new ones.
        if not isinstance(exc, StoreUnavailable):
            self._close()
        return AWAY_SEC[min(failures, len(AWAY_SEC) - 1)]

    def _close(self) -> None:
        """Close the stores; a new replicator is made when they are connected again."""
        self._replicator = None
        while self._stores:
            with suppress(CassandraRosError):
                self._stores.pop().close()
