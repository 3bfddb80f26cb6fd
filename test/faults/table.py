# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The table of faults: what is done, and what is expected of it."""

from __future__ import annotations

from typing import Callable, NamedTuple

from faults import cluster_faults, copy_faults, recorder_faults, store_faults, verb_faults
from faults.trial import Result, Skipped, Trial
from faults.world import World

SHORT = 5000, 1000.0
"""Messages of the short form, and messages a second of its publishers."""
BAG_FACTOR = 4
"""Bags of the short form have this number of times as many messages."""
LONG = 1_000_000, 5000.0


class Fault(NamedTuple):
    """A line of the table."""

    name: str
    group: str
    function: Callable[[Trial], None]

    @property
    def done(self) -> str:
        """What is done, in words."""
        return " ".join((self.function.__doc__ or "").split())


GROUPS = {
    "recorder": recorder_faults,
    "store": store_faults,
    "verb": verb_faults,
    "copy": copy_faults,
    "cluster": cluster_faults,
}
FAULTS = {
    function.__name__: Fault(function.__name__, group, function)
    for group, module in GROUPS.items()
    for function in module.FAULTS
}


def try_fault(world: World, name: str, messages: int, rate: float, short: bool) -> Result:
    """Run one fault; return its line."""
    if short and FAULTS[name].group == "verb":
        messages *= BAG_FACTOR
    with Trial(world, name, messages, rate, short) as trial:
        try:
            FAULTS[name].function(trial)
        except Skipped as exc:
            trial.result.skipped = str(exc)
            return trial.result
        return trial.finish()
