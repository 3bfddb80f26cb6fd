# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The verbs of `cassandra_bag`. To add one, add a module here and a line to the table."""

from __future__ import annotations

from cassandra_ros.cli.parsers import VerbGroup
from cassandra_ros.cli.verbs import (
    cat,
    check,
    convert,
    copy_,
    delete,
    event,
    export,
    import_,
    index,
    info,
    list_,
    map_,
    meta,
    plot,
    query,
    rename,
    retention,
    roles,
    runs,
    size,
    spool_,
    sql_,
    thumbs,
    verify,
)

GROUPS = (
    VerbGroup(
        "look at what is stored",
        "cassandra_bag info /tf",
        {"list": list_, "info": info, "runs": runs, "cat": cat, "size": size},
    ),
    VerbGroup(
        "ask",
        "cassandra_bag query 'SELECT KEY, linear.x FROM /cmd_vel WHERE linear.x > 0.5'",
        {"query": query, "sql": sql_, "plot": plot, "thumbs": thumbs, "map": map_},
    ),
    VerbGroup(
        "files and other stores",
        "cassandra_bag import drive.bag",
        {
            "import": import_,
            "export": export,
            "verify": verify,
            "copy": copy_,
            "spool": spool_,
        },
    ),
    VerbGroup(
        "change",
        "cassandra_bag index /cmd_vel linear.x",
        {"index": index, "convert": convert, "rename": rename, "meta": meta, "event": event},
    ),
    VerbGroup(
        "remove",
        "cassandra_bag delete --run test_drive",
        {"delete": delete, "retention": retention},
    ),
    VerbGroup(
        "keep a store in order",
        "cassandra_bag check",
        {"check": check, "roles": roles},
    ),
)
"""The verbs as --help shows them."""
VERBS = {name: verb for group in GROUPS for name, verb in group.verbs.items()}
