# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Names of nodes: never that of a node that lives, for the master would shut that one down."""

from __future__ import annotations

import socket
import xmlrpc.client
from http.client import HTTPException
from typing import Sequence
from urllib.parse import urlparse
from xml.parsers.expat import ExpatError

import rospy

_REMAP = "__name:="
_TIMEOUT_SEC = 2.0
MASTER_ERRORS = (OSError, HTTPException, xmlrpc.client.Error, ExpatError)
"""What asking a master raises that is away, or dies in the middle of its answer."""


def wantedName(default: str, argv: Sequence[str]) -> str:
    """Return the base name that a node is to have.

    Args:
        default: Its own.
        argv: The command line; ``__name:=x`` wins.
    """
    given = [word[len(_REMAP) :] for word in argv if word.startswith(_REMAP)]
    return given[-1] if given else default


def withoutName(argv: Sequence[str]) -> list[str]:
    """Return the command line without ``__name:=x``, which forbids an anonymous name."""
    return [word for word in argv if not word.startswith(_REMAP)]


def fullName(name: str) -> str:
    """Return a node's base name with the namespace that this process is in."""
    return str(rospy.get_namespace()) + name


def isTaken(full_name: str) -> bool:
    """Say whether a node of this name lives; False also where no master answers yet."""
    try:
        code, _, uri = rospy.get_master().lookupNode(full_name)
    except MASTER_ERRORS:
        return False  # init_node waits for the master
    if code != 1:
        return False
    where = urlparse(uri)
    try:
        socket.create_connection((where.hostname, where.port), _TIMEOUT_SEC).close()
    except ConnectionRefusedError:
        return False  # it died without a word
    except OSError:
        return True  # out of reach is not dead
    return True
