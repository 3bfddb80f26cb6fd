# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Rename a stored topic. Its messages are not copied, so this takes no time.

  cassandra_bag rename /camera/image_raw /front/image_raw

Runs keep their names. The losses of the topic are renamed, too. A recorder that is writing the
topic continues into the renamed topic for the publishers that it knows; the next recording creates
the old topic again.
"""

from __future__ import annotations

import argparse

from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.printable import shown


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add both names and the store."""
    parser.add_argument("topic", metavar="TOPIC", help="a stored topic")
    parser.add_argument("new_name", metavar="NEW", help="its new name")
    parser.add_argument("-q", "--quiet", action="store_true", help="print errors only")
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Rename the topic, and print its new name."""
    with open_store(options) as ros_cas:
        name = ros_cas.getTopic(options.topic).name
        ros_cas.renameTopic(name, options.new_name)
    if not options.quiet:
        print(f"topic {shown(name)} is called {shown(options.new_name)} now")
    return 0
