# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class HistorySubscriber: a subscriber that gets the stored messages of its topic first."""

from __future__ import annotations

import logging
import threading
import time
from typing import Any, Callable, Mapping

import rospy

from cassandra_ros.arguments import check_integer, check_node, check_ros_name, check_topic
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import CassandraRosError, CorruptMessage, InvalidKey, InvalidOption
from cassandra_ros.messages.classes import deserialize
from cassandra_ros.messages.ros_master import master_proxy
from cassandra_ros.messages.stamps import Time, When, time_or_length, to_ns
from cassandra_ros.nodes.registration import Registration
from cassandra_ros.nodes.ros_node import MASTER_ERRORS, ros_now_ns
from cassandra_ros.nodes.subscription import connected_uris, subscribe
from cassandra_ros.playing.history.live_queue import LiveQueue
from cassandra_ros.playing.history.stored_past import StoredPast
from cassandra_ros.playing.history.topic_history import History, HistoryMessage
from cassandra_ros.store.connection.address import from_environment

_log = logging.getLogger(__name__)

DEFAULT_BUFFER_BYTES = 256 * 1024 * 1024
"""Default size of the buffer of live messages, bytes."""
CONNECT_SEC = 5.0
"""Maximum time to wait for connections to the existing publishers, s."""
CLOSE_SEC = 5.0
"""Maximum time that ``unregister`` waits for the callback, s."""
MASTER_SEC = 3.0
"""Maximum time for an answer of the master, s."""


class HistorySubscriber:
    """A rospy-like subscriber that gets the stored messages of a topic first, then the live ones.

    While a recorder writes the topic, each message comes once, without a gap between the stored and
    the live messages: for each publisher in the order of sending, over several publishers in the
    order of reception. The callback is called from one thread of this subscriber, one message at a
    time. It gets instances of data_class; ``_connection_header`` is that of the publisher, for
    stored and live messages. A message that the recorder could store only after later ones, because
    a request to the store failed, may come after live ones; a warning is logged then.

    The live messages are received from the start on and wait; their bytes are compared with those
    of the last stored messages. If all messages are equal, the times of reception decide: the
    clocks of recorder and subscriber should differ by less than the publisher's period. A latched
    message that is stored is not delivered again. If no recorder writes the topic, the live
    messages come at once, and a warning says where a gap may be. If the callback is slower than the
    topic, publishers wait, as with a rospy.Subscriber without queue_size, and drop messages that do
    not fit into their own queues. After a restart of the master the node is registered again.

    The process must be a ROS node already (``rospy.init_node``). As with rospy, if this is the
    first subscription of the process to a topic, later rospy.Subscribers of the process get
    rospy.AnyMsg.

    Args:
        topic: Name of the topic, resolved as by rospy (remapping, namespace, ~).
        data_class: A message class, or rospy.AnyMsg for any type, installed or not.
        callback: Called with each message, and with callback_args unless they are None.
        callback_args: Second argument of the callback.
        since: First time of reception, as for a key; or a length before now: a number of seconds
            below 10**9, a Duration or timedelta (a larger number is a time: int ns, float s). None
            = all stored messages. With a time in the future only live messages come.
        rosCas: A RosCassandra connected to a keyspace, which the caller closes. None = a new one,
            opened as the environment says (CASSANDRA_ROS_HOST, _PORT, _KEYSPACE; 'ros').
        nodeID: nodeID of the robot whose stored messages come; None = all robots.
        run: Name or writer id of the run whose stored messages come; None = all runs. If two
            recorders write the topic, give one run: otherwise each stored message comes twice.
        buff_size: Maximum size of the waiting live messages, bytes. If it is reached while stored
            messages are read, and the topic is recorded, they are dropped and read from the store.
        tcp_nodelay: As in rospy.

    Raises:
        ConnectionFailed: The store does not answer.
        InvalidName, InvalidKey, InvalidOption: An argument is not valid.
        RunNotFound: The keyspace has no such run.
    """

    def __init__(
        self,
        topic: str,
        data_class: Any,
        callback: Callable[..., object],
        callback_args: Any = None,
        *,
        since: None | Time | Any = None,
        rosCas: RosCassandra | None = None,
        nodeID: str | None = None,
        run: None | str | int = None,
        buff_size: int = DEFAULT_BUFFER_BYTES,
        tcp_nodelay: bool = False,
    ) -> None:
        _check(data_class, callback)
        bound = check_integer("buff_size", buff_size, 1, 2**63 - 1)
        begin, node = _start_time_of(since), None if nodeID is None else check_node(nodeID)
        self.name = self.resolved_name = _resolve_topic(topic)
        self.data_class: Any = data_class
        self._callback, self._args = callback, callback_args
        self._owns_store = rosCas is None
        """Whether the store was opened here, so that it is closed here."""
        keyspace = from_environment("KEYSPACE") or "ros"
        self._rosCas = RosCassandra(keyspace=keyspace) if rosCas is None else rosCas
        self._warned_types: set[tuple[str, str]] = set()
        """Type and md5sum of the messages of another class for which a warning was logged."""
        self._connect_until = time.monotonic() + CONNECT_SEC
        """Monotonic time until which publishers are waited for, s."""
        self._is_connected = False
        """Whether all were connected once, or were waited for long enough."""
        self.failed = 0
        """Number of messages for which the callback raised, or that were not of data_class."""
        try:
            past = StoredPast(self._rosCas.catalog, self.resolved_name, node, run)
        except CassandraRosError:
            self._close_store()
            raise
        self._queue = LiveQueue(bound, ros_now_ns)
        self._history = History(past, self._queue, begin, self._await_publishers)
        self._subscriber = subscribe(self.resolved_name, self._put_live, tcp_nodelay)
        name = f"history of {self.resolved_name}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        rospy.on_shutdown(self._queue.close)
        self._registration = Registration().start()
        self._thread.start()

    @property
    def isLive(self) -> bool:
        """Whether all stored messages were delivered."""
        return self._history.live

    @property
    def lost(self) -> int:
        """Number of messages known to be missing; each was logged with its reason."""
        return self._history.lost

    def get_num_connections(self) -> int:
        """Return the number of connected publishers."""
        return len(connected_uris(self._subscriber))

    def unregister(self) -> None:
        """End the subscription: after this call the callback is not called any more.

        It may be called from the callback itself.
        """
        self._queue.close()
        self._registration.stop()
        self._subscriber.unregister()
        if threading.current_thread() is not self._thread:
            self._thread.join(CLOSE_SEC)

    def _put_live(self, topic: str, header: Mapping[str, str], wire: bytes) -> None:
        """Queue a live message, on the thread of its publisher's connection."""
        self._queue.put(header, wire)

    def _await_publishers(self) -> bool:
        """Return whether all publishers of the topic are connected, or CONNECT_SEC is over."""
        if not self._is_connected:
            publishers = _count_publishers(self.resolved_name)
            late = time.monotonic() > self._connect_until
            self._is_connected = late or self.get_num_connections() >= publishers
        return self._is_connected

    def _run(self) -> None:
        """Deliver the messages until ``unregister``, on the thread of this subscriber."""
        try:
            for message in self._history.messages():
                if self._queue.closed:
                    break
                self._deliver(message)
        except Exception:
            _log.exception("the subscription to %s has ended", self.resolved_name)
            raise
        finally:
            self._close_store()

    def _close_store(self) -> None:
        if self._owns_store:
            self._rosCas.close()

    def _deliver(self, message: HistoryMessage) -> None:
        """Call the callback with a message; what it raises is logged and counted."""
        msg = self._message(message)
        if msg is None:
            return
        try:
            if self._args is None:
                self._callback(msg)
            else:
                self._callback(msg, self._args)
        except Exception:  # noqa: BLE001 - as rospy does: logged and counted, the next one comes
            self.failed += 1
            _log.exception("bad callback of %s: %r", self.resolved_name, self._callback)

    def _message(self, message: HistoryMessage) -> Any:
        """Return a message as the callback gets it; None = it is left out, which is counted."""
        if self.data_class is rospy.AnyMsg:
            msg = rospy.AnyMsg()
            msg._buff = message.wire
        elif self._is_ours(message.header):
            try:
                msg = deserialize(self.data_class, message.wire)
            except CorruptMessage as exc:
                self.failed += 1
                _log.error("topic %s: a message is left out: %s", self.resolved_name, exc)
                return None
        else:
            self.failed += 1
            return None
        msg._connection_header = message.header
        return msg

    def _is_ours(self, header: Mapping[str, str]) -> bool:
        """Return whether a publisher's messages are of data_class; warn once of each other type."""
        kind = header.get("type", ""), header.get("md5sum", "")
        if kind[1] == self.data_class._md5sum:
            return True
        if kind not in self._warned_types:
            self._warned_types.add(kind)
            _log.warning(
                "topic %s: messages of type %s (md5sum %s) are left out, %s (%s) is subscribed to",
                self.resolved_name,
                *kind,
                self.data_class._type,
                self.data_class._md5sum,
            )
        return False


def _check(data_class: Any, callback: Any) -> None:
    """Raise InvalidOption for what is no message class, or cannot be called."""
    if not (isinstance(data_class, type) and issubclass(data_class, rospy.Message)):
        raise InvalidOption(f"data_class={data_class!r:.80} is not a class of messages")
    if not callable(callback):
        raise InvalidOption(f"callback={callback!r:.80} cannot be called")


def _resolve_topic(topic: str) -> str:
    """Return the name on the ROS graph; raises InvalidName."""
    return str(rospy.resolve_name(check_ros_name(check_topic(topic))))


def _start_time_of(since: Any) -> Callable[[int], int]:
    """Return a function from the present time to the first time of stored messages, both ns.

    Raises:
        InvalidKey: It is neither a time nor a length of time.
    """
    if since is None:
        return lambda now: 0
    try:
        when = When(to_ns(since), False) if isinstance(since, str) else time_or_length(since)
    except InvalidKey as exc:
        raise InvalidKey(f"since is neither a time nor a length of time: {exc}") from exc
    return (lambda now: max(0, now - when.ns)) if when.relative else (lambda now: when.ns)


def _count_publishers(topic: str) -> int:
    """Return the number of nodes that publish a topic; 0 also if no master answers."""
    try:
        _, _, (publishers, _, _) = master_proxy(MASTER_SEC).getSystemState(rospy.get_name())
    except MASTER_ERRORS:
        return 0
    return sum(len(nodes) for name, nodes in publishers if name == topic)
