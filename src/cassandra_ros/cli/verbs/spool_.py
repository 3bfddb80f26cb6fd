# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""List, store, export or delete the messages that recorders have left in the spool.

  cassandra_bag spool list
  cassandra_bag spool drain
  cassandra_bag spool export 1398090783 rest.mcap
  cassandra_bag spool drop 1398090783

A recorder keeps messages in files while the store does not answer. Those that it could not store
before it ended, the next recorder stores, or drain: all of the keyspace and the address, or those
that you name, into any store. RUN is an id as list prints it. What a running recorder uses is left
alone. export writes the messages into an MCAP if FILE ends with .mcap, else into a bag; they also
stay in the spool.
"""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Iterator, NamedTuple, Sequence

from cassandra_ros.cli.confirmation import add_yes_option, confirm
from cassandra_ros.cli.json_answer import add_json_option, tell
from cassandra_ros.cli.options import add_store_options, open_store, store_place
from cassandra_ros.cli.terminal_text import (
    MessageBar,
    counted,
    format_bytes,
    format_table,
    format_time,
)
from cassandra_ros.errors import BagError, SpoolError
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.files.spool.spool_folder import RunFolder, SpoolFolder
    from cassandra_ros.recording.spool_drain import LeftRun

_ACTIONS = ("list", "drain", "export", "drop")


class _ListedRun(NamedTuple):
    """What list says of a run in the spool; the fields are the keys of --json."""

    id: str
    """Name of its folder."""
    run: str
    robot: str
    keyspace: str
    address: str
    messages: int
    nbytes: int
    first_ns: int
    last_ns: int
    state: str
    """'left', 'recording', or why one of its files cannot be read."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what is to be done, the runs, and the store."""
    add = parser.add_argument
    add("action", metavar="|".join(_ACTIONS), choices=_ACTIONS, help="what to do")
    add("runs", metavar="RUN", nargs="*", help="ids of runs (default: all; export: needed)")
    text = "folder of the spool (default: $ROS_HOME/cassandra_ros/spool, or in ~/.ros)"
    add("--spool-dir", metavar="DIR", default="", help=text)
    add_yes_option(parser)
    add("-q", "--quiet", action="store_true", help="print errors only")
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Do what the action says."""
    from cassandra_ros.files.spool.spool_folder import SpoolFolder

    folder = SpoolFolder(Path(options.spool_dir) if options.spool_dir else None)
    if options.action == "export":
        return _export(options, folder)
    return {"list": _list, "drain": _drain, "drop": _drop}[options.action](options, folder)


def _lock_folders(folder: SpoolFolder, ids: Sequence[str]) -> Iterator[RunFolder]:
    """Yield the folders of the runs with these ids, locked; without ids all that are not in use.

    The caller releases or removes each.

    Raises:
        SpoolError: The spool has no run of an id, or its recorder is running.
    """
    present_ids = {path.name for path in folder.runs()}
    for name in ids:
        if name not in present_ids:
            names = ", ".join(sorted(present_ids)) or "none"
            raise SpoolError(f"the spool {folder.path} has no run {name}; it has {names}")
    unlocked_names = set()
    for run_folder in folder.left():
        if ids and run_folder.path.name not in ids:
            run_folder.release()
            continue
        unlocked_names.add(run_folder.path.name)
        yield run_folder
    for name in ids:
        if name not in unlocked_names:
            raise SpoolError(f"run {name} is being recorded: end its recorder first")


def _lock_runs(folder: SpoolFolder, ids: Sequence[str]) -> Iterator[LeftRun]:
    """Yield the runs of ``_lock_folders``, also its errors.

    Each is locked until the next one is asked for.
    """
    from cassandra_ros.recording.spool_drain import read_left

    for run_folder in _lock_folders(folder, ids):
        try:
            yield read_left(run_folder)
        finally:
            run_folder.release()


def _describe_run(path: Path, state: str) -> _ListedRun:
    """Read what the files of a run say of it, without a lock: its recorder may be writing them."""
    from cassandra_ros.errors import CassandraRosError
    from cassandra_ros.files.spool.segment_reader import SegmentReader
    from cassandra_ros.files.spool.spool_folder import run_bytes, run_files
    from cassandra_ros.files.spool.spool_label import TopicTotal

    total, label = TopicTotal(), None
    for file in run_files(path):
        try:
            reader = SegmentReader(file)
            label = label or reader.label()
            for topic_total in reader.totals().values():
                total.add(topic_total.count, topic_total.first_ns, topic_total.last_ns)
        except CassandraRosError as exc:
            state = str(exc)
    first = total.first_ns if total.count else 0
    origin = ("", "", "", "")
    if label is not None:
        origin = (label.name, label.node, label.keyspace, label.address)
    return _ListedRun(path.name, *origin, total.count, run_bytes(path), first, total.last_ns, state)


def _left_names(folder: SpoolFolder) -> list[str]:
    """Return the ids of the runs without a process."""
    names = []
    for run_folder in folder.left():
        names.append(run_folder.path.name)
        run_folder.release()
    return names


def _list(options: argparse.Namespace, folder: SpoolFolder) -> int:
    left_ids = _left_names(folder)
    paths = [p for p in folder.runs() if not options.runs or p.name in options.runs]
    runs = [_describe_run(p, "left" if p.name in left_ids else "recording") for p in paths]
    names = ("id", "run", "robot", "keyspace", "store", "messages", "size", "start", "end")
    rows = [
        (
            listed_run.id,
            shown(listed_run.run) or "-",
            shown(listed_run.robot) or "-",
            shown(listed_run.keyspace) or "-",
            shown(listed_run.address) or "-",
            str(listed_run.messages),
            format_bytes(listed_run.nbytes),
            format_time(listed_run.first_ns) if listed_run.messages else "-",
            format_time(listed_run.last_ns) if listed_run.messages else "-",
            shown(listed_run.state, None),
        )
        for listed_run in runs
    ]
    text = format_table((*names, "state"), rows) if rows else "the spool is empty"
    tell(options, [listed_run._asdict() for listed_run in runs], text)
    return 0


def _drain(options: argparse.Namespace, folder: SpoolFolder) -> int:
    """Store the runs that are named, else those of this keyspace and address; return the status."""
    from cassandra_ros.recording.left_runs import lines_of
    from cassandra_ros.recording.spool_drain import Drain

    hosts, port = store_place(options)
    mine = options.keyspace, f"{','.join(hosts)}:{port}"
    answer, failed = [], False
    with open_store(options, make=True) as ros_cas:
        for left_run in _lock_runs(folder, options.runs):
            label = left_run.label
            if label is None or not (options.runs or (label.keyspace, label.address) == mine):
                where = (
                    "" if label is None else f"it belongs to {label.keyspace} at {label.address}"
                )
                name, reason = left_run.folder.path.name, left_run.problem or where
                print(f"run {left_run.name} ({name}) stays: {reason}", file=sys.stderr)
                failed = failed or label is None
                continue
            with MessageBar(f"storing {left_run.name}") as bar:
                drained = Drain(ros_cas.catalog, left_run).run(bar.add)
            result = {
                "messages": drained.messages,
                "lost": dict(drained.lost),
                "complete": drained.complete,
            }
            answer.append({"run": left_run.name, **result})
            failed = failed or bool(drained.lost) or not drained.complete
            if not (options.quiet or options.json):
                print("\n".join(map(shown, lines_of(drained))))
    nothing = "the spool has nothing for this keyspace and address"
    tell(options, answer, "" if answer or failed else nothing)
    return int(failed)


def _drop(options: argparse.Namespace, folder: SpoolFolder) -> int:
    """Delete the runs that are named, else all that no recorder uses; return the status."""
    from cassandra_ros.recording.spool_drain import read_left

    dropped, failed = [], False
    with ExitStack() as locks:
        # All are locked before the question: no other process may store or delete them meanwhile.
        run_folders = []
        for run_folder in _lock_folders(folder, options.runs):
            locks.callback(run_folder.release)
            run_folders.append(run_folder)
        if run_folders and not options.yes:
            listed = [_describe_run(run_folder.path, "left") for run_folder in run_folders]
            messages = sum(listed_run.messages for listed_run in listed)
            ids = "\n".join(listed_run.id for listed_run in listed)
            confirm(f"Delete {counted(messages, 'message')} of the spool?", ids)
        for run_folder in run_folders:
            name = shown(read_left(run_folder).name)
            try:
                run_folder.remove()
            except SpoolError as exc:
                failed = True
                print(f"run {name} stays in the spool: {exc}", file=sys.stderr)
                continue
            dropped.append(run_folder.path.name)
            if not (options.quiet or options.json):
                print(f"run {name} is deleted from the spool")
    tell(options, dropped, "" if dropped or failed else "nothing of the spool is deleted")
    return int(failed)


def _export(options: argparse.Namespace, folder: SpoolFolder) -> int:
    from cassandra_ros.files.bag.file_formats import make_file
    from cassandra_ros.files.spool.message_account import read_run
    from cassandra_ros.messages.connection_header import Connection

    if len(options.runs) < 2:
        options.parser.error("export needs RUN and FILE: spool export 1398090783 rest.mcap")
    *ids, target = options.runs
    if target in {path.name for path in folder.runs()}:
        options.parser.error(f"FILE is missing: {target} is a run; spool export RUN rest.mcap")
    if os.path.exists(target):
        raise BagError(f"{target} exists; choose another name")
    messages = 0
    damaged: list[str] = []
    with make_file(target) as writer:
        numbers: dict[Connection, int] = {}
        for left_run in _lock_runs(folder, ids):
            for segment_part in read_run(left_run.folder):
                if segment_part.damage:
                    damaged.append(segment_part.damage)
                for connection, t_ns, _, wire in segment_part.messages:
                    if connection not in numbers:
                        numbers[connection] = writer.connection(connection)
                    writer.write(numbers[connection], t_ns, wire)
                    messages += 1
    for text in damaged:
        print(text, file=sys.stderr)
    text = f"{counted(messages, 'message')} written to {shown(target)}"
    tell(options, {"messages": messages, "damaged": damaged}, text)
    return int(bool(damaged))
