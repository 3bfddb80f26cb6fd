# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""ROS parameters and node graph at the start of a run, as one blob.

The blob is compressed JSON. A value that JSON lacks is a mapping with one key that begins with
``$``: ``{"$float": "nan"}``, ``{"$datetime": "20260102T03:04:05"}``, ``{"$binary": base64}``. A
mapping among the parameters that has such a key itself becomes ``{"$mapping": {…}}``.
"""

from __future__ import annotations

import base64
import json
import math
import xmlrpc.client
import zlib
from dataclasses import dataclass, field
from datetime import datetime
from typing import Mapping, Sequence

from cassandra_ros.errors import CorruptMessage, InvalidOption

MAX_CONTEXT_BYTES = 64 * 1024 * 1024
"""Maximum size of the JSON in bytes, so that a hostile or broken blob cannot fill the memory."""

_GRAPH = ("publishers", "subscribers", "services", "types")
"""Fields of NodeGraph, which the blob has beside ``params``."""
Graph = Mapping[str, Sequence[str]]
"""Topic or service → names of nodes."""


@dataclass(frozen=True)
class NodeGraph:
    """ROS nodes with their topics and services, as listed by the master's ``getSystemState``."""

    publishers: Graph = field(default_factory=dict)
    subscribers: Graph = field(default_factory=dict)
    services: Graph = field(default_factory=dict)
    types: Mapping[str, str] = field(default_factory=dict)
    """Topic → 'pkg/Name'."""

    @property
    def nodes(self) -> list[str]:
        """Names of all nodes, sorted."""
        graphs = (self.publishers, self.subscribers, self.services)
        return sorted({node for graph in graphs for nodes in graph.values() for node in nodes})


@dataclass(frozen=True)
class RunContext:
    """ROS parameters and node graph at the start of a run.

    Attributes:
        params: The tree of the parameter server, as ``rosgraph.Master.getParam('/')`` returns it.
            Its values are those of XML-RPC: bools, ints, floats, texts, lists, mappings of texts,
            ``xmlrpc.client.DateTime`` and ``Binary``, and None. They are read back as they were,
            except that a tuple becomes a list, a datetime a DateTime, and bytes a Binary.
        graph: The nodes with their topics and services.
    """

    params: Mapping[str, object] = field(default_factory=dict)
    graph: NodeGraph = field(default_factory=NodeGraph)


def encode_context(context: RunContext) -> bytes:
    """Return a context as a blob.

    Raises:
        InvalidOption: A parameter has a type that no parameter server has, or all together are
            too large.
    """
    parts = {
        "params": _plain(context.params, "", 0),
        **{name: getattr(context.graph, name) for name in _GRAPH},
    }
    text = json.dumps(parts, allow_nan=False, separators=(",", ":")).encode("ascii")
    if len(text) > MAX_CONTEXT_BYTES:
        raise InvalidOption(
            f"the parameters of the run take {len(text)} bytes as JSON; at most "
            f"{MAX_CONTEXT_BYTES} are kept"
        )
    return zlib.compress(text)


def decode_context(blob: bytes) -> RunContext:
    """Return the context in a blob; raises CorruptMessage if encode_context did not write it."""
    try:
        unpacker = zlib.decompressobj()
        text = unpacker.decompress(blob, MAX_CONTEXT_BYTES)
        parts = json.loads(text.decode("ascii"))
        params = _value(parts["params"])
        if not isinstance(params, dict):
            raise TypeError("the parameters are not a mapping")
        return RunContext(params, NodeGraph(**{name: parts[name] for name in _GRAPH}))
    except (zlib.error, ValueError, TypeError, KeyError, AttributeError, RecursionError) as exc:
        raise CorruptMessage(
            f"the stored parameters of a run cannot be read: {exc}; the row is damaged"
        ) from exc


_MAX_DEPTH = 200
"""Maximum number of lists and mappings in one another."""


def _plain(value: object, name: str, depth: int) -> object:
    """Return a value as JSON can hold it; raises InvalidOption.

    Args:
        name: Name of the parameter, for the error text.
        depth: Number of lists and mappings around the value.
    """
    if depth > _MAX_DEPTH:
        raise InvalidOption(f"parameter {name[:80]}… is nested deeper than {_MAX_DEPTH} levels")
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"$float": repr(value)}
    if isinstance(value, (xmlrpc.client.DateTime, datetime)):
        when = xmlrpc.client.DateTime(value) if isinstance(value, datetime) else value
        return {"$datetime": str(when)}
    if isinstance(value, (bytes, bytearray, xmlrpc.client.Binary)):
        data = value.data if isinstance(value, xmlrpc.client.Binary) else bytes(value)
        return {"$binary": base64.b64encode(data).decode("ascii")}
    if isinstance(value, (list, tuple)):
        return [_plain(element, f"{name}[{i}]", depth + 1) for i, element in enumerate(value)]
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        mapping = {k: _plain(element, f"{name}/{k}", depth + 1) for k, element in value.items()}
        return {"$mapping": mapping} if any(key.startswith("$") for key in mapping) else mapping
    raise InvalidOption(
        f"parameter {name or '/'} is a {type(value).__name__}, which no parameter server holds"
    )


def _value(plain: object) -> object:
    """Return the value from which ``_plain`` made ``plain``."""
    if isinstance(plain, list):
        return [_value(element) for element in plain]
    if not isinstance(plain, dict):
        return plain
    kind, inner = next(iter(plain.items())) if len(plain) == 1 else ("", "")
    if kind == "$float":
        return float(inner)
    if kind == "$datetime":
        return xmlrpc.client.DateTime(inner)
    if kind == "$binary":
        return xmlrpc.client.Binary(base64.b64decode(inner))
    mapping = plain["$mapping"] if kind == "$mapping" else plain
    return {key: _value(element) for key, element in mapping.items()}
