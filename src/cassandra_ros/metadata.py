# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The metadata of a stored topic: JSON in the comment of its table (paper section 3)."""

from __future__ import annotations

import json
import logging
import re
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache, partial
from typing import Any, Callable, Iterator, Mapping, NamedTuple

from cassandra_ros.errors import UnsupportedSchema
from cassandra_ros.keys import KEY_FORMATS, NAMED_FORMATS

_log = logging.getLogger(__name__)

SCHEMA_VERSION = 1
"""Version of all tables that this release writes, and the only one that it reads. It is in the
comments of the tables of topics and of the side tables."""
_TOPIC, _SIDE = "cassandra_ros", "cassandra_ros_side_table"
SIDE_COMMENT = json.dumps({_SIDE: {"version": SCHEMA_VERSION}})
"""Comment of a side table."""
FORMAT_NAMES = ("binary", "string", "yaml", "json", "ros", "packed")
"""Names of all storage formats; each is a file in messages/formats/."""
DEFAULT_FORMAT = "ros"
"""Storage format of new topics."""
MAX_LIFETIME_SEC = 20 * 365 * 86_400
"""Maximum time to live that Cassandra accepts, s."""
ANY_MD5 = "*"
"""Replacement for the md5sum of a type whose definition cannot be used; several types share it."""
SHADOW = "_ix"
"""Prefix of the names of shadow columns, which carry indexes: SAI accepts no dotted names."""


@dataclass(frozen=True)
class TopicMetadata:
    """The properties of one topic table. Counts and times are not part of them."""

    topic: str
    msg_type: str
    """Type of the first connection, 'pkg/Name'. Types of the same kind share the table."""
    md5sum: str
    format: str
    """Name of the storage format."""
    bucket_ns: int
    """Length of a bucket, ns."""
    definition: str = ""
    key_format: str = "time"
    key_part: str = ""
    ttl: int = 0
    """Time from the writing of a row until it expires, s; 0 = never."""
    nodeID: str = ""
    """nodeID given to addTopic; '' = none was given."""
    comment: str = ""
    date: str = ""
    """Time at which the table was made, ISO 8601."""
    generation: int = 0
    """Time at which the table was made, ns since 1970: part of its name, so that no name is used
    twice."""
    own_time: bool = False
    """Whether the key is not the receive time, which then has a column of its own."""
    indexes: Mapping[str, str] = field(default_factory=dict)
    """Indexed field -> shadow column."""
    index_names: Mapping[str, str] = field(default_factory=dict)
    """Name given in CREATE INDEX -> field. Entries of fields without index have no effect."""
    index_count: int = 0
    """Number of the next shadow column; numbers of dropped columns are not used again."""
    span_ns: int = 0
    """Maximum time between the first and the last message of a block, ns; 0 = rows are messages,
    not blocks."""
    columns: tuple[Mapping[str, Any], ...] = ()
    """Description of each column, made by the format."""
    user: Mapping[str, Any] = field(default_factory=dict)
    """The user's own keys (setMeta)."""
    replaces: tuple[str, ...] = ()
    """Names of all tables that this one has replaced, directly or indirectly."""
    since_us: int = 0
    """Server time before the messages of the replaced tables were copied, us; 0 = unknown. Messages
    that were written later into these tables may be missing here."""
    filling: bool = False
    """Whether messages of the replaced tables are still being copied; readers ignore the table."""
    cut: bool = False
    """Whether blocks may begin at other messages than those of a repeated import, because the table
    replaced one that was removed while messages were written to it."""
    version: int = SCHEMA_VERSION

    @property
    def named(self) -> bool:
        """Whether rows are found by a name, not by their time."""
        return self.key_format in NAMED_FORMATS

    @property
    def packed(self) -> bool:
        """Whether a row is a block of messages."""
        return self.span_ns > 0

    @property
    def takes_index(self) -> bool:
        """Whether an index on a field can be made: a block has its minima and maxima instead."""
        return not self.packed

    @property
    def may_be_cut_otherwise(self) -> bool:
        """Whether there may be blocks that begin at other messages than those of a new import."""
        return self.packed and (self.cut or bool(self.replaces))

    def noting_cut(self) -> TopicMetadata:
        """Return a copy that notes ``cut`` if a row is a block; a message's row is cut one way."""
        return self.with_(cut=True) if self.packed else self

    @property
    def partition(self) -> str:
        """Name of the second column of the partition key, which holds a name or a bucket."""
        return "_key" if self.named else "_bucket"

    @property
    def next_shadow(self) -> int:
        """Number for a new shadow column that, by the comment, was never used."""
        # A comment that was changed by hand may have too low a count.
        used = [int(shadow[len(SHADOW) :]) for shadow in self.indexes.values()]
        return max(self.index_count, *(number + 1 for number in used), 0)

    def with_index(self, field: str, number: int) -> TopicMetadata:
        """Return a copy with an index on a field, in the shadow column ``number``."""
        indexes = {**self.indexes, field: shadow_column(number)}
        return self.with_(indexes=indexes, index_count=number + 1)

    def without_index(self, field: str) -> TopicMetadata:
        """Return a copy without the index on a field."""
        indexes = {name: shadow for name, shadow in self.indexes.items() if name != field}
        names = {name: indexed for name, indexed in self.index_names.items() if indexed != field}
        return self.with_(indexes=indexes, index_names=names, index_count=self.next_shadow)

    @property
    def received_columns(self) -> dict[str, str]:
        """Columns for the receive time, if the key is another time: name -> CQL type."""
        if not self.own_time or self.packed:  # blocks hold these times themselves
            return {}
        # Equal messages share a row, whose time and counter are 0; _arrival orders these rows.
        arrival = {"_arrival": "bigint"} if self.key_format == "hash" else {}
        return {"_recv": "bigint", **arrival}

    def to_comment(self) -> str:
        """Return the metadata as the JSON text of a table comment."""
        return json.dumps({_TOPIC: vars(self)}, sort_keys=True)

    def with_user(self, keys: Mapping[str, Any], comment: str | None) -> TopicMetadata:
        """Return a copy with other keys of the user's own and another comment.

        Args:
            keys: Keys to set; the value None removes a key.
            comment: The new comment; None = keep it.
        """
        merged = {**self.user, **keys}
        user = {name: value for name, value in merged.items() if value is not None}
        return self.with_(user=user, comment=self.comment if comment is None else comment)

    def with_(self, **changes: Any) -> TopicMetadata:
        """Return a copy with some values changed."""
        return replace(self, **changes)


class Kind(NamedTuple):
    """The identity of a definition. Messages of one topic, kind and format share a table."""

    md5sum: str
    msg_type: str
    """Name of the type if the md5sum is ANY_MD5, otherwise ''."""
    arrays: tuple[str, ...] | None
    """Paths of the arrays of messages, see Definition; the md5 leaves their brackets out. None =
    the definition is unusable."""

    def fits(self, other: Kind) -> bool:
        """Return whether messages of both kinds may have the same type.

        Where one definition is unusable the md5 decides.
        """
        if None in (self.arrays, other.arrays):
            return self[:2] == other[:2]
        return self == other


def message_kind(md5sum: str, msg_type: str, arrays: tuple[str, ...] | None) -> Kind:
    """Return the kind of messages.

    Args:
        arrays: Paths of the arrays of messages in their definition; None = it is unusable.
    """
    return Kind(md5sum, msg_type if md5sum == ANY_MD5 else "", arrays)


def type_text(msg_type: str, kind: Kind, other: Kind) -> str:
    """Return a type as a text for the user, who must tell it from another one.

    If both have the same md5sum it names the arrays of messages that only this one has, or says
    that its definition is unusable.
    """
    text = f"{msg_type} [{kind.md5sum}]"
    if kind.md5sum != other.md5sum or kind.arrays == other.arrays:
        return text
    if kind.arrays is None:
        return f"{text} without a usable definition"
    if other.arrays is None:
        return text
    arrays = ", ".join(array for array in kind.arrays if array not in other.arrays)
    return f"{text} with {arrays or 'single messages'}"


def shadow_column(number: int) -> str:
    """Return the name of a shadow column."""
    return f"{SHADOW}{number}"


def from_comment(comment: str, table: str) -> TopicMetadata | None:
    """Return the metadata in the comment of a table; None if it is not a topic table.

    If it is one, but a field is missing or has an impossible value, the result is None, too, and a
    warning names the table, once. Keys that are not fields of TopicMetadata are ignored.

    Raises:
        UnsupportedSchema: The table, which may be a side table, has another schema version.
    """
    if not any(f'"{key}"' in comment for key in (_TOPIC, _SIDE)):
        return None
    try:
        parsed = json.loads(comment)
        is_topic = _TOPIC in parsed
        values = parsed[_TOPIC if is_topic else _SIDE]
        version = int(values["version"])
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None  # a table of another program whose comment contains our key by chance
    if version != SCHEMA_VERSION:
        raise UnsupportedSchema(
            f"table {table} has schema version {version}, and this release of cassandra_ros reads "
            f"only version {SCHEMA_VERSION}: export the topics of its keyspace with a release that "
            "reads them, and import them into another keyspace with this one"
        )
    if not is_topic:
        return None
    checked_values = {}
    for member in fields(TopicMetadata):
        name = member.name
        if name not in values:
            _warn_once(table, f"{name} is missing")
            return None
        if not _CHECKS[name](values[name]):
            _warn_once(table, f"{name} cannot be {values[name]!r:.80}")
            return None
        checked_values[name] = values[name]
    checked_values["columns"] = tuple(checked_values["columns"])
    checked_values["replaces"] = tuple(checked_values["replaces"])
    return TopicMetadata(**checked_values)


@lru_cache(maxsize=1024)
def _warn_once(table: str, reason: str) -> None:
    """Warn of a table that is left out.

    The cache makes a second call do nothing: comments are read every few seconds.
    """
    _log.warning(
        "table %s is left out: its comment was changed by hand or by another program, %s; put the "
        "comment right to read its messages again",
        table,
        reason,
    )


def _is_text(value: object) -> bool:
    """Return whether a value is a text that can be encoded as UTF-8."""
    try:
        return isinstance(value, str) and value.encode("utf-8") is not None
    except UnicodeEncodeError:
        return False


def _is_escaped_text(value: object) -> bool:
    """Return whether a value is a text; bytes that are not UTF-8 are surrogates in it."""
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


def _is_one_of(choices: tuple[str, ...], value: object) -> bool:
    return isinstance(value, str) and value in choices


def _is_mapping(value: object) -> bool:
    """Return whether a value is a JSON object with texts as keys and any values."""
    return isinstance(value, dict) and all(map(_is_text, value))


def _is_texts(value: object) -> bool:
    """Return whether a value is a JSON object with texts as keys and values."""
    return isinstance(value, dict) and all(map(_is_text, (*value, *value.values())))


def _is_indexes(value: object) -> bool:
    """Return whether a value maps fields to shadow columns."""
    return (
        isinstance(value, dict)
        and all(map(_is_text, value))
        and all(isinstance(v, str) and _SHADOW_COLUMN.fullmatch(v) for v in value.values())
    )


def _is_list(is_member: Callable[[object], bool], value: object) -> bool:
    return isinstance(value, (list, tuple)) and all(map(is_member, value))


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
    **dict.fromkeys(("generation", "span_ns", "since_us"), _is_integer),
    "index_count": partial(_is_integer, most=10**9),
    "version": partial(_is_integer, least=1),
    **dict.fromkeys(("own_time", "filling", "cut"), _is_bool),
    "indexes": _is_indexes,
    "index_names": _is_texts,
    "columns": partial(_is_list, _is_mapping),
    "replaces": partial(_is_list, _is_name),
    "user": _is_mapping,
}
"""Field of TopicMetadata -> check of its value in a comment. Each field needs one."""


FACTS = (
    "topic msg_type msg_class msg_package md5sum definition key_format key_part format nodeID "
    "nodeIDs comment date ttl indexes"
).split()
"""Keys of getMeta that the package sets; all other keys are the user's own."""


class MetaView(Mapping[str, Any]):
    """The metadata of a topic; ``getMeta['msg_class']`` and ``getMeta('msg_class')`` are the same.

    Args:
        metadata: Metadata of one of the topic's tables, with the indexes of all.
        nodes: nodeIDs of the robots that have stored messages. If there is only one it stands for
            a nodeID that was not given to addTopic.
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
