# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Options that name another store, and the connection to it."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cassandra_ros.cli.options import DEFAULT_CONSISTENCY, open_store
from cassandra_ros.cli.parsers import Rare
from cassandra_ros.store.connection.address import read_place

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra

PLACE = "HOST[:PORT][/KEYSPACE]"


def add_target_options(parser: argparse.ArgumentParser, option: str, help: str) -> None:  # noqa: A002
    """Add the option that names the other store, and those with its login.

    Args:
        option: '--to', or another name; its value is ``options.target``.
        help: Help text, without what the parts of the value mean.
    """
    group = parser.add_argument_group("the other store")
    group.add_argument(
        option,
        dest="target",
        metavar=PLACE,
        help=f"{help} (default: port 9042, and the keyspace of the same name)",
    )
    group.add_argument(
        "--to-cqlshrc",
        metavar="FILE",
        type=lambda text: text or None,
        help=Rare(
            "file with the login and TLS settings of the other store, as --cqlshrc (default: the "
            "files that are used where --cqlshrc is not given)"
        ),
    )
    group.add_argument(
        "--to-credentials",
        metavar="FILE",
        type=lambda text: text or None,
        help=Rare(
            "file with user name and password for the other store, as --credentials (default: "
            "likewise)"
        ),
    )


def open_target(options: argparse.Namespace, make: bool) -> RosCassandra:
    """Connect to the other store. The caller closes it (a context manager).

    Args:
        make: The keyspace may be missing there.
    """
    host, port, keyspace = read_place(options.target, options.keyspace)
    place = {"host": host, "port": port, "keyspace": keyspace}
    login = {"cqlshrc": options.to_cqlshrc, "credentials": options.to_credentials}
    # What is written must be acknowledged by a quorum, however the source is read.
    words = {**vars(options), **place, **login, "consistency": DEFAULT_CONSISTENCY, "run": None}
    return open_store(argparse.Namespace(**words), make=make)
