# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Plays a stream at its pace: one thread hands out messages, others steer it."""

from __future__ import annotations

import logging
import threading
import time
from typing import Callable, Iterator, List, Optional, Protocol, Sequence

from cassandra_ros.errors import (
    ConnectionFailed,
    CorruptMessage,
    InvalidOption,
    MessageNotFound,
    StoreUnavailable,
)
from cassandra_ros.messages.stamps import iso_time
from cassandra_ros.playing.pace import Pace
from cassandra_ros.playing.play_options import PlayerOptions
from cassandra_ros.playing.read_ahead import GIVE_UP_SEC, RETRY_SEC, ReadAhead, Skipped
from cassandra_ros.playing.stream import Played
from cassandra_ros.read import TimeRange

_log = logging.getLogger(__name__)

STALL_SEC = 0.2
"""How long what is read ahead may be empty until the clock of the replay stands."""
SAY_SEC = 2.0
"""And until that is said."""
WAKE_SEC = 0.5
COMMAND_SEC = 10.0
"""How long a command waits for being carried out."""

PAUSED, DELAYED, STALLED, ENDED, AT_ONCE = "paused", "delayed", "stalled", "ended", "at once"


class PlayedStream(Protocol):
    """What is played: a Stream."""

    start_ns: int
    end_ns: int

    def latched(self, t: int) -> Sequence[Played]:
        """List what is published first where playing begins at a time."""

    def messages(self, t: Optional[int] = None) -> Iterator[Played]:
        """Walk through the messages from a time on."""


class Output(Protocol):
    """Where the messages go. Called on the thread that plays."""

    def begin(self, t: int) -> None:
        """Forget what was latched: playing begins at a time, or begins again there."""

    def clock(self, t: int) -> None:
        """Say the time, for the message that follows was not waited for."""

    def publish(self, played: Played) -> None:
        """Publish a message."""


class Playback:
    """One replay. ``run`` plays it; everything else may be called from other threads.

    Args:
        stream: What is played.
        output: Where it goes.
        options: How.
        lags: Says of a time of the replay whether who consumes it lags behind, so that it waits.
        skipped: Called with a message that cannot be read, and why; on another thread.
    """

    def __init__(
        self,
        stream: PlayedStream,
        output: Output,
        options: PlayerOptions,
        lags: Callable[[int], bool],
        skipped: Skipped,
    ) -> None:
        self._stream, self._output, self._options = stream, output, options
        self._lags, self._skipped = lags, skipped
        self.pace = Pace(stream.start_ns, options.rate)
        if options.immediate:
            self.pace.hold(AT_ONCE)
        if options.paused:
            self.pace.hold(PAUSED)
        self._pauses_for_topics = bool(options.pause_topics)
        """Whether it pauses before messages of the topics that are given for that."""
        self._changed = threading.Condition()
        self._steps = 0
        self._goto: Optional[int] = stream.start_ns
        self._stopped = False
        self._finished = False
        self._at_end = False  # kept alive
        self._reader: Optional[ReadAhead] = None
        self._early: Optional[ReadAhead] = None
        self._window: Optional[TimeRange] = None
        self._horizon = stream.start_ns
        self._known = False
        self._again = False
        self._skip_ns = None if options.skip_empty is None else int(options.skip_empty * 1e9)

    # ---------------------------------------------------------------- what steers

    def now(self) -> int:
        """Return the time of the replay, ns: that of the next message where that is late."""
        return min(self.pace.now(), self._horizon)

    def clock_time(self) -> Optional[int]:
        """Return ``now``; None until the first message says when the replay begins."""
        return self.now() if self._known else None

    @property
    def state(self) -> str:
        """What it does: 'waiting', 'running', 'paused', 'delayed' or 'ended'."""
        if self._finished or self._at_end:
            return ENDED
        if self.pace.holds(PAUSED):
            return PAUSED
        if self.pace.holds(DELAYED) or self.pace.holds(STALLED):
            return DELAYED
        return "waiting" if self.pace.holds(Pace.BEGIN) else "running"

    @property
    def read_ahead_bytes(self) -> int:
        """How many bytes are read and not yet played."""
        return 0 if self._reader is None else self._reader.held_bytes

    def pause(self) -> bool:
        """Stand still; return whether it did not before."""
        return self._set(PAUSED, True)

    def resume(self) -> bool:
        """Go on; return whether it stood."""
        return self._set(PAUSED, False)

    def toggle_pause_topics(self) -> bool:
        """Pause before messages of the pause topics, or do no more; return whether it does."""
        self._pauses_for_topics = not self._pauses_for_topics
        return self._pauses_for_topics

    def set_rate(self, rate: float) -> None:
        """Go on faster or slower; InvalidOption: it is no rate."""
        with self._changed:
            self.pace.jump(self.now())  # what is late is not hurried after
            self.pace.set_rate(rate)
            self._changed.notify_all()

    def step(self, count: int) -> None:
        """Publish the next messages while it is paused, and wait until they are.

        Raises:
            InvalidOption: It is not paused, or so many messages do not follow.
        """
        with self._changed:
            if not self.pace.holds(PAUSED) or self._finished:
                raise InvalidOption(f"only what is paused can be stepped; it is {self.state}")
            self._steps += count
            self._changed.notify_all()
            self._changed.wait_for(self._has_stepped, COMMAND_SEC)
            left, self._steps = self._steps, 0
        if left:
            raise InvalidOption(
                f"{count - left} of {count} messages were published: no other follows"
            )

    def seek(self, t: int) -> int:
        """Go on at another time, ns; return it, or the start or end where it lies outside."""
        t = max(self._stream.start_ns, min(t, self._stream.end_ns))
        with self._changed:
            if self._finished:
                raise InvalidOption("the replay has ended: keep_alive keeps it for going on")
            self._goto, self._steps = t, 0
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._goto != t or self._finished, COMMAND_SEC)
        return t

    def stop(self) -> None:
        """Let ``run`` return behind the message that is being published."""
        with self._changed:
            self._stopped = True
            if self._early is not None:
                self._early.close()
            self._changed.notify_all()

    def wake(self) -> None:
        """Look again whether the consumer lags behind."""
        with self._changed:
            self._changed.notify_all()

    def _set(self, hold: str, on: bool) -> bool:
        with self._changed:
            changed = self.pace.holds(hold) != on
            self.pace.jump(self.now())
            (self.pace.hold if on else self.pace.release)(hold)
            self._changed.notify_all()
        return changed

    def _has_stepped(self) -> bool:
        return not self._steps or self._finished or self._at_end

    # ---------------------------------------------------------------- what plays

    def prepare(self) -> None:
        """Begin to read, for a ``run`` that follows: it need not wait for the store then."""
        self._reader = self._early = self._read(self._stream.start_ns)

    def run(self) -> None:
        """Play until the end, or until it is stopped.

        Raises:
            MessageNotFound: There is nothing to play.
            CassandraRosError: The store does not give what is to be played.
        """
        try:
            while True:
                begun = time.monotonic()
                if not self._pass() or not self._goes_on():
                    return
                if time.monotonic() < begun + 0.01:
                    time.sleep(0.01)  # a loop of a single message
        finally:
            with self._changed:
                self._finished = True
                self._changed.notify_all()

    def _pass(self) -> bool:
        """Play from the time that is asked for until the end, a seek or a stop; False: stopped."""
        with self._changed:
            t = self._stream.start_ns if self._goto is None else self._goto
            self._at_end = False
            self.pace.hold(Pace.BEGIN)  # until the first message is there
            self.pace.jump(t)
            self._horizon = t
            self._known = t != self._stream.start_ns
            early, self._early = self._early, None
            if early is not None and t != self._stream.start_ns:
                early.close()
                early = None
            reader = early or self._read(t)
            again, self._again = self._again, True
            self._reader, self._window = reader, None
        try:
            first = self._latched(t)
            if again:
                self._output.clock(t)  # before what is latched: who sees time go back forgets
            self._output.begin(t)
            for played in first:
                self._output.publish(played)
            with self._changed:
                if self._goto == t:
                    self._goto = None
                    self._changed.notify_all()
            found = self._play(reader, t == self._stream.start_ns)
            if not (found or first or self._is_broken()) and t == self._stream.start_ns:
                raise MessageNotFound(
                    "there is nothing to play: no message that is asked for was received from "
                    f"{iso_time(t)} to {iso_time(self._stream.end_ns)}"
                )
            return not self._stopped
        finally:
            reader.close()

    def _latched(self, t: int) -> List[Played]:
        """Read what is published first; as who reads ahead, wait for a store that is away."""
        ends = time.monotonic() + GIVE_UP_SEC
        while True:
            try:
                return [each for each in self._stream.latched(t) if self._is_readable(each)]
            except (StoreUnavailable, ConnectionFailed) as exc:
                if time.monotonic() >= ends:
                    raise
                _log.warning("the store does not answer, the replay waits for it: %s", exc)
            with self._changed:
                if not self._stopped and self._goto in (None, t):
                    self._changed.wait(RETRY_SEC)
                if self._stopped or self._goto not in (None, t):
                    return []

    def _is_readable(self, played: Played) -> bool:
        try:
            played.row.keep_wire()
        except (CorruptMessage, MessageNotFound) as exc:
            self._skipped(played, exc)
            return False
        return True

    def _read(self, t: int) -> ReadAhead:
        budget = self._options.read_ahead
        return ReadAhead(self._stream.messages, t, budget, self._changed, self._skipped)

    def _play(self, reader: ReadAhead, fresh: bool) -> bool:
        """Play what a reader gives; return whether there was any."""
        found = False
        while True:
            played = self._next(reader)
            if played is None:
                return found
            if fresh and not found:
                self._jump(played.t)  # as rosbag: time begins with the first message
            found, self._horizon = True, played.t
            self._known = True
            if not self._await(played):
                return True
            self._window = played.window
            self._output.publish(played)
            if self._steps:
                self._count_step()

    def _count_step(self) -> None:
        with self._changed:
            if self._steps and self.pace.holds(PAUSED):
                self._steps -= 1
                self._changed.notify_all()

    def _goes_on(self) -> bool:
        """Say, at the end of a pass, whether there is another; wait for one that is asked for."""
        with self._changed:
            if self._goto is not None or self._stopped:
                return not self._stopped
            if self._options.loop:
                self._changed.notify_all()
                return True
            if not self._options.keep_alive:
                return False
            self.pace.jump(self.now())
            self._horizon = 2**63
            self._known = True
            self._at_end = True  # time goes on, as with rosbag: others may live by it
            self._changed.notify_all()
            self._changed.wait_for(self._is_broken)
            return not self._stopped

    def _is_broken(self) -> bool:
        """Say whether something else than the next message is asked for."""
        return self._stopped or self._goto is not None

    def _next(self, reader: ReadAhead) -> Optional[Played]:
        """Return the next message, None at the end, or when something else is asked for."""
        since = time.monotonic()
        said = False
        with self._changed:
            while not self._is_broken() and not reader.await_next(STALL_SEC):
                waited = time.monotonic() - since
                if waited >= STALL_SEC:
                    self.pace.hold(STALLED)
                if waited >= SAY_SEC and not said:
                    said = True
                    _log.warning(
                        "the store has given no message for %.0f s: the replay stands",
                        SAY_SEC,
                    )
            if said:
                _log.warning("the replay stood for %.1f s", time.monotonic() - since)
            self.pace.release(STALLED)
            if self._is_broken():
                return None
            self.pace.release(Pace.BEGIN)
            return reader.take()

    def _await(self, played: Played) -> bool:
        """Wait until a message may go out; False: something else is asked for."""
        due, pauses = False, self._pauses(played)
        with self._changed:
            while not self._is_broken():
                if self.pace.holds(PAUSED):
                    if self._steps:
                        self._jump(played.t)
                        return True
                    self._changed.wait(WAKE_SEC)
                elif not due:
                    due = self._await_time(played)
                elif pauses and self._pauses_for_topics:
                    pauses = False
                    self.pace.hold(PAUSED)
                elif self._lags(played.t):
                    self.pace.hold(DELAYED)
                    self._changed.wait(WAKE_SEC)
                else:
                    self.pace.release(DELAYED)
                    return True
            self.pace.release(DELAYED)
        return False

    def _await_time(self, played: Played) -> bool:
        """Wait until it is a message's time, or until something changes; say whether it is."""
        t, window, now = played.t, played.window, self.pace.now()
        if self._options.immediate:
            self._jump(t)
            return True
        gap = self._window is not None and self._window.low != window.low
        if gap and now < window.low:
            self._jump(window.low)
        elif self._skip_ns is not None and t - now > self._skip_ns:
            self._jump(t)
            return True
        left = self.pace.due_in(t)
        if left is not None and left <= 0:
            return True
        self._changed.wait(WAKE_SEC if left is None else min(left, WAKE_SEC))
        return False

    def _jump(self, t: int) -> None:
        self.pace.jump(t)
        self._output.clock(t)

    def _pauses(self, played: Played) -> bool:
        topics = self._options.pause_topics
        return bool(topics) and (played.topic in topics or played.row.topic in topics)
