# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Fetch Cassandra's jars with Maven, whole or not at all."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Callable

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server.paths import cassandra_version, jars_directory, pom_file
from cassandra_ros.local_server.processes import locked

_MARKER = "complete"
_ATTEMPTS = 4
_PAUSE_SEC = 5
_ATTEMPT_TIMEOUT_SEC = 1200
_NEEDED_BYTES = 200 << 20


def jars_installed() -> bool:
    """Tell whether the jars are there, complete, and those that server/pom.xml names."""
    try:
        return (jars_directory() / _MARKER).read_text(encoding="utf-8") == _pom_digest()
    except OSError:
        return False


def install_jars(say: Callable[[str], None]) -> bool:
    """Fetch the jars of Cassandra where they are missing.

    Args:
        say: Gets one line of text for each step.

    Returns:
        True when they were fetched, False when they were there.

    Raises:
        ServerError: Maven is missing, or the download failed again and again.
    """
    directory = jars_directory()
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        with locked(directory.parent / f".{directory.name}.lock"):
            if jars_installed():
                return False
            _fetch(directory, say)
    except OSError as exc:
        raise ServerError(f"Cassandra's jars cannot be kept in {directory}: {exc}") from exc
    return True


def _fetch(directory: Path, say: Callable[[str], None]) -> None:
    maven = shutil.which("mvn")
    if maven is None:
        raise ServerError(
            "Maven fetches Cassandra's jars and is not installed; "
            "install it with: sudo apt-get install maven"
        )
    free = shutil.disk_usage(directory.parent).free
    if free < _NEEDED_BYTES:
        raise ServerError(
            f"no space for Cassandra's jars: {directory.parent} has {free >> 20} MiB free, "
            f"{_NEEDED_BYTES >> 20} MiB are needed"
        )
    say(f"fetching Apache Cassandra {cassandra_version()} with Maven into {directory}")
    draft = Path(tempfile.mkdtemp(prefix=f".{directory.name}-", dir=directory.parent))
    try:
        _run_maven(maven, draft, say)
        if not any(draft.glob(f"cassandra-all-{cassandra_version()}.jar")):
            raise ServerError("Maven ended without error and fetched no cassandra-all jar")
        (draft / _MARKER).write_text(_pom_digest(), encoding="utf-8")
        draft.chmod(0o755)
        shutil.rmtree(directory, ignore_errors=True)
        os.replace(draft, directory)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _run_maven(maven: str, target: Path, say: Callable[[str], None]) -> None:
    command = [maven, "-B", "-q", "-f", str(pom_file()), "dependency:copy-dependencies"]
    command += ["-DincludeScope=runtime", f"-DoutputDirectory={target}"]
    output = ""
    for attempt in range(1, _ATTEMPTS + 1):
        # -U: Maven remembers a failed download for a day and would not even try again.
        done, output = _attempt([*command, "-U"] if attempt > 1 else command)
        if done:
            return
        if attempt < _ATTEMPTS:
            say(f"attempt {attempt} of {_ATTEMPTS} failed ({_first_error(output)}); again soon")
            time.sleep(_PAUSE_SEC * attempt)
    raise ServerError(
        f"Maven could not fetch Cassandra {_ATTEMPTS} times; its last lines:\n"
        + "\n".join(output.strip().splitlines()[-12:])
        + "\nCheck the network (a proxy belongs in ~/.m2/settings.xml) and try again."
    )


def _attempt(command: list[str]) -> tuple[bool, str]:
    """Run Maven once; return whether it succeeded, and what it printed."""
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=_ATTEMPT_TIMEOUT_SEC,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False, f"[ERROR] no end after {_ATTEMPT_TIMEOUT_SEC} s"
    return done.returncode == 0, done.stdout


def _first_error(output: str) -> str:
    for line in output.splitlines():
        if "ERROR" in line:
            return line.replace("[ERROR]", "").strip()[:160]
    return "no reason given"


def _pom_digest() -> str:
    return hashlib.sha256(pom_file().read_bytes()).hexdigest()


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
