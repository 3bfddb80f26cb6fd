# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Clients in processes of their own, which are told what to do line by line."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


class Child:
    def __init__(self, process):
        self.process = process
        assert self.hear() == "ready"

    def say(self, *words):
        self.process.stdin.write(json.dumps(words) + "\n")
        self.process.stdin.flush()

    def hear(self):
        return self.process.stdout.readline().rstrip("\n")

    def answer(self):
        """Return what it answers; before that it may tell how far it is."""
        while "done" in (line := json.loads(self.hear())):
            pass
        return line


@contextmanager
def children(count, cassandra, keyspace, ended_by=0):
    """Start clients that are connected; they end with their stdin.

    Args:
        ended_by: Their return code; -SIGKILL where the test kills them.
    """
    arguments = [cassandra.host, str(cassandra.port), keyspace]
    processes = [
        subprocess.Popen(
            [sys.executable, str(ROOT / "test/topics/writing_process.py"), *arguments],
            env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(count)
    ]
    # A client that hangs fails the test by its silence.
    patience = threading.Timer(600, lambda: [process.kill() for process in processes])
    patience.start()
    try:
        yield [Child(process) for process in processes]
        for process in processes:
            process.stdin.close()
            assert process.wait(300) == ended_by
    finally:
        patience.cancel()
        for process in processes:
            process.kill()
            process.wait()
