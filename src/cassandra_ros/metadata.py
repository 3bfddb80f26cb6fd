# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What is known of a stored topic: the JSON in the comment of its table (paper section 3)."""

from __future__ import annotations

import json
import logging
import re
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache, partial
from typing import Any, Callable, Iterator, Mapping

from cassandra_ros.errors import UnsupportedSchema
from cassandra_ros.keys import KEY_FORMATS, NAMED_FORMATS

_log = logging.getLogger(__name__)

SCHEMA_VERSION = 1
_OURS, _FILLING = "cassandra_ros", "cassandra_ros_filling"
FORMAT_NAMES = ("binary", "string", "yaml", "json", "ros", "packed")
"""In the table of formats they are the same."""
MAX_LIFETIME_SEC = 20 * 365 * 86_400
"""Largest time to live that Cassandra takes, s."""
ANY_MD5 = "*"
"""Stands for the md5sum of a type whose definition cannot be used; it tells no types apart."""
SHADOW = "_ix"
"""What the names of shadow columns begin with: SAI takes no dotted names."""


@dataclass(frozen=True)
class TopicMetadata:
    """Immutable facts of one table. Counts and times never stand here."""

    topic: str
    msg_type: str
    """Type of the first connection, 'pkg/Name'; others of the same kind share the table."""
    md5sum: str
    format: str
    """Name in the table of formats."""
    bucket_ns: int
    """Length of a time bucket, nanoseconds."""
    definition: str = ""
    key_format: str = "time"
    key_part: str = ""
    ttl: int = 0
    """Seconds until a row expires, counted from its writing; 0 = never."""
    nodeID: str = ""
    """nodeID given at addTopic; '' when nobody said."""
    comment: str = ""
    date: str = ""
    """When the table was made, ISO 8601."""
    generation: int = 0
    """Counts how often the topic was dropped: no table name is used twice."""
    own_time: bool = False
    """The key is not the receive time, which then has a column of its own."""
    indexes: Mapping[str, str] = field(default_factory=dict)
    """Indexed field -> shadow column."""
    index_names: Mapping[str, str] = field(default_factory=dict)
    """Name given in CREATE INDEX -> field; void where the field is not indexed (any more)."""
    index_count: int = 0
    """Number of the next shadow column; one that was dropped is never used again."""
    span_ns: int = 0
    """A row is a block of messages, of which the last is at most so many ns after the first; 0 =
    a row is a message."""
    columns: tuple[Mapping[str, Any], ...] = ()
    """How each column holds its field, as the format describes it."""
    user: Mapping[str, Any] = field(default_factory=dict)
    """The user's own keys (setMeta)."""
    replaces: tuple[str, ...] = ()
    """Names of the tables whose messages this one took over, also of those that they replaced."""
    filling: bool = False
    """Nobody reads it yet: it is being filled with the messages of those that it replaces."""
    cut: bool = False
    """Its blocks may begin at other messages than those of an import: it took the place of a table
    that was removed while it was written to."""
    version: int = SCHEMA_VERSION

    @property
    def kind(self) -> tuple[str, str]:
        """What messages of one table have in common, see ``message_kind``."""
        return message_kind(self.md5sum, self.msg_type)

    @property
    def named(self) -> bool:
        """Whether rows are found by a name, not by their time."""
        return self.key_format in NAMED_FORMATS

    @property
    def packed(self) -> bool:
        """Whether a row is a block of messages."""
        return self.span_ns > 0

    @property
    def partition(self) -> str:
        """Name of the second column of the partition key: a name, or a time range."""
        return "_key" if self.named else "_bucket"

    @property
    def next_shadow(self) -> int:
        """Number that no shadow column had yet, as far as the comment tells."""
        used = [int(shadow[len(SHADOW) :]) for shadow in self.indexes.values()]
        return max(self.index_count, *(number + 1 for number in used), 0)

    def with_index(self, field: str, number: int) -> TopicMetadata:
        """Return a copy with one more index, in the shadow column of this number."""
        indexes = {**self.indexes, field: shadow_column(number)}
        return self.with_(indexes=indexes, index_count=number + 1)

    def without_index(self, field: str) -> TopicMetadata:
        """Return a copy without an index."""
        indexes = {name: shadow for name, shadow in self.indexes.items() if name != field}
        names = {name: indexed for name, indexed in self.index_names.items() if indexed != field}
        return self.with_(indexes=indexes, index_names=names, index_count=self.next_shadow)

    @property
    def received_columns(self) -> dict[str, str]:
        """Columns that say when a message came, where its key does not: name -> CQL type."""
        if not self.own_time or self.packed:  # blocks hold these times themselves
            return {}
        # Equal messages have one row, with 0 for time and counter; this is its place in the order.
        arrival = {"_arrival": "bigint"} if self.key_format == "hash" else {}
        return {"_recv": "bigint", **arrival}

    def to_comment(self) -> str:
        """Write the metadata as the JSON text of a table comment."""
        # Also an earlier release, which does not know what filling is, must not read such a table.
        return json.dumps({_FILLING if self.filling else _OURS: vars(self)}, sort_keys=True)

    def with_user(self, keys: Mapping[str, Any], comment: str | None) -> TopicMetadata:
        """Return a copy with keys of the user's own set, None = removed, and the comment."""
        every = {**self.user, **keys}
        user = {name: value for name, value in every.items() if value is not None}
        return self.with_(user=user, comment=self.comment if comment is None else comment)

    def with_(self, **changes: Any) -> TopicMetadata:
        """Return a copy with some values changed."""
        return replace(self, **changes)


def message_kind(md5sum: str, msg_type: str) -> tuple[str, str]:
    """Return the md5sum of messages, and their type where the md5sum tells no types apart.

    Messages of one topic, kind and format share a table.
    """
    return md5sum, msg_type if md5sum == ANY_MD5 else ""


def shadow_column(number: int) -> str:
    """Name a column that carries an index."""
    return f"{SHADOW}{number}"


def from_comment(comment: str, table: str) -> TopicMetadata | None:
    """Read the metadata out of the comment of any table; None where that is not one of ours.

    Where the comment is ours but a field cannot be what it says, a warning names the table, once.

    Raises:
        UnsupportedSchema: A newer release wrote it.
    """
    if not any(f'"{key}"' in comment for key in (_OURS, _FILLING)):
        return None
    try:
        found = json.loads(comment)
        values = found[_OURS if _OURS in found else _FILLING]
        version = int(values["version"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return None  # a foreign table whose comment happens to name us
    if version > SCHEMA_VERSION:
        raise UnsupportedSchema(
            f"table {table} was written with schema version {version}; this release of "
            f"cassandra_ros reads versions up to {SCHEMA_VERSION}: install a newer one"
        )
    known = {f.name for f in fields(TopicMetadata)}
    kept = {name: value for name, value in values.items() if name in known}
    missing = [name for name in _REQUIRED if name not in kept]
    if missing:
        _skip(table, f"{missing[0]} is missing")
        return None
    for name, value in kept.items():
        if not _CHECKS[name](value):
            _skip(table, f"{name} cannot be {value!r:.80}")
            return None
    kept["columns"] = tuple(kept.get("columns", ()))
    kept["replaces"] = tuple(kept.get("replaces", ()))
    return TopicMetadata(**kept)


@lru_cache(maxsize=1024)
def _skip(table: str, reason: str) -> None:
    """Warn of a table that is left out; once, for comments are read every few seconds."""
    _log.warning(
        "table %s is left out: its comment was changed by hand or by another program, %s; put the "
        "comment right to read its messages again",
        table,
        reason,
    )


def _is_text(value: object) -> bool:
    """Say whether a value is a text that can be written as UTF-8."""
    try:
        return isinstance(value, str) and value.encode("utf-8") is not None
    except UnicodeEncodeError:
        return False


def _is_escaped_text(value: object) -> bool:
    """Say whether a value is a text in which bytes that are not UTF-8 stand as surrogates."""
    try:
        return isinstance(value, str) and value.encode("utf-8", "surrogateescape") is not None
    except UnicodeEncodeError:
        return False


def _is_name(value: object) -> bool:
    return _is_text(value) and value != ""


def _is_bool(value: object) -> bool:
    return isinstance(value, bool)


def _is_integer(value: object, least: int = 0, most: int = 2**63 - 1) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most


def _is_one_of(known: tuple[str, ...], value: object) -> bool:
    return isinstance(value, str) and value in known


def _is_mapping(value: object) -> bool:
    """Say whether a value is a JSON object; its keys must be texts, its values may be anything."""
    return isinstance(value, dict) and all(map(_is_text, value))


def _is_texts(value: object) -> bool:
    return isinstance(value, dict) and all(map(_is_text, (*value, *value.values())))


def _is_indexes(value: object) -> bool:
    """Say whether a value maps fields to shadow columns."""
    return (
        isinstance(value, dict)
        and all(map(_is_text, value))
        and all(isinstance(v, str) and _SHADOW_COLUMN.fullmatch(v) for v in value.values())
    )


def _is_list(each: Callable[[object], bool], value: object) -> bool:
    return isinstance(value, (list, tuple)) and all(map(each, value))


_REQUIRED = ("topic", "msg_type", "md5sum", "format", "bucket_ns")
_SHADOW_COLUMN = re.compile(f"{SHADOW}[0-9]{{1,9}}")
_CHECKS: Mapping[str, Callable[[object], bool]] = {
    **dict.fromkeys(("topic",), _is_name),
    **dict.fromkeys(("key_part", "nodeID", "comment", "date"), _is_text),
    # They come from connection headers, whose bytes need not be UTF-8.
    **dict.fromkeys(("msg_type", "md5sum", "definition"), _is_escaped_text),
    "format": partial(_is_one_of, FORMAT_NAMES),
    "key_format": partial(_is_one_of, KEY_FORMATS),
    "bucket_ns": partial(_is_integer, least=1),
    "ttl": partial(_is_integer, most=MAX_LIFETIME_SEC),
    **dict.fromkeys(("generation", "span_ns"), _is_integer),
    "index_count": partial(_is_integer, most=10**9),
    "version": partial(_is_integer, least=1),
    **dict.fromkeys(("own_time", "filling", "cut"), _is_bool),
    "indexes": _is_indexes,
    "index_names": _is_texts,
    "columns": partial(_is_list, _is_mapping),
    "replaces": partial(_is_list, _is_name),
    "user": _is_mapping,
}
"""What a comment may say of each field."""


FACTS = (
    "topic msg_type msg_class msg_package md5sum definition key_format key_part format nodeID "
    "nodeIDs comment date ttl indexes"
).split()
"""Keys of getMeta that are not the user's own."""


class MetaView(Mapping[str, Any]):
    """Metadata of a topic: ``getMeta['msg_class']`` and ``getMeta('msg_class')`` are the same.

    Args:
        metadata: What the topic's table says.
        nodes: The nodeIDs that have stored messages.
    """

    def __init__(self, metadata: TopicMetadata, nodes: list[str]) -> None:
        package, _, name = metadata.msg_type.rpartition("/")
        only = nodes[0] if len(nodes) == 1 else ""
        facts = {
            **vars(metadata),
            "msg_class": name,
            "msg_package": package,
            "nodeID": metadata.nodeID or only,
            "nodeIDs": nodes,
            "indexes": list(metadata.indexes),
        }
        self._values = {**metadata.user, **{name: facts[name] for name in FACTS}}

    def __getitem__(self, key: str) -> Any:
        return self._values[key]

    __call__ = __getitem__  # the paper's getMeta(key)

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return f"MetaView({self._values!r})"
