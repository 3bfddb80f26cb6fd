# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Delete messages by age, size and rate, but keep those around the messages of a condition.

  cassandra_bag retention --max-age 90d
  cassandra_bag retention -e '/camera/.*' --max-size 200G
  cassandra_bag retention --keep 'event: bump' --max-age 30d
  cassandra_bag retention --keep '/battery: voltage < 11' --thin 1 --thin-after 7d --max-age 90d

The last line keeps all messages of a week, then one message per second of each publisher, and
deletes messages older than 90 days. It keeps all messages of all topics from 30 s before to 30 s
after each time at which the battery was low. 'event: NAME' keeps those around the events of a name;
a topic that is called event is written /event. The command works once, on the messages that are
stored then; for a permanent rule run it by cron, with --yes. A message's age follows from its time:
a message that was recorded last year and imported today is a year old. Do not thin /tf: each of its
messages holds other frames.

Latched messages (/tf_static, /map) are not thinned, and those that are needed for kept messages are
kept, too. Messages that are stored under names have no age and are kept. Cassandra frees the disk
space when it merges its files, by default ten days after the deletion (gc_grace_seconds). You
cannot undo it; --dry-run prints how much would be deleted.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Callable, Sequence

from cassandra_ros.cli.confirmation import add_dry_run_option, add_yes_option, confirm
from cassandra_ros.cli.far_times import read_time
from cassandra_ros.cli.json_answer import add_json_option, tell
from cassandra_ros.cli.options import (
    add_store_options,
    open_store,
    read_conditions,
    read_pair,
)
from cassandra_ros.cli.terminal_text import MessageBar, counted, format_table
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.printable import shown
from cassandra_ros.quantities import byte_size, duration, exact_seconds, factor

if TYPE_CHECKING:
    from cassandra_ros.topics.upkeep.retention_rules import Retained

_FORM = "'TOPIC: CONDITION'"
_EVENT = "event"
"""Word before the colon of --keep that stands for events."""
_NUMBERS = ("messages", "dropped", "thinned", "left")
"""Columns of the table, each an attribute of Retained."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, rules, confirmation and the store."""
    add_topics(parser)
    _add_rules(parser.add_argument_group("what is kept"))
    add_dry_run_option(parser)
    add_yes_option(parser)
    parser.add_argument("-q", "--quiet", action="store_true", help="print errors only")
    add_json_option(parser)
    add_store_options(parser)


def _add_rules(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    text = "delete older messages: 30d, 8w, 12h, 90m or seconds (default: no maximum age)"
    add("--max-age", metavar="AGE", type=duration, help=text)
    text = (
        "maximum size of all topics together: 20G, 500M or bytes, as info counts them; the oldest "
        "messages are deleted first (default: no maximum)"
    )
    add("--max-size", metavar="SIZE", type=byte_size, help=text)
    add(
        "--copied",
        choices=("first", "only"),
        help="with --max-size alone: delete what another store has acknowledged (see copy "
        "--status), bucket by bucket, oldest first; first: then the rest too, as losses; only: "
        "nothing else (default: the oldest, copied or not)",
    )
    text = "keep at most HZ messages per second of each publisher (default: keep all)"
    add("--thin", metavar="HZ", type=factor, help=text)
    text = "with --thin: thin only older messages, as 12h or 7d (default: 0, thin all)"
    add("--thin-after", metavar="AGE", type=duration, default=0.0, help=text)
    text = (
        "keep all messages of all topics around the times at which a message of TOPIC satisfies "
        "CONDITION, as in CQL, or around the events of a name ('event: NAME'); may be repeated"
    )
    add(
        "--keep",
        metavar=_FORM,
        action="append",
        type=lambda pair: read_pair(pair, ":", _FORM),
        default=[],
        help=text,
    )
    text = "with --keep: time before each message or event, seconds or 5m, 1h (default: 30)"
    add("--before", metavar="SEC", type=exact_seconds, default=30.0, help=text)
    text = "with --keep: time after each message or event (default: 30)"
    add("--after", metavar="SEC", type=exact_seconds, default=30.0, help=text)
    text = "time from which ages are counted, as --start of other verbs (default: server's time)"
    add("--now", metavar="T", help=text)
    group.set_defaults(time_options=("now",))


def run(options: argparse.Namespace) -> int:
    """Print how much will be deleted, ask, and delete it."""
    if options.max_age is None and options.max_size is None and options.thin is None:
        options.parser.error("say what is to be dropped: --max-age, --max-size or --thin")
    if options.copied:
        return _keep_under(options)
    now = read_time("now", options.now)
    events = [name for topic, name in options.keep if topic == _EVENT]
    options.keep = [(topic, text) for topic, text in options.keep if topic != _EVENT]
    keep = read_conditions(options, "keep")
    with open_store(options) as ros_cas:
        topics = stored_topics(ros_cas.catalog, options)

        def retain(dry_run: bool) -> list[Retained]:
            with MessageBar("counting" if dry_run else "dropping") as bar:
                return ros_cas.upkeep.retain(
                    topics,
                    max_age=options.max_age,
                    max_bytes=options.max_size,
                    keep=keep or None,
                    event=events,
                    before=options.before,
                    after=options.after,
                    thin=options.thin,
                    thin_after=options.thin_after,
                    now=now,
                    dry_run=dry_run,
                    progress=bar.reach,
                )

        results = _count_and_drop(options, retain)
    _print(options, results)
    return 0


def _count_and_drop(
    options: argparse.Namespace, drop: Callable[[bool], list[Retained]]
) -> list[Retained]:
    """Count what would be dropped, ask, and drop it; return the numbers of what was done last.

    Args:
        options: With --dry-run it is only counted, with --yes it is neither counted nor asked.
        drop: Drops messages; True = it only counts them.

    Raises:
        NotConfirmed: The answer is not yes.
    """
    results: list[Retained] = []
    if options.dry_run or not options.yes:
        results = drop(True)
    if not options.dry_run:
        if not options.yes and _dropped_messages(results):
            confirm(f"Drop {counted(_dropped_messages(results), 'message')}?", _table(results))
        results = drop(False)
    return results


def _print(options: argparse.Namespace, results: Sequence[Retained]) -> None:
    topics = [
        {"topic": result.topic, **{name: getattr(result, name) for name in _NUMBERS}}
        for result in results
    ]
    gone = _dropped_messages(results)
    ends = "would be" if options.dry_run else "is" if gone == 1 else "are"
    text = f"{counted(gone, 'message')} {ends} dropped"
    if any(result.messages for result in results):
        text = f"{_table(results)}\n{text}"
    tell(options, {"topics": topics, "dry_run": options.dry_run}, text)


def _keep_under(options: argparse.Namespace) -> int:
    """Do what --max-size with --copied says: delete first what another store has acknowledged."""
    other = (options.max_age, options.thin, options.now, *options.keep, *options.topics)
    if options.max_size is None or any(value is not None for value in other):
        options.parser.error("--copied goes with --max-size, and with no topics or other rules")
    from cassandra_ros.stores.copying.quota import keep_under

    with open_store(options) as ros_cas:
        uncopied = options.copied == "first"

        def drop(dry_run: bool) -> list[Retained]:
            report = keep_under(
                ros_cas.catalog, options.max_size, uncopied=uncopied, dry_run=dry_run
            )
            return [report.topics[topic] for topic in sorted(report.topics)]

        results = _count_and_drop(options, drop)
    _print(options, results)
    return 0


def _dropped_messages(results: Sequence[Retained]) -> int:
    return sum(result.dropped + result.thinned for result in results)


def _table(results: Sequence[Retained]) -> str:
    filled = [result for result in results if result.messages]
    rows = [
        (shown(result.topic), *(str(getattr(result, n)) for n in _NUMBERS)) for result in filled
    ]
    return format_table(("topic", *_NUMBERS), rows, right=_NUMBERS)
