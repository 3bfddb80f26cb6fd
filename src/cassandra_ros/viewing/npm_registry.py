# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The addresses of npm packages: in the registry that npm is configured for, or its usual one.

The configuration is read as npm reads it, without npm: npm_config_registry, then the user's .npmrc
and those of the machine. If it names no registry, packageurl has the address of an npm package.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from urllib.parse import quote, urlsplit

from cassandra_ros.errors import DownloadFailed, MissingDependency
from cassandra_ros.installation import optional_module

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
