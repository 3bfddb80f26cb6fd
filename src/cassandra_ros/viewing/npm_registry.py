# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where npm's packages are fetched from: the registry of npm's configuration, else its usual one.

The configuration is read as npm reads it, without npm: npm_config_registry, then the user's .npmrc
and those of the machine. Without any, packageurl knows the address that belongs to an npm package.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from urllib.parse import quote, urlsplit

from cassandra_ros.errors import DownloadFailed, MissingDependency
from cassandra_ros.installation import optional_module

MACHINE_FILES = ("/usr/local/etc/npmrc", "/usr/etc/npmrc", "/etc/npmrc")
"""npm's global configuration: below the prefix that npm was built for, in /etc on Debian."""
_SETTING = re.compile(r"([^;#=\s][^=]*?)\s*=\s*(.*?)\s*")
_VARIABLE = re.compile(r"\$\{([^}]+)\}")


def tarball_address(name: str, version: str) -> str:
    """Return the URL of a package's tarball.

    Args:
        name: As npm writes it: 'react', '@scope/name'.
        version: As '17.0.2'.

    Raises:
        DownloadFailed: npm's configuration names something else than an HTTP address, or it names
            no registry and packageurl is not installed.
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
    """Return npm's settings; the strongest source of each wins."""
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
    """Return what an npmrc file sets; a file that cannot be read sets nothing, as for npm."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return {}
    found = (_SETTING.fullmatch(line.strip()) for line in lines)
    return {
        match[1]: _VARIABLE.sub(
            lambda name: os.environ.get(name[1], name[0]), match[2].strip("\"'")
        )
        for match in found
        if match
    }
