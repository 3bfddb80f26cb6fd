# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Files for browsers: written once for all who wait, ended with the last of them, bounded."""

from __future__ import annotations

import os
import shutil
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from cassandra_ros.errors import BagError, InvalidOption, StoreUnavailable
from cassandra_ros.viewing import download_cache as module
from cassandra_ros.viewing.download_cache import DownloadCache

PATIENCE_SEC = 180


@pytest.fixture
def cache(tmp_path):
    made = DownloadCache(tmp_path, 1000, 8)
    yield made
    made.close()
    assert list(tmp_path.iterdir()) == []


class Writing:
    """A file that is written as far as the test lets it be."""

    def __init__(self, content=b"x" * 10, error=None):
        self.begun, self.ended = threading.Event(), threading.Event()
        self.go = threading.Semaphore(0)
        self.content, self.error = content, error
        self.count = 0

    def __call__(self, path, progress):
        self.count += 1
        active = path.with_name(path.name + ".active")
        self.begun.set()
        try:
            with active.open("wb", 0) as stream:
                for byte in self.content:
                    assert self.go.acquire(timeout=PATIENCE_SEC)
                    stream.write(bytes([byte]))
                    progress(1, module._LOOK_BYTES)
            if self.error is not None:
                raise self.error
            os.replace(active, path)
        finally:
            self.ended.set()

    def let(self, count=None):
        for _ in range(len(self.content) if count is None else count):
            self.go.release()  # Python 3.8 knows no number


def get(cache, writing, key="k", request="r", gone=None):
    with cache.lease(key, request, "a.bag", writing) as lease:
        return lease.wait(gone or threading.Event()).read_bytes()


def test_all_who_wait_get_one_file(cache):
    writing = Writing(b"content")
    with ThreadPoolExecutor(4) as pool:
        asked = [pool.submit(get, cache, writing) for _ in range(4)]
        assert writing.begun.wait(PATIENCE_SEC)
        writing.let()
        assert [each.result(PATIENCE_SEC) for each in asked] == [b"content"] * 4
    assert get(cache, writing) == b"content"
    assert writing.count == 1
    assert cache.latest("r").path.read_bytes() == b"content"
    assert cache.latest("other") is None


def test_the_newest_file_of_a_request_is_the_one_that_was_opened_last(cache):
    for key in ("a", "b"):
        writing = Writing(key.encode())
        writing.let()
        get(cache, writing, key)
    assert cache.latest("r").key == "b"


def test_a_file_without_a_waiting_client_is_not_written_to_its_end(cache):
    writing, first, second = Writing(), threading.Event(), threading.Event()
    with ThreadPoolExecutor(2) as pool:
        asked = [pool.submit(get, cache, writing, gone=gone) for gone in (first, second)]
        assert writing.begun.wait(PATIENCE_SEC)
        writing.let(1)
        first.set()
        with pytest.raises(StoreUnavailable, match="the client does not wait"):
            asked[0].result(PATIENCE_SEC)
        writing.let(1)
        assert not writing.ended.is_set()  # the other one still waits
        second.set()
        with pytest.raises(StoreUnavailable, match="the client does not wait"):
            asked[1].result(PATIENCE_SEC)
    writing.let(1)
    assert writing.ended.wait(PATIENCE_SEC)
    again = Writing(b"again")
    again.let()
    assert get(cache, again) == b"again"


class Closing:
    """A file that is complete, but for being closed."""

    def __init__(self):
        self.begun, self.go = threading.Event(), threading.Event()

    def __call__(self, path, progress):
        path.write_bytes(b"whole")
        self.begun.set()
        assert self.go.wait(PATIENCE_SEC)


def test_who_leaves_when_all_is_written_leaves_it_to_the_next(cache):
    closing = Closing()
    with cache.lease("k", "r", "a.bag", closing) as lease:
        assert closing.begun.wait(PATIENCE_SEC)
    closing.go.set()
    assert lease.done.wait(PATIENCE_SEC)
    never = Writing()
    assert get(cache, never) == b"whole"
    assert never.count == 0


def test_what_is_written_anew_meanwhile_does_not_stay_twice(cache):
    closing, second = Closing(), Writing(b"own")
    with cache.lease("k", "r", "a.bag", closing) as lease:
        assert closing.begun.wait(PATIENCE_SEC)
    second.let()
    assert get(cache, second) == b"own"
    closing.go.set()
    assert lease.done.wait(PATIENCE_SEC)
    assert [path.read_bytes() for path in cache._folder.glob("*/a.bag")] == [b"own"]
    assert get(cache, Writing()) == b"own"


def test_a_folder_that_was_cleaned_up_is_made_again(cache):
    shutil.rmtree(cache._folder)
    writing = Writing(b"a")
    writing.let()
    assert get(cache, writing) == b"a"
    shutil.rmtree(cache._folder)
    cache._folder.touch()
    with pytest.raises(StoreUnavailable, match="no file can be kept in"):
        get(cache, writing, "other")
    cache._folder.unlink()


def test_a_file_that_was_cleaned_up_is_written_again(cache):
    for _ in range(2):
        writing = Writing(b"content")
        writing.let()
        assert get(cache, writing) == b"content"
        cache.latest("r").path.unlink()
        assert cache.latest("r") is None


def test_who_follows_gets_what_is_written_while_it_is(cache):
    writing = Writing(b"ab")
    with cache.lease("k", "r", "a.mcap", writing) as lease:
        chunks = lease.follow(threading.Event())
        writing.let(1)
        assert next(chunks) == b"a"
        writing.let(1)
        assert list(chunks) == [b"b"]
    with cache.lease("k", "r", "a.mcap", writing) as lease:
        assert b"".join(lease.follow(threading.Event())) == b"ab"


def test_who_follows_is_told_what_failed_and_may_leave(cache):
    writing = Writing(b"ab", BagError("the disk is full"))
    with cache.lease("k", "r", "a.mcap", writing) as lease:
        chunks = lease.follow(threading.Event())
        writing.let()
        with pytest.raises(BagError, match="disk is full"):
            list(chunks)
    writing.let()
    with pytest.raises(BagError, match="disk is full"):
        get(cache, writing)
    other, gone = Writing(), threading.Event()
    with cache.lease("l", "r", "a.mcap", other) as lease:
        chunks = lease.follow(gone)
        other.let(1)
        assert next(chunks) == b"x"
        gone.set()
        assert list(chunks) == []
    other.let(1)
    assert other.ended.wait(PATIENCE_SEC)


def test_what_takes_too_much_room_goes_the_oldest_first(cache, monkeypatch):
    monkeypatch.setattr(module, "_KEPT_SEC", -1.0)
    for key in "abc":
        writing = Writing(key.encode() * 400)
        writing.let()
        get(cache, writing, key, request=key)
        if key == "b":
            assert cache.latest("a") is not None  # asked for again: younger than b now
    assert cache.latest("b") is None
    assert {key for key in "abc" if cache.latest(key)} == {"a", "c"}
    large = Writing(b"l" * 1001)
    large.let()
    with pytest.raises(InvalidOption, match="larger than the 1000 bytes.*--cache-size"):
        get(cache, large, "l")
    assert cache.latest("l") is None


def test_what_is_in_use_does_not_go(cache, monkeypatch):
    monkeypatch.setattr(module, "_KEPT_SEC", 600.0)
    first, second = Writing(b"1" * 600), Writing(b"2" * 600)
    first.let()
    second.let()
    get(cache, first, "a")
    with pytest.raises(StoreUnavailable, match="use all of their space on disk: ask again later"):
        get(cache, second, "b")
    assert get(cache, first, "a") == b"1" * 600


def test_what_took_long_to_write_is_opened_before_it_goes(cache, monkeypatch):
    monkeypatch.setattr(module, "_KEPT_SEC", 600.0)
    first, second = Writing(b"1" * 600), Writing(b"2" * 600)
    first.let()
    second.let()
    with cache.lease("a", "a", "a.bag", first) as lease:
        path = lease.wait(threading.Event())
        lease.used -= 2 * module._KEPT_SEC
    with pytest.raises(StoreUnavailable, match="use all of their space"):
        get(cache, second, "b")
    assert path.read_bytes() == b"1" * 600


def test_no_more_than_some_may_wait(tmp_path):
    cache, gone = DownloadCache(tmp_path, 1000, 1), threading.Event()
    writing = Writing()
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(get, cache, writing, gone=gone)
        assert writing.begun.wait(PATIENCE_SEC)
        with pytest.raises(StoreUnavailable, match="1 requests wait for files already"):
            get(cache, Writing(), "other")
        gone.set()
        with pytest.raises(StoreUnavailable, match="the client does not wait"):
            asked.result(PATIENCE_SEC)
    writing.let(1)
    cache.close()
    cache.close()


def test_the_end_does_not_wait_for_what_finds_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_PATIENCE_SEC", 0.01)
    cache, writing, gone = DownloadCache(tmp_path, 1000, 1), Writing(), threading.Event()
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(get, cache, writing, gone=gone)
        assert writing.begun.wait(PATIENCE_SEC)
        gone.set()
        with pytest.raises(StoreUnavailable):
            asked.result(PATIENCE_SEC)
    cache.close()
    assert not writing.ended.is_set()
    assert list(tmp_path.iterdir()) == []
    writing.let(1)
    assert writing.ended.wait(PATIENCE_SEC)


def test_folders_of_viewers_that_were_killed_are_removed(tmp_path, monkeypatch):
    alive = DownloadCache(tmp_path, 1000, 1)
    dead = tmp_path / f"{module._PREFIX}dead"
    dead.mkdir()
    (dead / module._LOCK).touch()
    (dead / "large.bag").touch()
    (tmp_path / f"{module._PREFIX}young").mkdir()
    monkeypatch.setattr(module, "_ORPHAN_SEC", -1.0)
    DownloadCache(tmp_path, 1000, 1).close()
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {alive._folder.name, f"{module._PREFIX}young"}
    alive.close()
    (tmp_path / "file").touch()
    with pytest.raises(InvalidOption, match="no files can be kept in .*file/below: "):
        DownloadCache(tmp_path / "file" / "below", 1000, 1)
