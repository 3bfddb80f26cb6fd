# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Progress of work on messages: a bar on a terminal, nothing elsewhere."""

from __future__ import annotations

from types import TracebackType

from tqdm import tqdm


class MessageBar:
    """Shows how many messages are done, from the second second on; a context manager.

    Args:
        text: What is being done.
        total: Messages in all; None where it is not known.
    """

    def __init__(self, text: str, total: int | None = None) -> None:
        # disable=None: only where standard error is a terminal.
        self._bar = tqdm(
            desc=text,
            total=total,
            unit=" msg",
            unit_scale=True,
            delay=1.0,
            leave=False,
            disable=None,
        )

    def add(self, messages: int, size: int = 0) -> None:
        """Count messages as done."""
        self._bar.update(messages)

    def reach(self, messages: int, total: int) -> None:
        """Say how many messages are done, of how many."""
        self._bar.total = total
        self._bar.update(messages - self._bar.n)

    def __enter__(self) -> MessageBar:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bar.close()
