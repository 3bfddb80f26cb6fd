# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A store that may not answer yet: a future of the connected RosCassandra."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Union

from cassandra_ros.client.ros_cassandra import RosCassandra

Store = Union[RosCassandra, "Future[RosCassandra]"]
NO_STORE = "the store did not answer before the recording ended"


def store_future(store: Store) -> Future[RosCassandra]:
    """Return a future of a store; that of a connected RosCassandra is done."""
    if isinstance(store, Future):
        return store
    done: Future[RosCassandra] = Future()
    done.set_result(store)
    return done


def is_there(store: Future[RosCassandra]) -> bool:
    """Say whether a store is connected."""
    return store.done() and store.exception() is None


def failure_of(store: Future[RosCassandra]) -> str:
    """Say why a store will not be connected any more; '' = it is, or may be."""
    exc = store.exception() if store.done() else None
    return "" if exc is None else str(exc)
