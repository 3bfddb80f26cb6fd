# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Find Java and Cassandra's jars, and download the jars with Maven, completely or not at all."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
import time
from pathlib import Path
from typing import Callable

from cassandra_ros.errors import ServerError
from cassandra_ros.installation import home_folder
from cassandra_ros.local_server.processes import locked, run_program

_MARKER = "complete"
_ATTEMPTS = 4
_PAUSE_SEC = 5
_ATTEMPT_TIMEOUT_SEC = 1200
_NEEDED_BYTES = 200 << 20
JAVA_VERSION = 17
_JVM_ROOT = Path("/usr/lib/jvm")


def default_directory() -> Path:
    """Return the default directory of the local Cassandra.

    It is $CASSANDRA_ROS_DIR, else a folder in the ROS home.
    """
    named = os.environ.get("CASSANDRA_ROS_DIR")
    return Path(named) if named else home_folder()


def jars_directory() -> Path:
    """Return the folder of Cassandra's jars, which all local clusters of a user share.

    $CASSANDRA_ROS_JARS names another folder, for example one that several users share.
    """
    named = os.environ.get("CASSANDRA_ROS_JARS")
    return Path(named) if named else home_folder() / "jars" / cassandra_version()


def server_file(name: str) -> Path:
    """Return the path of a file of server/ in the source tree, devel space or install space."""
    here = Path(__file__).absolute()
    for parent in here.parents:
        for place in (parent / "server", parent / "share" / "cassandra_ros" / "server"):
            if (place / name).is_file():
                return place / name
    raise ServerError(
        f"server/{name}, which the local Cassandra needs, is in no folder above {here}; "
        "the package is not completely installed: build it again with catkin_make"
    )


def cassandra_version() -> str:
    """Return the version of Cassandra that server/pom.xml names."""
    pom = server_file("pom.xml")
    found = re.search(r"<cassandra\.version>([\w.-]+)</", pom.read_text(encoding="utf-8"))
    if not found:
        raise ServerError(f"{pom} names no cassandra.version; restore the file")
    return found.group(1)


def jars_installed() -> bool:
    """Return whether all jars that server/pom.xml names are installed."""
    try:
        return (jars_directory() / _MARKER).read_text(encoding="utf-8") == _pom_digest()
    except OSError:
        return False


def install_jars(say: Callable[[str], None]) -> bool:
    """Download Cassandra's jars if they are missing; return whether they were missing.

    Raises:
        ServerError: Maven is missing, all attempts to download failed, or the disk is full.
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
    command = [maven, "-B", "-q", "-f", str(server_file("pom.xml")), "dependency:copy-dependencies"]
    command += ["-DincludeScope=runtime", f"-DoutputDirectory={target}"]
    for attempt in range(1, _ATTEMPTS + 1):
        status, output = run_program(command, _ATTEMPT_TIMEOUT_SEC)
        if status == 0:
            return
        if attempt < _ATTEMPTS:
            error = re.search(r"^.*ERROR.*$", output, re.MULTILINE)
            reason = error[0].replace("[ERROR]", "").strip() if error else "no reason given"
            say(f"attempt {attempt} of {_ATTEMPTS} failed ({reason[:160]}); again soon")
            time.sleep(_PAUSE_SEC * attempt)
        # Maven remembers a failed download for a day, and would not try it again before.
        command = [*command, "-U"] if attempt == 1 else command
    raise ServerError(
        f"Maven could not fetch Cassandra {_ATTEMPTS} times; its last lines:\n"
        + "\n".join(output.strip().splitlines()[-12:])
        + "\nCheck the network (a proxy belongs in ~/.m2/settings.xml) and try again."
    )


def _pom_digest() -> str:
    return hashlib.sha256(server_file("pom.xml").read_bytes()).hexdigest()


def find_java() -> str:
    """Return the path of a `java` of version 17.

    $JAVA_HOME is searched first, then PATH, then Debian's folder of all Java versions.
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
    """Return the major version of a `java`; 0 = it cannot be run."""
    found = re.search(r'version "(?:1\.)?(\d+)', run_program([path, "-version"], 30)[1])
    return int(found.group(1)) if found else 0


def _candidates() -> list[str]:
    home = os.environ.get("JAVA_HOME")
    places = [os.path.join(home, "bin", "java")] if home else []
    places.append(shutil.which("java") or "")
    places += [str(path) for path in sorted(_JVM_ROOT.glob(f"*{JAVA_VERSION}*/bin/java"))]
    return [path for path in dict.fromkeys(places) if os.access(path, os.X_OK)]
