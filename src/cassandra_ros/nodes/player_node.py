# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Node player: its name, its services, its signals; class Player does the work."""

from __future__ import annotations

import logging
import signal
import sys
from types import FrameType
from typing import Callable, Sequence

import rospy
from std_srvs.srv import SetBool, SetBoolRequest, SetBoolResponse, Trigger, TriggerResponse

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import CassandraRosError
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.msg import PlayedTopic
from cassandra_ros.nodes.player import Player, PlayerState
from cassandra_ros.nodes.ros_node import offer_services, ros_time, start_named_node
from cassandra_ros.playing.play_options import PlayerOptions
from cassandra_ros.playing.play_selection import PlaySelection
from cassandra_ros.srv import (
    PlayerStatus,
    PlayerStatusRequest,
    PlayerStatusResponse,
    Seek,
    SeekRequest,
    SeekResponse,
    SetRate,
    SetRateRequest,
    SetRateResponse,
    Step,
    StepRequest,
    StepResponse,
)
from cassandra_ros.stores.fleet.fleet import Fleet

_log = logging.getLogger(__name__)

POLL_SEC = 0.05
"""Interval at which keys and signals are checked, s."""
SWITCH_SEC = 0.0002
"""Maximum time that the reading thread holds the interpreter before the publishing one, s."""

Say = Callable[[str], None]
"""Function that prints a line for the user."""
Show = Callable[[PlayerState], None]
"""Function that shows the state of the player."""
Keys = Callable[[], str]
"""Function that returns the keys pressed since the last call."""


def play(
    store: RosCassandra | Fleet,
    selection: PlaySelection,
    options: PlayerOptions,
    argv: Sequence[str],
    say: Say,
    show: Show,
    keys: Keys,
) -> PlayerState:
    """Play until the end, a signal or the master ends it; return the last state.

    Args:
        store: The open keyspace, or the fleet.
        selection: Messages to be played.
        options: Options of the replay.
        argv: The command line, with remappings.
        say: Prints a line for the user.
        show: Shows the state of the player; called every POLL_SEC.
        keys: Returns the keys pressed since the last call.
    """
    player = Player(store, selection, options)  # raises errors before the node is started
    sys.setswitchinterval(SWITCH_SEC)
    # Wall time, also if /use_sim_time is set: it may itself publish /clock.
    start_named_node("player", argv, rosout=False)
    hurry = store.hurry if isinstance(store, Fleet) else store.cassandra.outage.hurry
    signals: list[int] = []

    def signalled(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        hurry()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signalled)
    try:
        offer_services(PlayerServices(player).all(), say, none=options.no_services)
        player.start()
        _say_what(player, say)
        stopped, told_missing = 0, 0  # number of stops, and of missing stores that were logged
        while not player.wait(POLL_SEC):
            missing = list(player.stream.missing.items())
            for name, reason in missing[told_missing:]:
                _log.warning("the replay goes on without store %s: %s", name, reason)
            told_missing = len(missing)
            if len(signals) > stopped or (rospy.is_shutdown() and not stopped):
                stopped += 1
                player.stop(abandon=stopped > 1)
            for key in keys():
                press(player, key)
            show(player.status())
        show(player.status())
        return player.status()
    finally:
        player.stop(abandon=True)
        rospy.signal_shutdown("the replay has ended")


def _say_what(player: Player, say: Say) -> None:
    """Say how many topics are played, and for how long."""
    status = player.status()
    topics, ranges = status.topics, len(player.stream.windows)
    latched = sum(topic.latched for topic in topics)
    say(
        f"playing {len(topics)} topic{'' if len(topics) == 1 else 's'}, "
        f"{status.length / SECOND_NS:.1f} s"
        + (f" in {ranges} time ranges" if ranges > 1 else "")
        + (f"; {latched} latched" if latched else "")
    )


def press(player: Player, key: str) -> None:
    """Do what a key does in rosbag play; ignore other keys."""
    if key == " ":
        _ = player.pause() or player.resume()
    elif key == "t":
        player.togglePauseTopics()
    elif key == "s" and player.status().state == PlayerStatusResponse.PAUSED:
        try:
            player.step()
        except CassandraRosError as exc:
            _log.warning("%s", exc)


class PlayerServices:
    """The services of a player. A handler unpacks a request, calls the player, packs the answer."""

    def __init__(self, player: Player) -> None:
        self._player = player

    def all(self) -> Sequence[tuple[str, type, Callable[..., object]]]:
        """Return of each service its name, its class and its handler."""
        return (
            ("~pause", Trigger, self.pause),
            ("~resume", Trigger, self.resume),
            ("~pause_playback", SetBool, self.pause_playback),
            ("~step", Step, self.step),
            ("~seek", Seek, self.seek),
            ("~setRate", SetRate, self.set_rate),
            ("~stop", Trigger, self.stop),
            ("~status", PlayerStatus, self.status),
        )

    def pause(self, request: object) -> TriggerResponse:
        """Pause."""
        changed = self._player.pause()
        return TriggerResponse(True, "" if changed else "it was paused already")

    def resume(self, request: object) -> TriggerResponse:
        """End the pause."""
        changed = self._player.resume()
        return TriggerResponse(True, "" if changed else "it was not paused")

    def pause_playback(self, request: SetBoolRequest) -> SetBoolResponse:
        """Pause or resume, answering as rosbag play does."""
        changed = self._player.pause() if request.data else self._player.resume()
        state = "paused" if request.data else "resumed" if changed else "running"
        text = f"Playback is now {state}" if changed else f"Playback is already {state}."
        return SetBoolResponse(changed, text)

    def step(self, request: StepRequest) -> StepResponse:
        """Publish the next messages."""
        try:
            now = self._player.step(request.count or 1)
        except CassandraRosError as exc:
            return StepResponse(False, str(exc), ros_time(self._player.status().time))
        return StepResponse(True, "", ros_time(now))

    def seek(self, request: SeekRequest) -> SeekResponse:
        """Go on at another time."""
        text = request.text.strip()
        try:
            t_ns = self._player.seek(text if text else request.time)
        except CassandraRosError as exc:
            return SeekResponse(False, str(exc), ros_time(self._player.status().time))
        return SeekResponse(True, "", ros_time(t_ns))

    def set_rate(self, request: SetRateRequest) -> SetRateResponse:
        """Change the factor of speed."""
        try:
            self._player.setRate(request.rate)
        except CassandraRosError as exc:
            return SetRateResponse(False, str(exc), self._player.status().rate)
        return SetRateResponse(True, "", request.rate)

    def stop(self, request: object) -> TriggerResponse:
        """End playing."""
        self._player.stop()
        return TriggerResponse(True, "")

    def status(self, request: PlayerStatusRequest) -> PlayerStatusResponse:
        """Return the state of the player."""
        now = self._player.status()
        return PlayerStatusResponse(
            success=True,
            state=now.state,
            time=ros_time(now.time),
            start=ros_time(now.start),
            end=ros_time(now.end),
            rate=now.rate,
            loop=self._player.options.loop,
            published=sum(topic.published for topic in now.topics),
            missed=sum(topic.missed for topic in now.topics),
            left_out=sum(topic.left_out for topic in now.topics),
            read_ahead=now.read_ahead,
            topics=[PlayedTopic(**topic._asdict()) for topic in now.topics],
        )
