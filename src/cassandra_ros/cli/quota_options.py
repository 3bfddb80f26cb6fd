# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The maximum size of a store that recorder and replicator keep while they run."""

from __future__ import annotations

import argparse
from typing import Callable

from cassandra_ros.cli.parsers import Rare
from cassandra_ros.cli.readers import byte_size


def add_quota_options(add: Callable[..., object]) -> None:
    """Add --max-size and --drop-uncopied.

    Args:
        add: ``add_argument`` of the parser or of a group.
    """
    add(
        "--max-size",
        metavar="SIZE",
        type=byte_size,
        default=0,
        help=Rare(
            "keep the topics of the store under this size, as 20G: what another store has is "
            "deleted, oldest first; above 80 %% of what no other store has, /diagnostics warns "
            "(default: no maximum)"
        ),
    )
    add(
        "--drop-uncopied",
        action="store_true",
        help=Rare(
            "with --max-size: also delete what no other store has, as a loss, if there is no "
            "other way"
        ),
    )


def check_quota_options(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """End the program if the options contradict each other."""
    if options.drop_uncopied and not options.max_size:
        parser.error("--drop-uncopied needs --max-size")
