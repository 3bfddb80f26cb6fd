# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Message classes of the packages installed on this machine."""

from __future__ import annotations

import importlib
import importlib.util
import logging
import os
import sys
from functools import lru_cache
from typing import Any

from cassandra_ros.messages.spec import check_type_name

_log = logging.getLogger(__name__)


@lru_cache(maxsize=1024)
def installed_class(msg_type: str) -> Any | None:
    """Return the class of an installed message type, or None; DefinitionError: not a 'pkg/Name'.

    A type name comes from outside: a package is only imported if its folder has ``msg/_Name.py``.
    """
    package, name = check_type_name(msg_type).split("/")
    if not _has_message(package, name):
        return None
    try:
        # The whole package first: threads that begin with two of its modules wait for each other.
        importlib.import_module(f"{package}.msg")
        cls = getattr(importlib.import_module(f"{package}.msg._{name}"), name)
        if cls._type == msg_type:
            return cls
        _log.warning("installed class %s calls itself %s: not used", msg_type, cls._type)
    except (ImportError, AttributeError, SyntaxError) as exc:
        _log.warning("installed message type %s cannot be imported: %s", msg_type, exc)
    return None


def _has_message(package: str, name: str) -> bool:
    loaded = sys.modules.get(package)
    if loaded is not None:  # an imported package may have extended its path
        folders = getattr(loaded, "__path__", [])
    else:
        try:
            spec = importlib.util.find_spec(package)
        except (ImportError, ValueError):
            return False
        folders = (spec.submodule_search_locations if spec is not None else None) or []
    return any(os.path.isfile(os.path.join(f, "msg", f"_{name}.py")) for f in folders)
