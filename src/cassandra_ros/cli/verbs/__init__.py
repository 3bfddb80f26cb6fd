# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The verbs of `cassandra_bag`. To add one, add a module here and a line to the table."""

from __future__ import annotations

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

VERBS = {
    "list": list_,
    "info": info,
    "runs": runs,
    "import": import_,
    "export": export,
    "verify": verify,
    "check": check,
    "query": query,
    "sql": sql_,
    "plot": plot,
    "thumbs": thumbs,
    "cat": cat,
    "index": index,
    "convert": convert,
    "copy": copy_,
    "spool": spool_,
    "map": map_,
    "rename": rename,
    "meta": meta,
    "event": event,
    "delete": delete,
    "retention": retention,
    "size": size,
    "roles": roles,
}
