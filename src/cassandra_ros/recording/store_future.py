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
"""The catalog of a connected keyspace, or a future of it."""
NO_STORE = "the store did not answer before the recording ended"
"""Reason for which messages are lost."""


def store_future(store: Store) -> Future[Catalog]:
    """Return a future of a store; that of a connected keyspace is done."""
    if isinstance(store, Future):
        return store
    done: Future[Catalog] = Future()
    done.set_result(store)
    return done


def then(first: Future[_T], work: Callable[[_T], _U]) -> Future[_U]:
    """Return a future of what ``work`` returns for the result of ``first``, or of its error.

    ``work`` is called on the thread that ends ``first``, or here if that is done.
    """
    following: Future[_U] = Future()

    def finish(done: Future[_T]) -> None:
        try:
            following.set_result(work(done.result()))
        except Exception as exc:  # noqa: BLE001 - raised where the result is used
            following.set_exception(exc)

    first.add_done_callback(finish)
    return following


def is_there(store: Future[_T]) -> bool:
    """Return whether a store is connected, so that ``result`` neither waits nor raises."""
    return store.done() and store.exception() is None


def failure_of(store: Future[_T]) -> str:
    """Return why a store will never be connected; '' = it is connected, or may be later."""
    exc = store.exception() if store.done() else None
    return "" if exc is None else str(exc)
