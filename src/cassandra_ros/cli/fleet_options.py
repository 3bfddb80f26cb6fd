# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Options of verbs that may ask several stores as one, and the connection to these."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Mapping

from cassandra_ros.cli.far_times import check_times
from cassandra_ros.cli.options import (
    DEFAULT_CONSISTENCY,
    hurry_on_interrupt,
    open_store,
    read_seconds,
)
from cassandra_ros.cli.parsers import Rare, error_line
from cassandra_ros.store.connection.address import ANSWER_SEC, read_address

if TYPE_CHECKING:
    from cassandra_ros.client.ros_cassandra import RosCassandra
    from cassandra_ros.stores.fleet.fleet import Fleet


STORE_MISSING = 3
"""Exit status if a store of --store did not answer."""
PLACE = "HOST[:PORT][/KEYSPACE]"
"""How the address of a store is written, for help texts."""


def add_fleet_options(
    parser: argparse.ArgumentParser, prefix: str = "", *, ends: bool = True
) -> None:
    """Add --store and what goes with it; open_fleet reads them.

    Args:
        prefix: That of add_store_options.
        ends: Whether the program ends by itself, with a status that says if a store is missing.
    """
    status = f", and the exit status is {STORE_MISSING}" if ends else ""
    group = parser.add_argument_group(
        "several stores",
        "each message comes once, in the order of time, though several stores have it; a store "
        f"that does not answer is named{status}",
    )
    group.add_argument(
        "--store",
        dest="stores",
        metavar=PLACE,
        action="append",
        default=[],
        help=f"ask this store, in place of --{prefix}host and --{prefix}port; may be repeated "
        "(default: port 9042, and the keyspace of --keyspace). With --store-file also the name of "
        "one of its sections",
    )
    group.add_argument(
        "--store-file",
        metavar="FILE",
        type=lambda text: text or None,
        help=Rare(
            "file of stores: a section for each, with its place, cqlshrc and credentials "
            "(default: none; --cqlshrc and --credentials are for all stores)"
        ),
    )
    group.add_argument(
        "--store-timeout",
        metavar="SECONDS",
        type=read_seconds,
        default=ANSWER_SEC,
        help=Rare(
            "maximum time to wait for the answer of a store of --store (default: %(default)g)"
        ),
    )


def open_fleet(options: argparse.Namespace) -> Fleet:
    """Return the stores of --store. The caller closes them (a context manager).

    A store that does not answer is no error; answers of the fleet name it.

    Raises:
        InvalidOption: A store is given twice or is not a place, or the file is not valid.
    """
    from cassandra_ros.stores.fleet.fleet import Fleet
    from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer

    fleet = Fleet(
        options.stores,
        file=options.store_file,
        keyspace=options.keyspace,
        answer_sec=options.store_timeout,
        cqlshrc=options.cqlshrc,
        credentials=options.credentials,
        consistency=options.consistency,
    )
    hurry_on_interrupt(fleet)
    if any(getattr(options, name) for name in getattr(options, "time_options", ())):
        try:
            check_times(options, FleetAnswer(fleet.stores).catalogs.values())
        except BaseException:
            fleet.close()
            raise
    return fleet


def refuse_single_store_options(options: argparse.Namespace, names: Mapping[str, object]) -> None:
    """End the program if options are given that ask one store only.

    Args:
        options: The parsed options.
        names: Option, as it is typed → its value; a false value = the option is not given.
    """
    first_given = next((name for name, value in names.items() if value), None)
    if first_given is not None:
        options.parser.error(f"{first_given} asks one store: it goes without --store")


def tell_missing(missing: Mapping[str, str], program: str = "cassandra_bag") -> int:
    """Print which stores did not answer; return the exit status.

    Args:
        missing: Name of a store → the reason why it did not answer.
        program: Name of the program, for the lines.
    """
    for name, reason in missing.items():
        text = f"store {name} did not answer, what only it has is left out: {reason}"
        print(error_line(program, text), file=sys.stderr)
    return STORE_MISSING if missing else 0


def add_target_options(parser: argparse.ArgumentParser, option: str, help: str) -> None:  # noqa: A002
    """Add the option that names the other store, and those with its login.

    Args:
        option: '--to', or another name; its value is ``options.target``, None = not given.
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
        options: ``target`` is given.
        make: The keyspace may be missing there.
    """
    host, port, keyspace = read_address(options.target, options.keyspace)
    place = {"host": host, "port": port, "keyspace": keyspace}
    login = {"cqlshrc": options.to_cqlshrc, "credentials": options.to_credentials}
    # What is written must be acknowledged by a quorum, however the source is read. The run and the
    # times are of the source.
    others = {"consistency": DEFAULT_CONSISTENCY, "run": None, "time_options": ()}
    return open_store(argparse.Namespace(**{**vars(options), **place, **login, **others}), make)
