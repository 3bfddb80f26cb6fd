# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Errors of class Bag that are also errors of rosbag, for scripts that catch those.

Only a script that has imported rosbag can name rosbag's errors. So we never import rosbag ourselves
(with rospy it takes some 0.5 s).
"""

from __future__ import annotations

import sys
from functools import lru_cache

from cassandra_ros.errors import BagError


def bag_error(text: str) -> BagError:
    """Return a BagError; where rosbag is imported in this process, also a ROSBagException."""
    return _rosbag_error()(text) if "rosbag.bag" in sys.modules else BagError(text)


@lru_cache(maxsize=None)
def _rosbag_error() -> type[BagError]:
    from rosbag.bag import ROSBagException

    class StoredBagError(BagError, ROSBagException):
        """A BagError of class Bag that is also a ROSBagException."""

        __module__, __qualname__ = BagError.__module__, BagError.__qualname__

        @property
        def value(self) -> str:
            """The error text, under the name that rosbag uses."""
            return str(self)

        def __reduce__(self) -> tuple[object, ...]:
            return bag_error, self.args

    return StoredBagError
