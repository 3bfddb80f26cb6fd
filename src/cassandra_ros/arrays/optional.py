# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Packages that only tables need, loaded when a table is asked for."""

from __future__ import annotations

import importlib
import sys
from typing import Any

from cassandra_ros.errors import MissingDependency

OLD = sys.version_info < (3, 9)
VERSIONS = {
    "pandas": "2.0.3" if OLD else "2.3.3",
    "pyarrow": "17.0.0" if OLD else "25.0.1",
}
"""As in requirements-tables.txt."""


def optionalModule(name: str, purpose: str) -> Any:
    """Import a module of an optional package.

    Args:
        name: The module, as 'pyarrow.parquet'.
        purpose: What needs it, for the error text.

    Raises:
        MissingDependency: The package is not installed, or does not run here.
    """
    package = name.split(".")[0]
    try:
        return importlib.import_module(name)
    except ImportError as exc:
        wanted = f"{package}=={VERSIONS[package]}"
        why = "is not installed" if exc.name == package else f"cannot be loaded ({exc})"
        raise MissingDependency(
            f"{purpose} needs the Python package {package}, which {why}: "
            f"{sys.executable} -m pip install {wanted}"
        ) from exc
