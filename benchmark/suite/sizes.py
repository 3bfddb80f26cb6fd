# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How much is measured: all of it, little of it, or so little that only its correctness shows."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Size:
    """Counts of a run."""

    counts: dict[str, int]
    """Messages of each kind that are written and read back."""
    warm_ups: int
    """Rounds that do not count, for the server's Java to warm up."""
    rounds: int
    """Measured ones."""
    long_rounds: int
    """Measured rounds for scans, images and clouds, whose times differ most."""
    steps: tuple[int, ...]
    """Messages stored in the growing tables (fig. 5, 6, 7); the last is the largest."""
    lookups: int
    slow_lookups: int
    """Where one takes long: a bag of the largest step."""
    condition_messages: int
    condition_rounds: int
    clauses: int
    """Random WHERE clauses (fig. 7)."""
    bag_bytes: int
    """Real bags are repeated until they have so many wire bytes."""
    bag_messages: int | None
    """Number of messages of the first bag alone; None = all messages of all bags."""
    writers: tuple[int, ...]
    writer_messages: int
    """Number of messages of each writer."""
    rates: tuple[int, ...]
    """Messages a second that recorders are tried with, ascending."""
    image_rates: tuple[int, ...]
    """Images of 2 MB a second."""
    live_sec: float
    program_runs: int
    """Starts of each program."""
    table_steps: tuple[int, ...]
    """Numbers of topics in a keyspace at which the making of tables is measured, ascending."""
    starts: int
    """Starts of a local Cassandra and runs of make setup."""
    nodes: int
    """Number of nodes of the cluster; 0 = the server that runs anyway."""
    cluster_messages: int


FULL = Size(
    # Of images and clouds some seconds: an import makes two tables before the first one.
    counts={
        "paper": 100_000,
        "imu": 100_000,
        "tf": 40_000,
        "joints": 60_000,
        "scan": 4_000,
        "image": 300,
        "cloud": 240,
    },
    warm_ups=1,
    rounds=3,
    long_rounds=5,
    steps=(100, 1_000, 10_000, 100_000, 1_000_000),
    lookups=1_000,
    slow_lookups=50,
    condition_messages=1_000_000,
    condition_rounds=2,
    clauses=24,
    bag_bytes=16 << 20,
    bag_messages=None,
    writers=(1, 2, 4),
    writer_messages=60_000,
    rates=(5_000, 10_000, 20_000, 40_000),
    image_rates=(10, 30),
    live_sec=8.0,
    program_runs=7,
    table_steps=(10, 100, 600),
    starts=3,
    nodes=3,
    cluster_messages=60_000,
)
QUICK = Size(
    counts={
        "paper": 5_000,
        "imu": 5_000,
        "tf": 2_000,
        "joints": 3_000,
        "scan": 500,
        "image": 12,
        "cloud": 10,
    },
    warm_ups=1,
    rounds=1,
    long_rounds=1,
    steps=(100, 1_000, 10_000),
    lookups=100,
    slow_lookups=20,
    condition_messages=50_000,
    condition_rounds=1,
    clauses=8,
    bag_bytes=2 << 20,
    bag_messages=None,
    writers=(1, 2),
    writer_messages=5_000,
    rates=(5_000,),
    image_rates=(10,),
    live_sec=3.0,
    program_runs=3,
    table_steps=(10, 100),
    starts=1,
    nodes=3,
    cluster_messages=5_000,
)
SMOKE = Size(
    counts={"paper": 300, "tf": 100, "image": 2},
    warm_ups=0,
    rounds=1,
    long_rounds=1,
    steps=(100, 1_000),
    lookups=3,
    slow_lookups=2,
    condition_messages=2_000,
    condition_rounds=1,
    clauses=3,
    bag_bytes=1,
    bag_messages=300,
    writers=(2,),
    writer_messages=200,
    rates=(500,),
    image_rates=(),
    live_sec=0.4,
    program_runs=1,
    table_steps=(10,),
    starts=0,
    nodes=0,
    cluster_messages=200,
)
SIZES = {"full": FULL, "quick": QUICK, "smoke": SMOKE}
