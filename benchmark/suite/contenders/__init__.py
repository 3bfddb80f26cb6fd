# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The contenders, by name."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Callable

from suite.contenders.bare import Bare
from suite.contenders.contender import Contender, NotEqual, verify
from suite.contenders.mcaps import Mcap, McapObjects
from suite.contenders.rosbags import Rosbag, RosbagBz2, RosbagObjects
from suite.contenders.sqlite import Sqlite
from suite.contenders.store import FORMAT_NAMES, Store, StoreImport, folder_bag
from suite.messages import Batch
from suite.server import Server

Make = Callable[[Batch, Path], Contender]

__all__ = [
    "FORMAT_NAMES",
    "Bare",
    "Contender",
    "Make",
    "Mcap",
    "NotEqual",
    "Rosbag",
    "RosbagBz2",
    "Sqlite",
    "Store",
    "StoreImport",
    "all_contenders",
    "folder_bag",
    "verify",
]


def all_contenders(server: Server) -> dict[str, Make]:
    """Return what makes each contender that writes and reads, by name."""
    found: dict[str, Make] = {"rosbag": Rosbag, "rosbag objects": RosbagObjects}
    found.update({"mcap": Mcap, "mcap objects": McapObjects, "sqlite": Sqlite})
    for name in FORMAT_NAMES:
        found[name] = functools.partial(Store, server=server, format=name)
        found[f"{name} import"] = functools.partial(StoreImport, server=server, format=name)
    found["bare driver"] = functools.partial(Bare, server=server)
    return found
