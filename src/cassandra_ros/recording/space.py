# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The free space of a store on this machine, as rosbag record watches that of its disk."""

from __future__ import annotations

import logging
from typing import Callable, Optional

_log = logging.getLogger(__name__)

WARN_FACTOR = 5
"""Below so many times the least space it is warned of."""


class SpaceGuard:
    """Says whether there is room to go on.

    Args:
        free_space: Tells how many bytes are free, None = it is not known now; None = never.
        least: Bytes that must stay free.
    """

    def __init__(self, free_space: Optional[Callable[[], Optional[int]]], least: int) -> None:
        self._free_space, self._least = free_space, least
        self._warned = False

    def refusal(self) -> str:
        """Return why nothing may be stored now; '' = it may."""
        if self._free_space is None or not self._least:
            return ""
        try:
            free = self._free_space()
        except OSError as exc:
            _log.warning("the free space of the store is not known: %s", exc)
            return ""
        if free is None:
            return ""
        sizes = f"{free >> 20} MB are free where the store keeps its data"
        if free < self._least:
            return f"{sizes}, less than {self._least >> 20} MB (option --min-space)"
        if free < WARN_FACTOR * self._least and not self._warned:
            self._warned = True
            _log.warning("only %s; below %d MB nothing is stored", sizes, self._least >> 20)
        return ""
