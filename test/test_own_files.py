# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Files at places where other users may have made one: never waited for, followed or shared."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from other_user import NOBODY, refusal_of

from cassandra_ros import own_files
from cassandra_ros.cli.results import open_output
from cassandra_ros.errors import ServerError
from cassandra_ros.local_server.cluster_settings import SETTINGS_FILE, load_settings
from cassandra_ros.local_server.processes import locked
from cassandra_ros.viewing.download_cache import DownloadCache

HOLDER = (
    "import fcntl, sys, time; file = open(sys.argv[1]); fcntl.flock(file, fcntl.LOCK_EX);"
    "print('locked', flush=True); time.sleep(600)"
)


@pytest.fixture
def shared():
    """A folder like /tmp, that every user can write to."""
    folder = Path(tempfile.mkdtemp(prefix="cassandra_ros_shared_"))
    folder.chmod(0o1777)
    yield folder
    shutil.rmtree(folder)


@pytest.mark.parametrize("name", ["fifo", "link", "socket"])
def test_what_is_no_file_is_neither_waited_for_nor_followed(tmp_path, name):
    path, target = tmp_path / name, tmp_path / "target"
    target.touch()
    if name == "fifo":
        os.mkfifo(path)
    elif name == "link":
        path.symlink_to(target)
    else:
        os.mknod(path, 0o140600)
    for flags in (os.O_RDONLY, os.O_RDWR | os.O_CREAT):
        with pytest.raises(OSError, match="it is not an ordinary file"):
            own_files.open_regular(path, flags)
    with pytest.raises(ServerError, match="it is not an ordinary file"):
        with locked(path):
            pass


def test_a_fifo_instead_of_the_settings_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / SETTINGS_FILE)
    with pytest.raises(ServerError, match="it is not an ordinary file"):
        load_settings(tmp_path)


def test_folders_that_look_like_those_of_killed_viewers_are_left(shared):
    """Each is old enough to be removed: one with a FIFO, a link to a folder, one of our own."""
    victim = shared / "victim"
    victim.mkdir()
    (victim / "lock").touch()
    fifo, killed = (shared / f"cassandra_ros_viewer_{name}" for name in ("fifo", "killed"))
    for folder in (fifo, killed):
        folder.mkdir()
    os.mkfifo(fifo / "lock")
    (killed / "lock").touch()
    link = shared / "cassandra_ros_viewer_link"
    link.symlink_to(victim)
    for folder in (fifo, killed, victim):
        os.utime(folder / "lock", (1, 1))
    cache = DownloadCache(shared, 1000, 8)
    try:
        assert not killed.exists()
        assert fifo.exists() and (victim / "lock").exists()
    finally:
        cache.close()


def test_a_lock_file_is_closed_to_other_users(shared):
    path = shared / "lock"
    path.touch(0o644)
    path.chmod(0o644)
    with locked(path):
        assert path.stat().st_mode & 0o777 == 0o600
        if os.geteuid() == 0:
            assert "Permission denied" in refusal_of(open, path)
    os.close(own_files.lock_own(shared / "new"))
    assert (shared / "new").stat().st_mode & 0o777 == 0o600


def test_a_lock_names_its_holder_and_is_waited_for_in_vain_for_a_bounded_time(tmp_path):
    path = tmp_path / "lock"
    path.touch()
    with subprocess.Popen([sys.executable, "-c", HOLDER, path], stdout=subprocess.PIPE) as holder:
        try:
            assert holder.stdout.readline() == b"locked\n"
            said = []
            while not said:  # a busy machine may let the time go by before it is said
                with pytest.raises(ServerError, match=rf"locked by .*\(pid {holder.pid}\) after"):
                    with locked(path, lambda text, seconds: said.append(text), 0.2):
                        pass
            assert f"(pid {holder.pid}), which has locked {path}" in said[0]
        finally:
            holder.kill()
    with locked(path, limit_sec=180):
        pass


def test_files_and_folders_of_another_user_are_refused(shared):
    owner = os.geteuid()
    path, folder = Path("/etc/passwd"), Path("/usr")  # those of root
    assert "it belongs to the user root" in refusal_of(own_files.open_own, path, os.O_RDONLY)
    assert "it belongs to the user root" in refusal_of(own_files.own_folder, folder)
    own_files.own_folder(shared / "own")
    assert (shared / "own").stat().st_mode & 0o777 == 0o700
    (shared / "link").symlink_to(shared / "own")
    own_files.own_folder(shared / "link")
    if owner == 0:  # who could be tricked the worst
        os.lchown(shared / "link", NOBODY, NOBODY)
        with pytest.raises(OSError, match="it is not a folder"):
            own_files.own_folder(shared / "link")


def test_a_file_with_a_second_name_is_refused(tmp_path):
    (tmp_path / "victim").touch(0o644)
    os.link(tmp_path / "victim", tmp_path / "lock")
    with pytest.raises(OSError, match="it has a second name"):
        own_files.lock_own(tmp_path / "lock")
    assert (tmp_path / "victim").stat().st_mode & 0o777 == 0o644


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: os.symlink("victim", path)])
def test_a_file_that_is_being_written_is_always_a_new_one(tmp_path, make):
    (tmp_path / "victim").write_text("kept")
    make(tmp_path / "out.txt.active")
    with open_output(str(tmp_path / "out.txt"), force=False, binary=False) as stream:
        stream.write("all")
    assert (tmp_path / "out.txt").read_text() == "all"
    assert (tmp_path / "victim").read_text() == "kept"


@pytest.mark.parametrize("sync", [True, False])
@pytest.mark.parametrize("private", [True, False])
def test_a_whole_file_has_its_name_only_when_it_is_complete(tmp_path, private, sync):
    path = tmp_path / "a.json"
    path.write_text("old")
    path.chmod(0o644)
    with pytest.raises(RuntimeError, match="in the block"):
        with own_files.whole_file(path, private=private, sync=sync) as file:
            file.write(b"half")
            raise RuntimeError("in the block")
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["a.json"]
    draft = tmp_path / "draft"
    with own_files.whole_file(path, draft, private=private, sync=sync) as file:
        file.write(b"new")
        assert path.read_text() == "old"
        (tmp_path / "plain").touch()  # with the rights that the umask says
        assert draft.stat().st_mode == (
            0o100600 if private else (tmp_path / "plain").stat().st_mode
        )
        (tmp_path / "plain").unlink()
    assert path.read_text() == "new" and os.listdir(tmp_path) == ["a.json"]


def test_what_went_into_a_pipe_before_an_error_arrives(tmp_path):
    """A pipe is no file: it gets the rows before the error, and keeps its name."""
    os.mkfifo(tmp_path / "pipe")
    with subprocess.Popen(["cat", tmp_path / "pipe"], stdout=subprocess.PIPE) as reader:
        with pytest.raises(RuntimeError, match="in the block"):
            with open_output(str(tmp_path / "pipe"), force=False, binary=False) as stream:
                stream.write("a row\n")
                raise RuntimeError("in the block")
        assert reader.stdout.read() == b"a row\n"
    assert os.listdir(tmp_path) == ["pipe"]
