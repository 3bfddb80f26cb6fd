# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Installation of the Studio, in which Look shows messages: fetched from npm's registry.

It is the last version of Foxglove Studio under MPL-2.0, with the packages that it needs. This
module has one version of each package, with the hash that npm states for it. Neither npm nor node
is needed. The Studio is not part of this package, and is installed completely or not at all.

The registry is the one that npm is configured for, or its usual one. The configuration is read as
npm reads it: npm_config_registry, then the user's .npmrc and those of the machine. If it names no
registry, packageurl has the address of a package.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import http.client
import json
import os
import re
import shutil
import tarfile
import tempfile
import time
import urllib.request
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Callable, Iterator
from urllib.parse import quote, urlsplit

from cassandra_ros.errors import DownloadFailed, MissingDependency
from cassandra_ros.installation import home_folder, optional_module

_MARKER = "complete.json"
_ATTEMPTS = 4
_PAUSE_SEC = 2.0
_TIMEOUT_SEC = 60.0
_DOWNLOAD_READ_BYTES = 1 << 20
"""Number of bytes of a tarball that are read from the network at once."""
_NEEDED_BYTES = 200 << 20
"""Free space needed for the largest tarball and all unpacked files, bytes."""
_MAX_FILE_BYTES = 64 << 20
_MAX_FILES = 1000
# The inline source map of a script, for debugging: two thirds of the file, loaded each time.
_SOURCE_MAP = re.compile(rb"\n//# sourceMappingURL=data:[^\n]*\s*\Z")


@dataclass(frozen=True)
class Package:
    """A package of npm."""

    name: str
    version: str
    integrity: str
    """Hash that npm states: 'sha512-' and the tarball's hash in base64."""
    size: int
    """Approximate size of the tarball, bytes."""
    keep: str
    """Regular expression of the files that are installed, by their names below 'package/'."""


PACKAGES = (
    Package(
        "@foxglove/studio-base",
        "1.48.0",
        "sha512-EY8cYoHUm6VyTSVZBdfn5EJK2bRwTfAjH92H5wgAEcnKyeCUyKkxjgwbqO2jKwRJGa+7VPaEHHF167BzFh+N4A==",
        36_324_807,
        r"assets/.+|package\.json|README\.md",
    ),
    Package(
        "react",
        "17.0.2",
        "sha512-gnhPt75i/dq/z3/6q/0asP78D0u592D5L1pd7M8P+dck6Fu/jJeL6iVVK23fptSUZj8Vjf++7wXA8UNclGQcbA==",
        74_686,
        r"umd/react\.production\.min\.js|package\.json|LICENSE",
    ),
    Package(
        "react-dom",
        "17.0.2",
        "sha512-s4h96KtLDUQlsENhMn1ar8t2bEa+q/YAtj8pPPdIjPDGBDIVNsrD9aXNWqspUe6AzKCIG0C1HZZLqLV7qpOBGA==",
        744_992,
        r"umd/react-dom\.production\.min\.js|package\.json|LICENSE",
    ),
)

STUDIO_VERSION = PACKAGES[0].version


def studio_folder() -> Path:
    """Return the folder of the Studio's version, which all viewers of a user share.

    It is in $CASSANDRA_ROS_STUDIO, else in the ROS home: $ROS_HOME, else ~/.ros.
    """
    named = os.environ.get("CASSANDRA_ROS_STUDIO")
    return (Path(named) if named else home_folder() / "studio") / STUDIO_VERSION


def studio_installed(folder: Path) -> bool:
    """Return whether a folder has the complete Studio, in the versions of PACKAGES."""
    try:
        return bool(json.loads((folder / _MARKER).read_text(encoding="utf-8")) == _hashes())
    except (OSError, ValueError):
        return False


def _hashes() -> dict[str, str]:
    return {package.name: package.integrity for package in PACKAGES}


def install_studio(folder: Path, say: Callable[[str], None]) -> bool:
    """Fetch the Studio if it is missing; return whether it was.

    The registry is that of npm's configuration, the proxy that of $https_proxy.

    Args:
        folder: Folder to install it in; its old content is replaced.
        say: Prints a line for each step.

    Raises:
        DownloadFailed: Several attempts failed, the packages are not those that npm published, the
            disk has too little space, or no registry is known.
    """
    if studio_installed(folder):
        return False
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(folder.parent).free
        if free < _NEEDED_BYTES:
            raise DownloadFailed(
                f"no space for the Studio: {folder.parent} has {free >> 20} MiB free, "
                f"{_NEEDED_BYTES >> 20} MiB are needed"
            )
        draft = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        try:
            for package in PACKAGES:
                _install(package, draft, say)
            (draft / _MARKER).write_text(json.dumps(_hashes()), encoding="utf-8")
            draft.chmod(0o755)
            _put_in_place(draft, folder)
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    except OSError as exc:
        raise DownloadFailed(f"the Studio cannot be kept in {folder}: {exc}") from exc
    return True


def _put_in_place(draft: Path, folder: Path) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    try:
        os.replace(draft, folder)
    except OSError:
        # Another viewer has installed the same packages meanwhile.
        if not studio_installed(folder):
            raise


def _install(package: Package, draft: Path, say: Callable[[str], None]) -> None:
    url = tarball_address(package.name, package.version)
    say(f"fetching {package.name} {package.version} ({package.size / 1e6:.1f} MB) from {url}")
    with tempfile.TemporaryFile(dir=draft) as file:
        _fetch(package, url, file, say)
        file.seek(0)
        target = draft / package.name
        target.mkdir(parents=True)
        unpack(file, target, re.compile(package.keep))


def _fetch(package: Package, url: str, file: IO[bytes], say: Callable[[str], None]) -> None:
    """Download a tarball and check its hash; try again after a failure."""
    problem = ""
    for attempt in range(1, _ATTEMPTS + 1):
        if attempt > 1:
            say(f"attempt {attempt - 1} of {_ATTEMPTS} failed ({problem}); again soon")
            time.sleep(_PAUSE_SEC * attempt)
        try:
            digest = _download(url, file, package.size)
        except (OSError, ValueError, http.client.HTTPException) as exc:
            problem = str(exc) or type(exc).__name__
            continue
        if hmac.compare_digest(digest, package.integrity):
            return
        problem = f"its hash is {digest}, not {package.integrity}"
    raise DownloadFailed(
        f"{package.name} {package.version} could not be fetched from {url} {_ATTEMPTS} times: "
        f"{problem}.\nCheck the network (a proxy belongs in $https_proxy, another registry in "
        "$npm_config_registry) and try again: rosrun cassandra_ros viewer --install-studio"
    )


def _download(url: str, file: IO[bytes], size: int) -> str:
    """Download an address into a file; return the hash of the content as npm writes it."""
    file.seek(0)
    file.truncate()
    digest, got = hashlib.sha512(), 0
    with urllib.request.urlopen(url, timeout=_TIMEOUT_SEC) as response:  # noqa: S310 - checked
        while True:
            chunk = response.read(_DOWNLOAD_READ_BYTES)
            if not chunk:
                break
            got += len(chunk)
            if got > 2 * size:
                raise ValueError(f"it has over {2 * size} bytes")
            digest.update(chunk)
            file.write(chunk)
    return "sha512-" + base64.b64encode(digest.digest()).decode("ascii")


def unpack(file: IO[bytes], target: Path, keep: re.Pattern[str]) -> None:
    """Unpack the selected files of a tarball of npm into a folder; skip links and devices.

    Args:
        file: The tarball, at its beginning.
        target: An existing folder.
        keep: Matches the whole names of selected files, below the tarball's top folder.

    Raises:
        DownloadFailed: The file is not a tarball, has a file that is too large, or too many files.
    """
    try:
        with tarfile.open(fileobj=file, mode="r|gz") as archive:
            for count, (name, data) in enumerate(_selected_files(archive, keep), 1):
                if count > _MAX_FILES:
                    raise DownloadFailed(f"a package has over {_MAX_FILES} files")
                path = target.joinpath(*name.parts)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(_SOURCE_MAP.sub(b"\n", data) if name.suffix == ".js" else data)
    except (tarfile.TarError, EOFError) as exc:
        raise DownloadFailed(f"a package is not a tarball that can be read: {exc}") from exc


def _selected_files(
    archive: tarfile.TarFile, keep: re.Pattern[str]
) -> Iterator[tuple[PurePosixPath, bytes]]:
    for member in archive:
        name = PurePosixPath(*PurePosixPath(member.name).parts[1:])
        # No links, no devices, and no name that leads out of the folder.
        if not member.isreg() or ".." in name.parts or name.is_absolute():
            continue
        if not keep.fullmatch(str(name)):
            continue
        if member.size > _MAX_FILE_BYTES:
            raise DownloadFailed(f"{name} of a package has {member.size} bytes: it is not unpacked")
        content = archive.extractfile(member)
        if content is not None:
            yield name, content.read()


MACHINE_FILES = ("/usr/local/etc/npmrc", "/usr/etc/npmrc", "/etc/npmrc")
"""Files of npm's global configuration: below the prefix of npm's build; on Debian in /etc."""
_SETTING = re.compile(r"([^;#=\s][^=]*?)\s*=\s*(.*?)\s*")
_VARIABLE = re.compile(r"\$\{([^}]+)\}")


def tarball_address(name: str, version: str) -> str:
    """Return the URL of a package's tarball.

    Args:
        name: Name of the package, as 'react' or '@scope/name'.
        version: Version of the package, as '17.0.2'.

    Raises:
        DownloadFailed: The configured registry is not an HTTP address; or no registry is configured
            and packageurl is not installed.
    """
    scope, _, file = name.rpartition("/")
    configuration = _configuration()
    registry = configuration.get(f"{scope}:registry") or configuration.get("registry")
    if registry is None:
        return _usual_address(scope, file, version)
    if urlsplit(registry).scheme not in ("http", "https"):
        raise DownloadFailed(
            f"{registry:.200} is not the HTTP address of a registry: "
            "see npm_config_registry and ~/.npmrc"
        )
    return f"{registry.rstrip('/')}/{quote(name, safe='@/')}/-/{file}-{version}.tgz"


def _usual_address(scope: str, file: str, version: str) -> str:
    try:
        package_url = optional_module("packageurl", "npm's usual registry").PackageURL
        addresses = optional_module("packageurl.contrib.purl2url", "npm's usual registry")
    except MissingDependency as exc:
        raise DownloadFailed(
            f"npm's configuration names no registry: set npm_config_registry to its address. {exc}"
        ) from exc
    return str(addresses.get_download_url(str(package_url("npm", scope or None, file, version))))


def _configuration() -> dict[str, str]:
    """Return npm's settings; for each setting the source with the highest precedence wins."""
    environment = {
        name[len("npm_config_") :].lower(): value
        for name, value in os.environ.items()
        if name.lower().startswith("npm_config_") and value
    }
    settings: dict[str, str] = {}
    for path in (*MACHINE_FILES, environment.get("userconfig") or Path.home() / ".npmrc"):
        settings.update(_settings_of(Path(path)))
    return {**settings, **environment}


def _settings_of(path: Path) -> dict[str, str]:
    """Return the settings of an npmrc file; a file that cannot be read has none, as for npm."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return {}
    matches = (_SETTING.fullmatch(line.strip()) for line in lines)
    return {
        match[1]: _VARIABLE.sub(
            lambda name: os.environ.get(name[1], name[0]), match[2].strip("\"'")
        )
        for match in matches
        if match
    }
