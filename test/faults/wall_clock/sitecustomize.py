# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Sets the wall clock of a Python process: the file CASSANDRA_ROS_FAULTS_CLOCK holds an offset, s.

Python imports it at its start where this folder is in PYTHONPATH. (libfaketime makes time.sleep
fail.) The monotonic clock stays as it is.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

LOOK_SEC = 0.02
_file = Path(os.environ["CASSANDRA_ROS_FAULTS_CLOCK"])
_true_ns = time.time_ns
_offset_ns = 0
_next_look = 0.0


def _time_ns() -> int:
    global _offset_ns, _next_look
    if time.monotonic() >= _next_look:
        _offset_ns = int(_file.read_text() or 0) * 10**9
        _next_look = time.monotonic() + LOOK_SEC
    return _true_ns() + _offset_ns


time.time_ns = _time_ns
time.time = lambda: _time_ns() / 1e9
