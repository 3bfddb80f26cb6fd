# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The free space of a store on this machine, checked as rosbag record checks its disk."""

from __future__ import annotations

import logging
from typing import Callable

_log = logging.getLogger(__name__)

WARN_FACTOR = 5
"""Multiple of the minimum space below which a warning is logged."""


class SpaceGuard:
    """A check whether the store has enough free space for more messages.

    Args:
        free_space: Returns the free space, bytes, or None if it is not known now. None = the free
            space is never known.
        minimum: Minimum free space, bytes.
    """

    def __init__(self, free_space: Callable[[], int | None] | None, minimum: int) -> None:
        self._free_space, self._minimum = free_space, minimum
        self._warned = False

    def refusal(self) -> str:
        """Return the reason why no message may be stored now; '' = messages may be stored."""
        if self._free_space is None or not self._minimum:
            return ""
        try:
            free = self._free_space()
        except OSError as exc:
            _log.warning("the free space of the store is not known: %s", exc)
            return ""
        if free is None:
            return ""
        sizes = f"{free >> 20} MB are free where the store keeps its data"
        if free < self._minimum:
            return f"{sizes}, less than {self._minimum >> 20} MB (option --min-space)"
        if free < WARN_FACTOR * self._minimum and not self._warned:
            self._warned = True
            _log.warning("only %s; below %d MB no message is stored", sizes, self._minimum >> 20)
        return ""
