# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Find a Java that runs Cassandra 5.0: version 17, for 21 has no security manager any more."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

from cassandra_ros.errors import ServerError

JAVA_VERSION = 17
_JVM_ROOT = Path("/usr/lib/jvm")


def find_java() -> str:
    """Return the path of a `java` of version 17.

    $JAVA_HOME is asked first, then PATH, then Debian's folder of all Java versions.

    Raises:
        ServerError: There is no Java, or only other versions.
    """
    found = {}
    for path in _candidates():
        version = java_version(path)
        if version == JAVA_VERSION:
            return path
        if version:
            found[path] = version
    remedy = f"install it with: sudo apt-get install openjdk-{JAVA_VERSION}-jre-headless"
    if found:
        seen = ", ".join(f"Java {version} at {path}" for path, version in found.items())
        raise ServerError(f"Cassandra needs Java {JAVA_VERSION}; there is only {seen}; {remedy}")
    raise ServerError(f"Cassandra needs Java {JAVA_VERSION} and no java was found; {remedy}")


def java_version(path: str) -> int:
    """Return the major version of a `java`, 0 where it does not run."""
    try:
        done = subprocess.run(
            [path, "-version"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return 0
    found = re.search(r'version "(?:1\.)?(\d+)', done.stderr + done.stdout)
    return int(found.group(1)) if found else 0


def _candidates() -> list[str]:
    places = []
    if os.environ.get("JAVA_HOME"):
        places.append(os.path.join(os.environ["JAVA_HOME"], "bin", "java"))
    on_path = shutil.which("java")
    if on_path:
        places.append(on_path)
    places += [str(path) for path in sorted(_JVM_ROOT.glob(f"*{JAVA_VERSION}*/bin/java"))]
    return [path for path in dict.fromkeys(places) if os.access(path, os.X_OK)]
