# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Calls as another user, who is not root."""

from __future__ import annotations

import os

NOBODY = 65534


def refusal_of(function, *arguments):
    """What a user without root gets when it calls a function; '' = it is not refused."""
    reading, writing = os.pipe()
    pid = os.fork()
    if not pid:
        text, status = "", 1
        try:
            if os.geteuid() == 0:
                os.setgroups([])
                os.setgid(NOBODY)
                os.setuid(NOBODY)
            function(*arguments)
            status = 0
        except (OSError, AssertionError) as exc:
            text, status = str(exc) or repr(exc), 0
        finally:
            os.write(writing, text.encode())
            os._exit(status)
    os.close(writing)
    with open(reading, "rb") as stream:
        text = stream.read().decode()
    assert os.waitpid(pid, 0)[1] == 0
    return text
