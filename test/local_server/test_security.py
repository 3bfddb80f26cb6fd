# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The files of a cluster's login, without a server."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server import server_security as security
from cassandra_ros.local_server.cluster_settings import ClusterSettings


def test_its_files_are_utf_8_whatever_the_locale(tmp_path):
    code = (
        "import sys; from pathlib import Path; "
        "from cassandra_ros.local_server import server_security; "
        "server_security.write_private(Path(sys.argv[1]), 'gr\\xf6\\xdfe')"
    )
    path = tmp_path / "cqlshrc"
    plain = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    subprocess.run([sys.executable, "-c", code, str(path)], env={**os.environ, **plain}, check=True)
    assert path.read_text(encoding="utf-8") == "größe"
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_keytool_that_does_not_end_is_told_of(tmp_path, monkeypatch):
    monkeypatch.setattr(security, "_KEYTOOL_SEC", 0.1)
    keytool = tmp_path / "keytool"
    keytool.write_text("#!/bin/sh\nexec sleep 60\n")
    keytool.chmod(0o700)
    with pytest.raises(ServerError, match="did not end"):
        security.Security(tmp_path, ClusterSettings("test", 1)).make_files(str(tmp_path / "java"))
