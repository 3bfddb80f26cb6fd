# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Drop what is older or more than is to be kept, thin the rest, and keep what lies around events.

  cassandra_bag retention --max-age 90d
  cassandra_bag retention -e '/camera/.*' --max-size 200G
  cassandra_bag retention --keep '/battery: voltage < 11' --thin 1 --thin-after 7d --max-age 90d

The last keeps everything for a week, from then on a message a second of each publisher, nothing
beyond 90 days, and all topics whole from 30 s before to 30 s behind each time when the battery was
low. Each run looks at what is there then: for a lasting rule let cron run it, with --yes. Repeated
it drops nothing more but what became older. Ages are those of the messages: what was recorded last
year and imported today is a year old. /tf is not worth thinning: its messages hold other frames
each.

Latched messages (/tf_static, /map) are not thinned, and those that were in force where something is
kept stay with it. Messages that are kept under names have no age and stay. Cassandra frees the disk
some time after a message was dropped: when it merges its files, ten days later by default
(gc_grace_seconds). It cannot be undone; --dry-run says beforehand how much it would be.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Sequence

from cassandra_ros.cli.confirmation import add_dry_run_option, add_yes_option, confirm
from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import (
    add_store_options,
    open_store,
    read_conditions,
    read_pair,
    read_time,
)
from cassandra_ros.cli.readers import age, byte_size, factor, seconds
from cassandra_ros.cli.terminal_text import MessageBar, counted, format_table
from cassandra_ros.cli.topic_options import add_topics, stored_topics
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.upkeep.retention_rules import Retained

_FORM = "'TOPIC: CONDITION'"
_NUMBERS = ("messages", "dropped", "thinned", "left")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add topics, what is to be kept of them, whether it is asked, and the store."""
    add_topics(parser)
    _add_rules(parser.add_argument_group("what is kept"))
    add_dry_run_option(parser)
    add_yes_option(parser)
    parser.add_argument("-q", "--quiet", action="store_true", help="print errors only")
    add_json_option(parser)
    add_store_options(parser)


def _add_rules(group: argparse._ArgumentGroup) -> None:
    add = group.add_argument
    text = "drop what is older: 30d, 8w, 12h, 90m or seconds (default: drop nothing for its age)"
    add("--max-age", metavar="AGE", type=age, help=text)
    text = (
        "let the topics together take at most SIZE: 20G, 500M or bytes, as info counts them; the "
        "oldest messages go first (default: no limit)"
    )
    add("--max-size", metavar="SIZE", type=byte_size, help=text)
    text = "of what is left keep at most HZ messages a second, of each publisher (default: all)"
    add("--thin", metavar="HZ", type=factor, help=text)
    text = "thin only what is older than that, as 12h or 7d (default: 0, everything)"
    add("--thin-after", metavar="AGE", type=age, default=0.0, help=text)
    text = (
        "leave everything alone that lies around messages of a topic that satisfy a condition as "
        "in CQL, in all of the topics; may be repeated, for other topics"
    )
    add(
        "--keep",
        metavar=_FORM,
        action="append",
        type=lambda pair: read_pair(pair, ":", _FORM),
        default=[],
        help=text,
    )
    text = "how far before them, with --keep, seconds or 5m, 1h (default: 30)"
    add("--before", metavar="SEC", type=seconds, default=30.0, help=text)
    text = "and how far behind (default: 30)"
    add("--after", metavar="SEC", type=seconds, default=30.0, help=text)
    text = "count ages back from this time, as --start of the others (default: the server's time)"
    add("--now", metavar="T", help=text)


def run(options: argparse.Namespace) -> int:
    """Say how much it would be, ask, and drop it."""
    if options.max_age is None and options.max_size is None and options.thin is None:
        options.parser.error("say what is to be dropped: --max-age, --max-size or --thin")
    keep, now = read_conditions(options, "keep"), read_time("now", options.now)
    with open_store(options) as ros_cas:
        topics = stored_topics(ros_cas, options)

        def retain(text: str, dry_run: bool) -> list[Retained]:
            with MessageBar(text) as bar:
                return ros_cas.upkeep.retain(
                    topics,
                    max_age=options.max_age,
                    max_bytes=options.max_size,
                    keep=keep or None,
                    before=options.before,
                    after=options.after,
                    thin=options.thin,
                    thin_after=options.thin_after,
                    now=now,
                    dry_run=dry_run,
                    progress=bar.reach,
                )

        found: list[Retained] = []
        if options.dry_run or not options.yes:
            found = retain("counting", dry_run=True)
        if not options.dry_run:
            if not options.yes and _gone(found):
                confirm(f"Drop {counted(_gone(found), 'message')}?", _table(found))
            found = retain("dropping", dry_run=False)
    if options.json:
        answer = [{"topic": e.topic, **{n: getattr(e, n) for n in _NUMBERS}} for e in found]
        print_json({"topics": answer, "dry_run": options.dry_run})
    elif not options.quiet:
        print(_table(found))
        gone = _gone(found)
        ends = "would be" if options.dry_run else "is" if gone == 1 else "are"
        print(f"{counted(gone, 'message')} {ends} dropped")
    return 0


def _gone(found: Sequence[Retained]) -> int:
    return sum(each.dropped + each.thinned for each in found)


def _table(found: Sequence[Retained]) -> str:
    rows = [(shown(each.topic), *(str(getattr(each, n)) for n in _NUMBERS)) for each in found]
    return format_table(("topic", *_NUMBERS), rows, right=_NUMBERS)
