# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The verbs of `cassandra_bag`. To add one, add a module here and a line to the table."""

from __future__ import annotations

from cassandra_ros.cli.verbs import (
    cat,
    check,
    completion,
    convert,
    delete,
    export,
    import_,
    index,
    info,
    keyspaces,
    list_,
    map_,
    meta,
    params,
    plot,
    query,
    rename,
    retention,
    roles,
    runs,
    size,
    thumbs,
    truncate,
    verify,
)

VERBS = {
    "list": list_,
    "info": info,
    "runs": runs,
    "params": params,
    "import": import_,
    "export": export,
    "verify": verify,
    "check": check,
    "query": query,
    "plot": plot,
    "thumbs": thumbs,
    "cat": cat,
    "index": index,
    "convert": convert,
    "map": map_,
    "rename": rename,
    "meta": meta,
    "delete": delete,
    "truncate": truncate,
    "retention": retention,
    "size": size,
    "keyspaces": keyspaces,
    "roles": roles,
    "completion": completion,
}
