# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Installed message types, of which several threads may ask at once."""

from __future__ import annotations

import sys
import threading
import time

from cassandra_ros.messages.definition import installed_class

CLASS = """
import slow_msgs.msg

class {0}:
    _type = "slow_msgs/{0}"
"""


def test_types_of_one_package_are_asked_for_by_two_threads(tmp_path, monkeypatch):
    """Their package is whole afterwards: Python lets a deadlock of imports leave names out."""
    folder = tmp_path / "slow_msgs/msg"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").touch()
    for name in "AB":
        (folder / f"_{name}.py").write_text(CLASS.format(name))
    wait = "import time; time.sleep(0.5)"
    (folder / "__init__.py").write_text(f"from ._A import *\n{wait}\nfrom ._B import *\n")
    monkeypatch.syspath_prepend(tmp_path)
    classes = {}
    threads = [
        threading.Thread(target=lambda n=n: classes.update({n: installed_class(f"slow_msgs/{n}")}))
        for n in "AB"
    ]
    threads[0].start()
    time.sleep(0.2)
    threads[1].start()
    for thread in threads:
        thread.join()
    package = sys.modules["slow_msgs.msg"]
    assert (package.A, package.B) == (classes["A"], classes["B"])
