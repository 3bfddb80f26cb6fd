# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What to say when no message lies at a key: where the nearest is, what was perhaps meant."""

from __future__ import annotations

from typing import Any, Optional

from cassandra_ros.messages.stamps import isoTime, toNs

_SECONDS_BELOW = 10**12
_NEAR_NS = 256
"""Nanoseconds that a time of today may lose on its way through a float."""


def absentText(
    topic: str, key: Any, nearest: Optional[str], which: str, near_ns: Optional[int]
) -> str:
    """Say that a topic has no message at a key.

    Args:
        topic: Its name.
        key: The time as it was asked for.
        nearest: The direction that was asked for, or None.
        which: Which messages were asked for, as ' of node r1'; '' = any.
        near_ns: Time of the nearest message where that is known, ns.
    """
    t = toNs(key)
    text = f"topic {topic} has no message{which} {nearest or 'at'} {isoTime(t)} ({t} ns)"
    if isinstance(key, int) and 0 < t < _SECONDS_BELOW:
        return text + "; integers are nanoseconds; did you mean seconds (a float)?"
    if near_ns is None:
        return text
    if abs(near_ns - t) <= _NEAR_NS:
        secs, nsecs = divmod(near_ns, 10**9)
        return text + (
            f"; one lies {abs(near_ns - t)} ns away: write the time as "
            f"{{secs: {secs}, nsecs: {nsecs}}}, for a number goes through a float"
        )
    return text + f"; the nearest lies at {isoTime(near_ns)} ({near_ns} ns)"


def absentName(topic: str, key: Any, which: str, named: bool) -> str:
    """Say that a topic has no message under a name, or none with a value.

    Args:
        topic: Its name.
        key: As it was asked for.
        which: Which messages were asked for, as ' of node r1'; '' = any.
        named: Whether it is a name.
    """
    if not named:
        return f"topic {topic} has no message{which} whose key field is {key!r:.80}"
    return (
        f"topic {topic} has no message{which} under the name {str(key)[:80]!r}; "
        "items() lists the names that there are"
    )
