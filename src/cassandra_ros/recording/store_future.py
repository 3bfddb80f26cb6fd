# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A store that may not answer yet: a future of the catalog of the connected keyspace."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Callable, TypeVar, Union

from cassandra_ros.topics.catalog import Catalog

_T = TypeVar("_T")
_U = TypeVar("_U")
Store = Union[Catalog, "Future[Catalog]"]
NO_STORE = "the store did not answer before the recording ended"


def store_future(store: Store) -> Future[Catalog]:
    """Return a future of a store; that of a connected keyspace is done."""
    if isinstance(store, Future):
        return store
    done: Future[Catalog] = Future()
    done.set_result(store)
    return done


def then(first: Future[_T], take: Callable[[_T], _U]) -> Future[_U]:
    """Return a future of what ``take`` makes of the result of another future, or its error."""
    following: Future[_U] = Future()

    def settle(done: Future[_T]) -> None:
        try:
            following.set_result(take(done.result()))
        except Exception as exc:  # noqa: BLE001 - raised where the result is used
            following.set_exception(exc)

    first.add_done_callback(settle)
    return following


def is_there(store: Future[_T]) -> bool:
    """Say whether a store is connected."""
    return store.done() and store.exception() is None


def failure_of(store: Future[_T]) -> str:
    """Say why a store will not be connected any more; '' = it is, or may be."""
    exc = store.exception() if store.done() else None
    return "" if exc is None else str(exc)
