# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Print the metadata of a topic, or set keys of your own.

  cassandra_bag meta /camera/image_raw
  cassandra_bag meta /camera/image_raw site=lab lens_mm=3.5 comment='left camera'
  cassandra_bag meta /camera/image_raw --remove site

A value is JSON (3.5, true, [1, 2], "3.5"); what is not JSON is a text. The key comment sets the
topic's comment. All other printed keys that are not your own are facts and cannot be set.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, open_store, read_pair, read_pairs
from cassandra_ros.printable import shown_lines

_FORM = "KEY=VALUE"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the topic, the keys, the form of the answer, and the store."""
    add = parser.add_argument
    add("topic", metavar="TOPIC", help="a stored topic")
    add(
        "keys",
        nargs="*",
        metavar=_FORM,
        type=lambda text: read_pair(text, "=", _FORM),
        help="set this key of your own, or the comment (default: only print)",
    )
    add(
        "--remove",
        metavar="KEY",
        action="append",
        default=[],
        help="remove a key of your own; may be repeated",
    )
    add(
        "--definition",
        action="store_true",
        help="print only the message definition, as rosmsg show --raw does",
    )
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Set and remove keys, then print the metadata."""
    pairs: list[tuple[str, Any]] = [(name, _value(text)) for name, text in options.keys]
    # A key of the value None is removed; the comment, which is always there, becomes empty.
    pairs += [(name, "" if name == "comment" else None) for name in options.remove]
    keys = read_pairs(options, "a key", pairs)
    with open_store(options) as ros_cas:
        topic = ros_cas.getTopic(options.topic)
        if keys:
            topic.setMeta(**keys)
        metadata = dict(topic.getMeta)
    if options.definition:
        print(shown_lines(metadata["definition"].rstrip("\n")))
    elif options.json:
        print_json(metadata)
    else:
        del metadata["definition"]
        _print_yaml(metadata)
    return 0


def _value(text: str) -> object:
    """Return what a text means as JSON, else the text."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def _print_yaml(value: object) -> None:
    import yaml

    print(yaml.safe_dump(value, sort_keys=False, allow_unicode=True), end="")
