# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The account of numbered messages: python -m faults.account CASE.json, prints one JSON document.

It shares no code with the package: what was published is read from the logs of the publishers, what
is stored by Cassandra's own driver, with the schema as doc/formats.md and the comments of the
tables describe it. What was told as lost is read from the table cr_loss.

One of these is true for each number that was published:

- stored: it is in a table.
- removed: a verb was asked to delete it, and it is gone.
- unheard: it was published while no recorder was subscribed. The log of its publisher says that it
  had no subscriber, or it was published after a recorder was killed and before the next message
  that is stored.
- in flight: it is missing and was published in the last IN_FLIGHT_SEC before a recorder was killed,
  and the run of that recorder has no end, which tells readers that it was interrupted; or with
  --journal the next recorder has noted the gap.
- lost: a row of cr_loss counts it.
- unaccounted: nothing above. The table must have 0 of these.
"""

from __future__ import annotations

import bisect
import json
import struct
import sys
from collections import Counter
from pathlib import Path
from typing import Any, Iterator, Mapping, NamedTuple

import zstandard
from cassandra import ConsistencyLevel
from cassandra.cluster import EXEC_PROFILE_DEFAULT, Cluster, ExecutionProfile
from cassandra.policies import RoundRobinPolicy, WhiteListRoundRobinPolicy
from cassandra.query import SimpleStatement, tuple_factory

from faults.numbered import Published, read_log, text_of, topic_of

IN_FLIGHT_SEC = 2.0
"""Maximum age of a message that is lost when its recorder is killed, s. It waits in a batch or a
block (0.5 s) and for its acknowledgement."""
KILLED = "recorder killed"
"""Reason of the loss that the next recorder notes for one with --journal."""
SECOND_NS = 10**9
DELAY_NS = 30 * SECOND_NS
"""Maximum time from publishing to receiving, ns: on a busy machine a recorder falls behind."""
TIMEOUT_SEC = 60
TEXT_COLUMNS = ("data", "value")
"""Fields of std_msgs/String and diagnostic_msgs/KeyValue that hold the text."""


class StoredText(NamedTuple):
    """A message as it is stored."""

    robot: str
    text: str


class Store:
    """A keyspace, read by the bare driver.

    Args:
        hosts: Addresses of nodes.
        port: CQL port.
        keyspace: The keyspace.
    """

    def __init__(self, hosts: list[str], port: int, keyspace: str) -> None:
        policy = WhiteListRoundRobinPolicy(hosts) if len(hosts) == 1 else RoundRobinPolicy()
        profile = ExecutionProfile(
            load_balancing_policy=policy,
            request_timeout=TIMEOUT_SEC,
            row_factory=tuple_factory,
            consistency_level=ConsistencyLevel.QUORUM,
        )
        self._cluster = Cluster(
            hosts,
            port=port,
            protocol_version=5,
            execution_profiles={EXEC_PROFILE_DEFAULT: profile},
            connect_timeout=TIMEOUT_SEC,
            control_connection_timeout=TIMEOUT_SEC,
            schema_metadata_enabled=False,
            token_metadata_enabled=False,
        )
        self.keyspace = keyspace
        self._session = self._cluster.connect()

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._cluster.shutdown()

    def select(self, cql: str, *values: object) -> Iterator[tuple]:
        """Yield the rows of a statement, page by page."""
        yield from self._session.execute(SimpleStatement(cql, fetch_size=2000), values)

    def tables(self) -> dict[str, dict[str, Any]]:
        """Return the metadata of the tables that hold messages, by their names.

        They are in the comments. A table that is still filled is not read yet, and one that another
        one has replaced not any more.
        """
        cql = "SELECT table_name, comment FROM system_schema.tables WHERE keyspace_name = %s"
        found = {}
        for name, comment in self.select(cql, self.keyspace):
            if comment.startswith('{"cassandra_ros":'):
                metadata = json.loads(comment)["cassandra_ros"]
                if not metadata["filling"]:
                    found[name] = metadata
        replaced = {old for metadata in found.values() for old in metadata["replaces"]}
        return {name: metadata for name, metadata in found.items() if name not in replaced}

    def texts(self, table: str, metadata: dict[str, Any]) -> Iterator[StoredText]:
        """Yield all messages of a table."""
        if metadata["format"] == "packed":
            yield from self._texts_of_blocks(table)
            return
        column = self._text_column(table)
        for robot, value in self.select(f'SELECT "_node", "{column}" FROM {self.keyspace}.{table}'):
            yield StoredText(robot, value if isinstance(value, str) else text_of_wire(value))

    def _text_column(self, table: str) -> str:
        cql = "SELECT column_name FROM system_schema.columns WHERE keyspace_name = %s"
        names = {
            name for (name,) in self.select(f"{cql} AND table_name = %s", self.keyspace, table)
        }
        return next((name for name in TEXT_COLUMNS if name in names), "_data")

    def _texts_of_blocks(self, table: str) -> Iterator[StoredText]:
        names = '"_node", "_n", "_gone", "_data"'
        for robot, count, gone, data in self.select(f"SELECT {names} FROM {self.keyspace}.{table}"):
            if data is not None:
                for position, wire in enumerate(wires_of_block(data, count)):
                    if position not in (gone or ()):
                        yield StoredText(robot, text_of_wire(wire))

    def newest_ns(self, topic: str) -> int:
        """Return the maximum key time of the stored messages of topics with a prefix, ns."""
        newest = 0
        for name, metadata in self.tables().items():
            if metadata["topic"].startswith(topic):
                newest = max([newest, *(t for (t,) in self._newest_rows(name, '"_t"'))])
        return newest

    def newest_number(self, topic: str) -> int:
        """Return the number of the last stored message of a topic; -1 = no message is stored."""
        numbers = [-1]
        for name, metadata in self.tables().items():
            if metadata["topic"] == topic and metadata["format"] == "packed":
                for count, data in self._newest_rows(name, '"_n", "_data"'):
                    numbers.append(int(text_of_wire(wires_of_block(data, count)[-1])[:10]))
            elif metadata["topic"] == topic:
                for (value,) in self._newest_rows(name, f'"{self._text_column(name)}"'):
                    text = value if isinstance(value, str) else text_of_wire(value)
                    numbers.append(int(text[:10]))
        return max(numbers)

    def _newest_rows(self, table: str, columns: str) -> Iterator[tuple]:
        """Yield some columns of the row with the maximum key time of each robot, or block."""
        where = f"{self.keyspace}.{table}"
        keys = list(self.select(f'SELECT DISTINCT "_node", "_bucket" FROM {where}'))
        last = max((bucket for _, bucket in keys), default=0)
        for robot, bucket in keys:
            if bucket == last:
                cql = f'SELECT {columns} FROM {where} WHERE "_node" = %s AND "_bucket" = %s'
                yield from self.select(f'{cql} ORDER BY "_t" DESC LIMIT 1', robot, bucket)

    def losses(self, topic: str) -> list[tuple[str, int, int, int]]:
        """Return kind, first and last time (ns), and number of the losses of topics with a prefix.

        The number 0 means that it is not known.
        """
        if not self._has("cr_loss"):
            return []
        cql = f"SELECT topic, kind, first, last, n FROM {self.keyspace}.cr_loss"
        return [row[1:] for row in self.select(cql) if row[0].startswith(topic)]

    def open_runs(self) -> int:
        """Return the number of runs without an end, which readers call interrupted."""
        if not self._has("cr_run"):
            return 0
        cql = f"SELECT started, ended FROM {self.keyspace}.cr_run"
        return sum(
            started is not None and (ended is None or ended < started)
            for started, ended in self.select(cql)
        )

    def _has(self, table: str) -> bool:
        cql = "SELECT table_name FROM system_schema.tables WHERE keyspace_name = %s"
        return any(self.select(f"{cql} AND table_name = %s", self.keyspace, table))


def text_of_wire(wire: bytes) -> str:
    """Return the text of a serialised std_msgs/String, or of a KeyValue with an empty key."""
    (size,) = struct.unpack_from("<I", wire)
    if not size and len(wire) > 4:
        return text_of_wire(wire[4:])
    if size != len(wire) - 4:
        raise ValueError(f"a message of {len(wire)} bytes holds no text of {size} bytes")
    return wire[4:].decode()


def wires_of_block(data: bytes, count: int) -> list[bytes]:
    """Return the messages of a block, see doc/formats.md.

    Only blocks are read that hold fewer than 16 messages of each size, all below 512 bytes, which
    are stored one after the other in the order of their sizes. Others have more bytes, or flag 2.
    """
    version, flags = data[:2]
    if version != 1 or flags & ~0b101:
        raise ValueError(f"a block of version {version} with flags {flags} is not read here")
    plain = data[2:] if flags & 4 else zstandard.ZstdDecompressor().decompress(data[2:])
    # The sizes follow the differences of times and of sequence numbers, 8 bytes each: first all
    # first bytes, then all second bytes, ….
    planes = [plain[(16 + byte) * count : (17 + byte) * count] for byte in range(4)]
    sizes = [int.from_bytes(each, "little") for each in zip(*planes)]
    at = (28 if flags & 1 else 20) * count
    wires = [b""] * count
    for position in sorted(range(count), key=sizes.__getitem__):
        wires[position] = plain[at : at + sizes[position]]
        at += sizes[position]
    if at != len(plain):
        raise ValueError(f"a block has {len(plain)} bytes, its messages end at {at}")
    return wires


class Contents(NamedTuple):
    """What is stored of one robot."""

    copies: Mapping[int, int]
    """Number of copies by message number."""
    changed: int
    """Number of messages with another text than was published, or of another topic."""


def read_contents(store: Store, case: dict[str, Any]) -> dict[str, Contents]:
    """Read all messages of the topics of a case; return them by robot."""
    topic, topics, step = case["topic"], case["topics"], case["step"]
    own = {topic_of(topic, number, topics) for number in range(topics)} if topics > 1 else set()
    copies: dict[str, Counter] = {}
    changed: Counter = Counter()
    for name, metadata in store.tables().items():
        name_now = metadata["topic"]
        if name_now.startswith(topic):
            for robot, text in store.texts(name, metadata):
                number = int(text[:10]) if text[:10].isdigit() else -1
                elsewhere = name_now in own and name_now != topic_of(topic, number, topics, step)
                if text == text_of(number) and not elsewhere:
                    copies.setdefault(robot, Counter())[number] += 1
                else:
                    changed[robot] += 1
    robots = {*copies, *changed}
    return {robot: Contents(copies.get(robot, Counter()), changed[robot]) for robot in robots}


def account(case: dict[str, Any]) -> dict[str, Any]:
    """Return the account of a case.

    Args:
        case: Its keys are hosts, port, keyspace; topic (prefix of the topics' names); topics, step
            (see topic_of); logs (of the publishers); robots (each has recorded everything); kills
            (times at which recorders were killed, ns); removed (time ranges whose messages were
            deleted, ns, ends included);
            removed_count (number of messages that verbs told to have deleted, whichever those are);
            gone_before_ns (time at which the keyspace was dropped, ns); told (number of messages
            that a recorder told as lost where the store could not keep it).
    """
    published = sorted(line for path in case["logs"] for line in read_log(path))
    with Store(case["hosts"], case["port"], case["keyspace"]) as store:
        contents = read_contents(store, case)
        losses = store.losses(case["topic"])
        open_runs = store.open_runs()
    sums: Counter = Counter()
    missing: list[int] = []
    for robot in case["robots"]:
        own = account_of(published, contents.get(robot, Contents(Counter(), 0)), case)
        sums.update(own.sums)
        missing += own.missing
    # Verbs say how many messages they have deleted, not which.
    removed = min(len(missing), case["removed_count"])
    told = sum(row[3] for row in losses) + case["told"]
    removed += gone_with_keyspace(missing, losses, case["gone_before_ns"])
    rest = len(missing) - removed - told
    vague = [row[1:3] for row in losses if not row[3]]
    told_vaguely = sum(any(a <= time_ns <= b for a, b in vague) for time_ns in missing)
    told_vaguely = max(0, min(rest, told_vaguely))
    told_kills = open_runs + sum(kind == KILLED for kind, *_ in losses)
    untold_kill = sums["in_flight"] if told_kills < len(case["kills"]) else 0
    of_others = sum(len(contents[name].copies) for name in set(contents) - set(case["robots"]))
    return {
        "published": len(published) * len(case["robots"]),
        "stored": sums["stored"],
        "removed": sums["removed"] + removed,
        "unheard": sums["unheard"],
        "in_flight": sums["in_flight"],
        "in_flight_sec": round(sums["in_flight_ns"] / SECOND_NS, 3),
        "lost": told + told_vaguely,
        "lost_by_reason": _by_reason(losses),
        # Negative where more was told than is missing.
        "unaccounted": rest - told_vaguely + sums["not_removed"] + untold_kill,
        "told_removed": case["removed_count"],
        "doubled": sums["doubled"],
        "changed": sums["changed"] + of_others,
        "open_runs": open_runs,
    }


def gone_with_keyspace(
    missing: list[int], losses: list[tuple[str, int, int, int]], before_ns: int
) -> int:
    """Return how many missing messages went with the keyspace when it was dropped.

    A message that was published before may also have been on its way to the store at that time:
    then it was told as lost. No row says which one it was, so their number is what was told and
    concerns no later message.
    """
    gone = sum(time_ns < before_ns for time_ns in missing)
    told = sum(count for _, _, _, count in losses)
    told_then = sum(count for _, first, _, count in losses if first <= before_ns + DELAY_NS)
    return gone - max(0, min(gone, told_then, told - (len(missing) - gone)))


class RobotAccount(NamedTuple):
    """What became of the messages of one robot."""

    sums: Counter
    missing: list[int]
    """Times at which messages were published of which nothing else is known here, ns."""


def account_of(
    published: list[Published], contents: Contents, case: dict[str, Any]
) -> RobotAccount:
    """Sort the numbers of one robot into stored, removed, unheard, in flight and missing."""
    copies = contents.copies
    numbers = {line.number for line in published}
    sums: Counter = Counter(changed=contents.changed)
    sums["stored"] = sum(number in numbers for number in copies)
    sums["doubled"] = sum(count - 1 for count in copies.values())
    sums["changed"] += sum(count for number, count in copies.items() if number not in numbers)
    kills = sorted(case["kills"])
    by_time = sorted(published, key=lambda line: line.time_ns)
    unheard = _unheard_after_kills(by_time, copies, kills)
    in_flight, missing = 0, []
    for number, time_ns, connections in by_time:
        removed = any(first <= time_ns <= last for first, last in case["removed"])
        if number in copies:
            sums["not_removed"] += removed
        elif removed:
            sums["removed"] += 1
        elif not connections or number in unheard:
            sums["unheard"] += 1
        elif (age := _age_at_kill(time_ns, kills)) is not None:
            sums["in_flight"] += 1
            in_flight = max(in_flight, age)
        else:
            missing.append(time_ns)
    sums["in_flight_ns"] = in_flight
    return RobotAccount(sums, missing)


def _unheard_after_kills(
    by_time: list[Published], copies: Mapping[int, int], kills: list[int]
) -> set[int]:
    """Return the numbers published after each kill and before the next message that is stored."""
    times = [line.time_ns for line in by_time]
    found = set()
    for kill in kills:
        for line in by_time[bisect.bisect_left(times, kill) :]:
            if line.number in copies:
                break
            found.add(line.number)
    return found


def _age_at_kill(time_ns: int, kills: list[int]) -> int | None:
    """Return the age that a message had when a recorder was killed, ns; None if it was too old."""
    position = bisect.bisect_left(kills, time_ns)
    if position == len(kills) or kills[position] - time_ns > IN_FLIGHT_SEC * SECOND_NS:
        return None
    return kills[position] - time_ns


def _by_reason(losses: list[tuple[str, int, int, int]]) -> dict[str, int]:
    found: Counter = Counter()
    for kind, _, _, count in losses:
        found[kind] += count
    return dict(found)


if __name__ == "__main__":
    print(json.dumps(account(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))))
