# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""getMeta: the metadata of a topic as a mapping that can also be called (paper 4.1.2)."""

from __future__ import annotations

from typing import Any, Iterator, Mapping

from cassandra_ros.metadata import TopicMetadata


class MetaView(Mapping[str, Any]):
    """Metadata of a topic: ``getMeta['msg_class']`` and ``getMeta('msg_class')`` are the same.

    Args:
        metadata: What the topic's table says.
        nodes: The nodeIDs that have stored messages.
    """

    def __init__(self, metadata: TopicMetadata, nodes: list[str]) -> None:
        package, _, name = metadata.msg_type.rpartition("/")
        only = nodes[0] if len(nodes) == 1 else ""
        self._values: dict[str, Any] = {
            **metadata.user,
            "topic": metadata.topic,
            "msg_type": metadata.msg_type,
            "msg_class": name,
            "msg_package": package,
            "md5sum": metadata.md5sum,
            "definition": metadata.definition,
            "key_format": metadata.key_format,
            "key_part": metadata.key_part,
            "format": metadata.format,
            "nodeID": metadata.nodeID or only,
            "nodeIDs": nodes,
            "comment": metadata.comment,
            "date": metadata.date,
            "ttl": metadata.ttl,
            "indexes": list(metadata.indexes),
        }

    def __call__(self, key: str) -> Any:
        """Return one value, as the paper's getMeta(key) does."""
        return self._values[key]

    def __getitem__(self, key: str) -> Any:
        return self._values[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return f"MetaView({self._values!r})"
