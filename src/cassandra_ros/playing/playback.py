# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Playing of a stream at its pace: one thread publishes messages, other threads control it."""

from __future__ import annotations

import logging
import threading
import time
from typing import Callable, Protocol

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
from cassandra_ros.playing.play_stream import PlayedMessage, PlayStream
from cassandra_ros.playing.read_ahead import GIVE_UP_SEC, RETRY_SEC, OnSkip, ReadAhead, keep_row
from cassandra_ros.read import TimeRange

_log = logging.getLogger(__name__)

STALL_SEC = 0.2
"""Time without a message from the store after which the clock of the replay is stopped, s."""
SAY_SEC = 2.0
"""Time without a message from the store after which a warning is logged, s."""
WAKE_SEC = 0.5
"""Maximum time between two checks of whether a message is due, s."""
COMMAND_SEC = 10.0
"""Maximum time that a command waits until it is carried out, s."""

PAUSED, DELAYED, STALLED, ENDED, AT_ONCE = "paused", "delayed", "stalled", "ended", "at once"
"""Reasons for which the clock of the replay stands, and states of the replay.

PAUSED: by a command, or before a message of a pause topic. DELAYED: the consumer is too far behind.
STALLED: the store gives no message; the state is then DELAYED. AT_ONCE: the time only jumps from
message to message; no state. ENDED: all was played; no reason.
"""


class PlayOutput(Protocol):
    """The receiver of the messages. Its methods are called on the thread that plays.

    ``clock`` may be called under the lock of the replay: it must not wait for a thread that needs
    that lock.
    """

    def begin(self, t: int) -> None:
        """Forget latched messages: playing begins at ``t``, ns, or jumps there."""

    def clock(self, t: int) -> None:
        """Publish the time, ns: the clock jumps to that of the next message."""

    def publish(self, played: PlayedMessage) -> None:
        """Publish a message."""


class Playback:
    """One replay. ``run`` plays it; all other methods may be called from other threads.

    Args:
        stream: The stream that is played.
        output: The receiver of the messages.
        options: Options of the replay.
        lags: Returns whether the consumer is too far behind a time of the replay, ns; the replay
            then waits. It is called under the lock of the replay. When the answer may have changed,
            call ``wake``.
        skipped: Called with each message that cannot be read, and the error: on the reading thread,
            for latched messages on the one that plays.
    """

    def __init__(
        self,
        stream: PlayStream,
        output: PlayOutput,
        options: PlayerOptions,
        lags: Callable[[int], bool],
        skipped: OnSkip,
    ) -> None:
        self._stream, self._output, self._options = stream, output, options
        self._lags, self._skipped = lags, skipped
        self.pace = Pace(stream.start_ns, options.rate)
        if options.immediate:
            self.pace.hold(AT_ONCE)
        if options.paused:
            self.pace.hold(PAUSED)
        self._pauses_for_topics = bool(options.pause_topics)
        """Whether the replay pauses before messages of the option pause_topics."""
        self._changed = threading.Condition()
        """Its lock guards the commands and the queue of the reader; it is notified when a command
        comes, or has been carried out, and when an awaited message was read."""
        self._steps = 0
        """Number of messages that a paused replay is still to publish."""
        self._goto: int | None = stream.start_ns
        """Time at which to go on, ns; None = no seek is requested."""
        self._stopped = False
        """Whether a stop was requested."""
        self._finished = False
        """Whether ``run`` has ended."""
        self._at_end = False
        """Whether all was played, and the replay is kept alive."""
        self._reader: ReadAhead | None = None
        self._prepared: ReadAhead | None = None
        """Reader that ``prepare`` has made and no pass has used yet."""
        self._window: TimeRange | None = None
        """Window of the message that was published last; None = none since the start or the seek.
        """
        self._horizon = stream.start_ns
        """Time of the next message, ns: that of the replay does not pass it."""
        self._is_time_known = False
        """Whether the replay has a time: at the start only the first message gives it."""
        self._has_begun = False
        """Whether a pass has begun before."""
        self._skip_ns = None if options.skip_empty is None else int(options.skip_empty * 1e9)

    def now(self) -> int:
        """Return the time of the replay, ns; at most that of the next message, if that is late."""
        return min(self.pace.now(), self._horizon)

    def clock_time(self) -> int | None:
        """Return ``now``; None until the first message has given the start of the replay."""
        return self.now() if self._is_time_known else None

    @property
    def state(self) -> str:
        """State of the replay: 'waiting', 'running', 'paused', 'delayed' or 'ended'."""
        if self._finished or self._at_end:
            return ENDED
        if self.pace.holds(PAUSED):
            return PAUSED
        if self.pace.holds(DELAYED) or self.pace.holds(STALLED):
            return DELAYED
        return "waiting" if self.pace.holds(Pace.BEGIN) else "running"

    @property
    def read_ahead_bytes(self) -> int:
        """Size of the messages that are read and not yet played, bytes."""
        return 0 if self._reader is None else self._reader.held_bytes

    def pause(self) -> bool:
        """Pause; return whether it was not paused before."""
        return self._set(PAUSED, True)

    def resume(self) -> bool:
        """End the pause; return whether it was paused."""
        return self._set(PAUSED, False)

    def toggle_pause_topics(self) -> bool:
        """Pause before messages of the pause topics, or do no more; return whether it does."""
        self._pauses_for_topics = not self._pauses_for_topics
        return self._pauses_for_topics

    def set_rate(self, rate: float) -> None:
        """Change the factor of speed, or raise InvalidOption."""
        with self._changed:
            self.pace.jump(self.now())  # a replay that is late does not catch up
            self.pace.set_rate(rate)
            self._changed.notify_all()

    def step(self, count: int) -> None:
        """Publish the next ``count`` messages of a paused replay, and wait until that is done.

        Raises:
            InvalidOption: The replay is not paused, or fewer messages follow.
        """
        with self._changed:
            if not self.pace.holds(PAUSED) or self._finished:
                raise InvalidOption(f"only a paused replay can be stepped; it is {self.state}")
            self._steps += count
            self._changed.notify_all()
            self._changed.wait_for(self._has_stepped, COMMAND_SEC)
            missing, self._steps = self._steps, 0
            ended = self._finished or self._at_end
        if missing:
            why = "then the replay ended" if ended else f"no more within {COMMAND_SEC:g} s"
            raise InvalidOption(f"{count - missing} of {count} messages were published: {why}")

    def seek(self, t: int) -> int:
        """Go on at the time ``t``, ns; return it, moved to the start or end if it lies outside.

        Raises:
            InvalidOption: The replay has ended, or is not there after COMMAND_SEC; then it still
                goes there as soon as it can.
        """
        t = max(self._stream.start_ns, min(t, self._stream.end_ns))
        with self._changed:
            if self._finished:
                raise InvalidOption("the replay has ended: keep_alive keeps it for going on")
            self._goto, self._steps = t, 0
            self._changed.notify_all()
            self._changed.wait_for(lambda: self._goto != t or self._finished, COMMAND_SEC)
            waits, ended = self._goto == t, self._finished
        if waits:
            raise InvalidOption(
                "the replay has ended before it could go there"
                if ended
                else f"the replay is not there after {COMMAND_SEC:g} s; it goes there when the "
                "store, or what it waits for, answers"
            )
        return t

    def stop(self) -> None:
        """Let ``run`` return after the message that is being published."""
        with self._changed:
            self._stopped = True
            if self._prepared is not None:
                self._prepared.close()
            self._changed.notify_all()

    def wake(self) -> None:
        """Check again whether the consumer is too far behind."""
        with self._changed:
            self._changed.notify_all()

    def _set(self, hold: str, on: bool) -> bool:
        """Hold or release the clock for a reason; return whether that changed something."""
        with self._changed:
            changed = self.pace.holds(hold) != on
            self.pace.jump(self.now())  # a replay that is late does not catch up
            (self.pace.hold if on else self.pace.release)(hold)
            self._changed.notify_all()
        return changed

    def _has_stepped(self) -> bool:
        """Return whether no step is left, or will be published any more."""
        return not self._steps or self._finished or self._at_end

    def prepare(self) -> None:
        """Begin to read before ``run`` is called, so that it need not wait for the store."""
        self._reader = self._prepared = self._read(self._stream.start_ns)

    def run(self) -> None:
        """Play until the end, or until it is stopped.

        Raises:
            MessageNotFound: The stream has no message.
            CassandraRosError: The messages cannot be read from the store.
        """
        try:
            while True:
                started = time.monotonic()
                if not self._pass() or not self._goes_on():
                    return
                if time.monotonic() < started + 0.01:
                    time.sleep(0.01)  # in a loop of a single message
        finally:
            with self._changed:
                self._finished = True
                self._changed.notify_all()

    def _pass(self) -> bool:
        """Play from the start or the seek until the end, a seek or a stop.

        Returns:
            False after a stop.
        """
        with self._changed:
            t = self._stream.start_ns if self._goto is None else self._goto
            self._at_end = False
            self.pace.hold(Pace.BEGIN)  # until the first message has been read
            self.pace.jump(t)
            self._horizon = t
            self._is_time_known = t != self._stream.start_ns
            prepared, self._prepared = self._prepared, None
            if prepared is not None and t != self._stream.start_ns:
                prepared.close()
                prepared = None
            reader = prepared or self._read(t)
            had_begun, self._has_begun = self._has_begun, True
            self._reader, self._window = reader, None
        try:
            first = self._read_latched(t)
            if had_begun:
                # Before latched messages: subscribers clear their data when time goes back.
                self._output.clock(t)
            self._output.begin(t)
            for played in first:
                self._output.publish(played)
            with self._changed:
                if self._goto == t:
                    self._goto = None
                    self._changed.notify_all()
            has_played = self._play(reader, t == self._stream.start_ns)
            if not (has_played or first or self._is_interrupted()) and t == self._stream.start_ns:
                raise MessageNotFound(
                    "there is nothing to play: no message of the selection was received from "
                    f"{iso_time(t)} to {iso_time(self._stream.end_ns)}"
                )
            return not self._stopped
        finally:
            reader.close()

    def _read_latched(self, t: int) -> list[PlayedMessage]:
        """Read the latched messages; wait, like the reading thread, while the store is down."""
        ends = time.monotonic() + GIVE_UP_SEC
        while True:
            try:
                return [
                    message for message in self._stream.latched(t) if self._is_readable(message)
                ]
            except (StoreUnavailable, ConnectionFailed) as exc:
                if time.monotonic() >= ends:
                    raise
                _log.warning("the store does not answer, the replay waits for it: %s", exc)
            with self._changed:
                if not self._stopped and self._goto in (None, t):
                    self._changed.wait(RETRY_SEC)
                if self._stopped or self._goto not in (None, t):
                    return []

    def _is_readable(self, played: PlayedMessage) -> bool:
        """Read what is needed to publish a latched message; return False if it cannot be read."""
        try:
            keep_row(played.row)
        except (CorruptMessage, MessageNotFound) as exc:
            self._skipped(played, exc)
            return False
        return True

    def _read(self, t: int) -> ReadAhead:
        """Begin to read the messages from ``t`` on, ns."""
        budget = self._options.read_ahead
        return ReadAhead(self._stream.messages, t, budget, self._changed, self._skipped)

    def _play(self, reader: ReadAhead, fresh: bool) -> bool:
        """Play the messages of a reader; return whether it had any.

        Args:
            fresh: Whether playing begins at the start, and not after a seek.
        """
        has_played = False
        while True:
            played = self._next(reader)
            if played is None:
                return has_played
            if fresh and not has_played:
                self._jump(played.t)  # as rosbag: time begins with the first message
            has_played, self._horizon = True, played.t
            self._is_time_known = True
            if not self._await(played):
                return True
            self._window = played.window
            self._output.publish(played)
            if self._steps:
                self._count_step()

    def _count_step(self) -> None:
        """Count a published message as a step, unless a seek or ``resume`` came meanwhile."""
        with self._changed:
            if self._steps and self.pace.holds(PAUSED):
                self._steps -= 1
                self._changed.notify_all()

    def _goes_on(self) -> bool:
        """Return at the end of a pass whether another follows; with keep_alive wait for a seek."""
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
            self._is_time_known = True
            self._at_end = True  # time goes on, as with rosbag: other nodes may use it
            self._changed.notify_all()
            self._changed.wait_for(self._is_interrupted)
            return not self._stopped

    def _is_interrupted(self) -> bool:
        """Return whether a stop or a seek was requested."""
        return self._stopped or self._goto is not None

    def _next(self, reader: ReadAhead) -> PlayedMessage | None:
        """Return the next message; None at the end, or after a stop or a seek."""
        since = time.monotonic()
        said = False
        with self._changed:
            while not self._is_interrupted() and not reader.await_next(STALL_SEC):
                waited = time.monotonic() - since
                if waited >= STALL_SEC:
                    self.pace.hold(STALLED)
                if waited >= SAY_SEC and not said:
                    said = True
                    _log.warning(
                        "the store has given no message for %.0f s: the replay stands", SAY_SEC
                    )
            if said:
                _log.warning("the replay stood for %.1f s", time.monotonic() - since)
            self.pace.release(STALLED)
            if self._is_interrupted():
                return None
            self.pace.release(Pace.BEGIN)
            return reader.next_message()

    def _await(self, played: PlayedMessage) -> bool:
        """Wait until a message may be published; return False after a stop or a seek."""
        due, pauses = False, self._pauses(played)
        with self._changed:
            while not self._is_interrupted():
                if self.pace.holds(PAUSED):
                    if self._steps:
                        self._jump(played.t)
                        self.pace.release(DELAYED)
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

    def _await_time(self, played: PlayedMessage) -> bool:
        """Wait until a message is due or something changes; return whether it is due."""
        t, window, now = played.t, played.window, self.pace.now()
        if self._options.immediate:
            self._jump(t)
            return True
        gap = self._window is None or self._window.low != window.low  # None: after a seek, too
        if gap and now < window.low:
            self._jump(window.low)
        elif self._skip_ns is not None and t - now > self._skip_ns:
            self._jump(t)
            return True
        wait_sec = self.pace.due_in(t)
        if wait_sec is not None and wait_sec <= 0:
            return True
        self._changed.wait(WAKE_SEC if wait_sec is None else min(wait_sec, WAKE_SEC))
        return False

    def _jump(self, t: int) -> None:
        """Set the time of the replay, and publish it."""
        self.pace.jump(t)
        self._output.clock(t)

    def _pauses(self, played: PlayedMessage) -> bool:
        """Return whether a message is of one of the pause topics, by stored or published name."""
        topics = self._options.pause_topics
        return bool(topics) and (played.topic in topics or played.row.topic in topics)
