# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One topic table as rows: its statements, and our own columns in Cassandra's encoding."""

from __future__ import annotations

import struct
from functools import lru_cache, partial
from typing import (
    Callable,
    Iterable,
    Mapping,
    NamedTuple,
    Optional,
    Protocol,
    Sequence,
    Tuple,
    TypeVar,
)

from cassandra.cluster import ResponseFuture, ResultSet
from cassandra.query import UNSET_VALUE, BoundStatement, PreparedStatement, Statement

from cassandra_ros.errors import CorruptMessage
from cassandra_ros.keys import Position
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.read import Terms
from cassandra_ros.store.connection.cassandra import Cassandra
from cassandra_ros.store.connection.cql_names import chunk_table_name, qualified, quote_name
from cassandra_ros.store.connection.protocol import Offsets
from cassandra_ros.store.connection.requests import (
    IsRefused,
    OnPage,
    PagedRead,
    RawRow,
    await_answer,
    retried,
)

UNSET = UNSET_VALUE
LARGE_MESSAGE_CHUNK_BYTES = 512 * 1024
"""Size of a chunk of a message, bytes. A larger message goes to the chunk table in pieces of this
size. Another size is another schema version."""
INLINE_COLUMN_BYTES = 64 * 1024
"""Maximum size of a column in the row of a chunked message, bytes. Larger columns are left
unset."""
ODD = b"\x01"
"""Encoded value of ``_odd``."""
MIN_SEQ, MAX_SEQ = -(2**63), 2**63 - 1
_PACK = struct.Struct(">qqqi")
"""Values of ``_t``, ``_seq``, ``_conn`` and ``_size``, encoded, one after the other."""
_SPLIT = struct.Struct("8s8s8s4s")
"""The same as four byte strings."""
_LONG = struct.Struct(">q")
_INT = struct.Struct(">i")
_OWN = ("_t", "_seq", "_conn", "_size", "_nchunks", "_crc", "_odd", "_raw")
"""Our own columns of a message's row after its partition key, with which each listing begins."""
_BLOCK = ("_last", "_n", "_data", "_crc", "_nchunks", "_odd", "_gone", "_nan")
"""Our own columns of a block's row after the first four of _OWN."""
KEYS = '"_t", "_seq"'
"""Columns of the key of a row in its partition, as CQL."""
COUNTED_COLUMNS = '"_t", "_seq", "_size", "_nchunks", "_odd"'
"""Columns that a count needs, as CQL."""
_RANGE = 'AND ("_t", "_seq") >= (?, ?) AND ("_t", "_seq") <= (?, ?)'
_ROW = 'AND "_t" = ? AND "_seq" = ?'
_OLDER = "USING TIMESTAMP ? "
_NEWEST = ' ORDER BY "_t" DESC, "_seq" DESC'
_T = TypeVar("_T")

PartitionKey = Tuple[bytes, bytes]
"""Encoded partition key: the nodeID, and the bucket or the name of a message."""
Order = Tuple[int, int]
"""``_t`` and ``_seq`` of a row: its key in its partition."""
FIRST: Order = (-(2**63), MIN_SEQ)
"""An Order before those of all rows."""
LAST: Order = (2**63 - 1, MAX_SEQ)
"""An Order after those of all rows."""
ALL = (FIRST, LAST)
"""Range of a whole partition."""
Encoded = Tuple[Sequence[Optional[bytes]], bool, Optional[bytes]]
"""Encoded values of the format's columns (None = unset), whether the row must be marked odd, and
the message if the columns cannot give it back."""
Indexed = Tuple[Sequence[Optional[bytes]], bool]
"""Encoded values of the shadow columns (None = unset), and whether the row must be marked odd."""
Zones = Tuple[Sequence[Optional[bytes]], Tuple[str, ...], bool]
"""Encoded values of the zone columns (None = unset), names of the fields with a NaN value (sorted),
and whether the block must be marked odd."""


class NewRow(NamedTuple):
    """A message that is about to be stored as a row."""

    t: int
    """Key time, ns; 0 if equal messages are stored once."""
    seq: int
    """Writer id << 32 | counter, fixed before the first attempt; 0 if equal messages are stored
    once."""
    conn: int
    wire: bytes
    columns: Sequence[bytes | None] | None
    """Encoded values of the format's columns and of the columns with the receive time (None =
    unset). None instead of all: they are encoded when the batch of the row is sent."""
    odd: bool = False
    """Whether the row must be marked odd, because some column does not hold its field exactly."""
    raw: bytes | None = None
    """The message, if the columns cannot give it back."""
    name: str = ""
    """Name of a row that is found by name; '' otherwise."""


class SentRequest(NamedTuple):
    """A request whose answer has not been awaited yet."""

    future: ResponseFuture


class BlockKey(NamedTuple):
    """Key of the row of a block."""

    t: int
    """Key time of its first message, ns."""
    seq: int
    messages: int
    """Number of messages when the block was written."""


class TableRow(NamedTuple):
    """A row as read from its table, columns undecoded."""

    t: int
    node: str
    seq: int
    table: str
    conn: int
    size: int
    nchunks: int
    """Number of chunks; 0 = the message is in the row."""
    crc: int
    odd: bool
    raw: bytes | None
    columns: tuple[bytes | None, ...]
    name: str = ""
    """Name of a row that is found by name; '' otherwise."""
    received: int = -1
    """Receive time of the message, ns; -1 = it equals the key time."""
    block: BlockKey | None = None
    """Block of the message; None = the message has its own row."""
    place: int = 0
    """Position of the message in its block, from 0."""

    @property
    def position(self) -> Position:
        """Position of the row in the order of all reads."""
        return Position(self.t, self.node, self.seq, self.table, self.name)


_new_row = partial(tuple.__new__, TableRow)


class RowTable:
    """One topic table: its statements, prepared when first needed, and its rows.

    Args:
        encoder: Turns messages into the columns of its rows, and back.
        indexes: Turns messages into the columns of its indexes.

    Attributes:
        named: Whether rows are found by a name and not by their time.
        partition: Name of the second column of the partition key.
        packed: Whether a row of the table is a block; readers get each message as a row.
        bucket_ns: Length of a time bucket, ns.
        columns: Names of the format's columns.
        zone_columns: Names of the columns with minimum and maximum values in a block.
        longest_text: Maximum size of a text of a large message that has a column, bytes of UTF-8.
    """

    longest_text = INLINE_COLUMN_BYTES

    def __init__(
        self,
        cassandra: Cassandra,
        keyspace: str,
        name: str,
        metadata: TopicMetadata,
        encoder: RowEncoder,
        indexes: IndexEncoder,
    ) -> None:
        self._cassandra = cassandra
        self.name = name
        self.qualified = qualified(keyspace, name)
        self._chunks = qualified(keyspace, chunk_table_name(name))
        self.metadata = metadata
        self.encoder = encoder
        self.columns = tuple(encoder.columns)
        self.zone_columns = tuple(encoder.zone_columns)
        self._indexes = indexes
        self.named = metadata.named
        self.partition = metadata.partition
        self.packed = metadata.packed
        self.bucket_ns = metadata.bucket_ns
        # Conditions on the partition key: its two parameters come first in each statement.
        self._where = f'WHERE "_node" = ? AND "{self.partition}" = ?'
        self._stores_once = metadata.key_format == "hash"
        """Whether equal messages share a row, in the order (0, 0)."""
        self._received = tuple(metadata.received_columns)
        self._has_plain_keys = not (self._received or self.named)
        """Whether the keys of a row say its position and its receive time."""
        self._whole_listing = self.listing(self.columns)
        self.known_nodes: set[str] = set()
        """nodeIDs known to have written to the table; there may be more."""
        self.has_chunks = False
        """Whether the chunk table is known to exist."""

    def follow(self, metadata: TopicMetadata) -> None:
        """Take over the present metadata from the comment of the table.

        What the constructor took from the metadata never changes.
        """
        self.metadata = metadata

    def note_chunks(self) -> None:
        """Note that the chunk table exists."""
        self.has_chunks = True

    def bucket_of(self, t_ns: int) -> int:
        """Return the bucket of a key time."""
        return t_ns // self.bucket_ns

    def partition_key(self, node: str, where: int | str) -> PartitionKey:
        """Encode the partition key of a bucket, or of the rows with a name; ``where`` is either."""
        key = encode_long(where) if isinstance(where, int) else where.encode("utf-8")
        return node.encode("utf-8"), key

    def partition_key_of(self, node: str, t_ns: int, name: str) -> PartitionKey:
        """Encode the partition key of a row."""
        return self.partition_key(node, name if self.named else self.bucket_of(t_ns))

    def stored_order(self, t: int, seq: int) -> Order:
        """Return ``_t`` and ``_seq`` as stored: both 0 if equal messages are stored once."""
        return (0, 0) if self._stores_once else (t, seq)

    def key_of(self, row: TableRow) -> tuple[bytes, ...]:
        """Encode the primary key of a stored row."""
        partition_key = self.partition_key_of(row.node, row.t, row.name)
        return (*partition_key, *map(encode_long, self.stored_order(row.t, row.seq)))

    def shadows(self) -> Shadows | None:
        """Return the columns of the indexes for a bucket that is opened now; None = no index."""
        return self._indexes.shadows(self.metadata.indexes)

    def insert(self, shadows: Sequence[str] = (), *, full: bool = True) -> PreparedStatement:
        """Return the INSERT of a row.

        Args:
            shadows: Columns of indexes, whose values come last.
            full: Include the columns of chunks and ``_raw``, which few rows need.
        """
        own_columns = _OWN if full else _OWN[:4]
        names = ("_node", self.partition, *own_columns, *self.columns, *self._received, *shadows)
        marks = ", ".join("?" * len(names))
        return self._prepare(f"INSERT INTO {self.qualified} ({_list(names)}) VALUES ({marks})")

    def insert_block(self) -> PreparedStatement:
        """Return the INSERT of a block: its key, the columns _BLOCK, and its zones."""
        return self.insert_stored(self.block_columns, expires=False)

    def insert_chunk(self) -> PreparedStatement:
        """Return the INSERT of one chunk of a large message."""
        names = _list(("_node", self.partition, "_t", "_seq", "_chunk", "_data"))
        return self._prepare(f"INSERT INTO {self._chunks} ({names}) VALUES (?, ?, ?, ?, ?, ?)")

    @property
    def row_columns(self) -> tuple[str, ...]:
        """Names of the columns of a message's row after its partition key, without indexes."""
        return (*_OWN, *self.columns, *self._received)

    @property
    def block_columns(self) -> tuple[str, ...]:
        """Names of the columns of a block's row after its partition key."""
        return (*_OWN[:4], *_BLOCK, *self.zone_columns)

    def insert_stored(self, names: Sequence[str], *, expires: bool) -> PreparedStatement:
        """Return the INSERT of a row with these columns after its partition key.

        Args:
            expires: The last parameter is the time to live, s.
        """
        all_names = ("_node", self.partition, *names)
        marks = ", ".join("?" * len(all_names))
        using = " USING TTL ?" if expires else ""
        cql = f"INSERT INTO {self.qualified} ({_list(all_names)}) VALUES ({marks}){using}"
        return self._prepare(cql)

    def insert_stored_chunk(self) -> PreparedStatement:
        """Return the INSERT of a chunk of a large message; the last parameter is its TTL, s."""
        names = _list(("_node", self.partition, "_t", "_seq", "_chunk", "_data"))
        values = "VALUES (?, ?, ?, ?, ?, ?) USING TTL ?"
        return self._prepare(f"INSERT INTO {self._chunks} ({names}) {values}")

    def select_chunks(self) -> PreparedStatement:
        """Return the SELECT of all chunks of one large message, in order."""
        return self._prepare(f'SELECT "_chunk", "_data" FROM {self._chunks} {self._where} {_ROW}')

    def select_partitions(self) -> PreparedStatement:
        """Return the SELECT of the partition keys that have rows, in no order."""
        return self._prepare(f'SELECT DISTINCT "_node", "{self.partition}" FROM {self.qualified}')

    def select_chunked(self) -> PreparedStatement:
        """Return the SELECT of the keys of messages with chunks, and a chunk's write time, us."""
        names = f'"_node", "{self.partition}", {KEYS}, WRITETIME("_data")'
        return self._prepare(f"SELECT {names} FROM {self._chunks} PER PARTITION LIMIT 1")

    def _select(self, names: str, rest: str) -> PreparedStatement:
        """Return the SELECT of columns in one partition; ``rest`` = CQL after its key."""
        return self._prepare(f"SELECT {names} FROM {self.qualified} {self._where} {rest}")

    def select_these(self, columns: Sequence[str], *, reverse: bool) -> PreparedStatement:
        """Return the SELECT of rows of one partition by a list of (t, seq)."""
        rest = f'AND ("_t", "_seq") IN ?{_NEWEST if reverse else ""}'
        return self._select(self.listing(columns), rest)

    def select_listed(self, names: str) -> PreparedStatement:
        """Return the SELECT of columns, as CQL, of rows of one partition by a list of (t, seq)."""
        return self._select(names, 'AND ("_t", "_seq") IN ?')

    def select_over(self, names: str) -> PreparedStatement:
        """Return the SELECT of columns, as CQL, of the blocks that may hold a message.

        Parameters are the partition key, the ranges of ``_t`` and of ``_seq``, and a key time.
        Blocks whose last message is earlier than that are left out.
        """
        return self._select(
            names,
            'AND "_t" >= ? AND "_t" <= ? AND "_seq" >= ? AND "_seq" <= ? AND "_last" >= ? '
            "ALLOW FILTERING",
        )

    def select_names(self, *more: str) -> PreparedStatement:
        """Return the SELECT of all keys of a table whose rows have names, in no order.

        Args:
            more: Further columns, as CQL.
        """
        names = ", ".join(
            ['"_node", "_key"', COUNTED_COLUMNS, *map(quote_name, self._received), *more]
        )
        return self._prepare(f"SELECT {names} FROM {self.qualified}")

    def select_shadow(self, shadow: str, *, bucket: bool) -> PreparedStatement:
        """Return the SELECT of keys by an indexed column, in one bucket (in order) or in all."""
        where = f"{self._where} AND" if bucket else "WHERE"
        return self._prepare(
            f'SELECT "_node", "_t", "_seq" FROM {self.qualified} '
            # The server filters only if the index is missing: a client died before making it.
            f"{where} {quote_name(shadow)} = ? ALLOW FILTERING"
        )

    def update(self, column: str) -> PreparedStatement:
        """Return the UPDATE of a column of one row.

        Parameters are the timestamp (us), the time to live (s, 0 = for ever), the value, the key.
        """
        return self._prepare(
            f"UPDATE {self.qualified} USING TIMESTAMP ? AND TTL ? "
            f"SET {quote_name(column)} = ? {self._where} {_ROW}"
        )

    def delete_range(self, *, older: bool = False) -> str:
        """Return the DELETE of a range of one partition, both ends included, as CQL.

        Parameters, not encoded, are the partition key and ``_t`` and ``_seq`` of both ends.

        Args:
            older: Delete only rows written up to a timestamp, us, which is the first parameter.
        """
        return f"DELETE FROM {self.qualified} {_OLDER if older else ''}{self._where} {_RANGE}"

    def delete_one(self, *, chunks: bool = False, older: bool = False) -> str:
        """Return the DELETE of one row, or of its message's chunks, as CQL; see delete_range."""
        table = self._chunks if chunks else self.qualified
        return f"DELETE FROM {table} {_OLDER if older else ''}{self._where} {_ROW}"

    def mark_gone(self) -> str:
        """Return the UPDATE, as CQL, that adds to the positions of a block's deleted messages."""
        return f'UPDATE {self.qualified} SET "_gone" = "_gone" + ? {self._where} {_ROW}'

    def unmark_gone(self) -> str:
        """Return the DELETE, as CQL, of the positions that mark_gone added, not of the block."""
        return f'DELETE "_gone" FROM {self.qualified} {self._where} {_ROW}'

    def _prepare(self, cql: str) -> PreparedStatement:
        return self._cassandra.prepare(cql)

    def listing(self, columns: Sequence[str] | None = None) -> str:
        """Return the columns that row_from_values reads, as CQL.

        Args:
            columns: Those of the format's columns that are included; None = all.
        """
        if columns is None:
            return self._whole_listing
        return _list((*_OWN, *self._received, *columns))

    def select_range(
        self,
        names: str,
        partition_key: PartitionKey,
        ends: tuple[Order, Order] = ALL,
        *,
        terms: Terms = (),
        page_rows: int | None = None,
        first_rows: int = 0,
        reverse: bool = False,
        last: RawRow | None = None,
        what: str = "reading",
        refused: IsRefused | None = None,
        on_page: OnPage | None = None,
    ) -> PagedRead:
        """Request the rows of one partition in a range, or those of them after ``last``.

        Args:
            names: Columns to read, as CQL; must begin with KEYS if there may be several pages,
                because a read whose later page fails goes on after the key of the last row.
            ends: First and last key, both included.
            terms: Conditions that the server checks.
            page_rows: Maximum number of rows in a page; None = the driver's own.
            first_rows: Number of rows of the first page if it should be smaller; see PagedRead.
            last: A row that an earlier read of these columns returned; None = from the beginning.
            refused, on_page: See PagedRead.
        """
        checks = tuple((name, operator) for name, operator, _ in terms)
        statement = self._select(names, _in_range(checks, reverse))
        values = [value for *_, value in terms]

        def rest(read: RawRow | None) -> BoundStatement:
            bounds = _encode_ends(ends, read or last, reverse)
            return bind(statement, (*partition_key, *bounds, *values), page_rows)

        return self._start(rest, what, refused, on_page, first_rows)

    def ask_row(self, partition_key: PartitionKey, t: int, seq: int | None) -> PagedRead:
        """Request a whole row; seq None = the first one with this time.

        A server finds a row by equal keys 60 us sooner than by a range that holds one key.
        """
        if seq is None:
            statement = self._select(self._whole_listing, 'AND "_t" = ?')
            return self.send(bind(statement, (*partition_key, encode_long(t)), 1))
        statement = self._select(self._whole_listing, _ROW)
        values = (*partition_key, encode_long(t), encode_long(seq))
        return self.send(bind(statement, values))

    def send(self, statement: Statement, what: str = "reading") -> PagedRead:
        """Send a statement whose answer is one page, or of which only the first page is needed.

        If a later page fails, the read begins anew, and yields earlier rows a second time.
        """
        return self._start(lambda last: statement, what)

    def _start(
        self,
        statement_from: Callable[[RawRow | None], Statement],
        what: str,
        refused: IsRefused | None = None,
        on_page: OnPage | None = None,
        first_rows: int = 0,
    ) -> PagedRead:
        send, outage = self._cassandra.ask_raw, self._cassandra.outage
        return PagedRead(
            send, statement_from, self._doing(what), refused, on_page, first_rows, outage
        )

    def collect(
        self,
        statement: BoundStatement,
        make: Callable[[ResultSet], _T],
        what: str = "reading",
        *,
        sent: SentRequest | None = None,
    ) -> _T:
        """Pass all rows of a statement to ``make``; start again if one of its pages fails.

        Args:
            make: Makes the result. It is called again after a failure, so it must have no effects.
            sent: Result of ``begin`` for this statement; None = it has not been sent.
        """
        requests = [sent] if sent is not None else []

        def run() -> _T:
            future = (requests.pop() if requests else self.begin(statement)).future
            return make(await_answer(future, outage))

        outage = self._cassandra.outage
        return retried(self._doing(what), run, outage=outage)

    def begin(self, statement: BoundStatement) -> SentRequest:
        """Send a statement whose rows ``collect`` will take."""
        return SentRequest(self._cassandra.send_raw(statement))

    def _doing(self, what: str) -> str:
        return f"{what} topic {self.metadata.topic}"

    def is_rest(self, values: RawRow) -> bool:
        """Return whether a row has expired except for the value of an index, which stays longer.

        Args:
            values: Columns of the row; the third must be one that each row has.
        """
        return values[2] is None and bool(self.metadata.ttl)

    def row_from_values(self, node: str, values: RawRow, name: str = "") -> TableRow:
        """Return a row from the values of a listing.

        Raises:
            CorruptMessage: ``_conn`` or ``_size`` is null.
        """
        try:
            t, seq, conn, size = _PACK.unpack(b"".join(values[:4]))  # type: ignore[arg-type]
        except TypeError as exc:
            raise CorruptMessage(
                f"a row of topic {self.metadata.topic} in table {self.name} has no connection or "
                "size: something else than this package wrote or updated it"
            ) from exc
        nchunks, crc, odd, raw = values[4:8]
        if nchunks is None and odd is None and self._has_plain_keys:
            head = t, node, seq, self.name, conn, size, 0, 0, False, raw, values[8:]
            return _new_row((*head, "", -1, None, 0))  # takes a third of the time, for every row
        received = decode_long(values[8]) if self._received else -1
        if self._stores_once:  # the stored ones are 0
            t, seq = received, decode_long(values[9])
        columns = values[8 + len(self._received) :]
        flags = decode_long(nchunks), decode_long(crc), odd == ODD, raw
        return TableRow(t, node, seq, self.name, conn, size, *flags, columns, name, received)


def encode_own(t: int, seq: int, conn: int, size: int) -> tuple[bytes, ...]:
    """Encode ``_t``, ``_seq``, ``_conn`` and ``_size`` as Cassandra stores them."""
    return _SPLIT.unpack(_PACK.pack(t, seq, conn, size))


def encode_long(value: int) -> bytes:
    """Encode a bigint."""
    return _LONG.pack(value)


def decode_long(raw: bytes | None) -> int:
    """Decode a bigint or an int; null becomes 0."""
    return int.from_bytes(raw or b"", "big", signed=True)


def encode_int(value: int) -> bytes:
    """Encode an int."""
    return _INT.pack(value)


def encode_texts(values: Iterable[str]) -> bytes:
    """Encode a set of texts."""
    encoded = sorted(value.encode("utf-8") for value in values)
    return encode_int(len(encoded)) + b"".join(encode_int(len(raw)) + raw for raw in encoded)


def encode_orders(orders: Sequence[tuple[bytes, bytes]]) -> bytes:
    """Encode pairs of encoded ``_t`` and ``_seq`` as a list of tuples."""
    size = encode_int(8)
    pairs = (encode_int(24) + size + t + size + seq for t, seq in orders)
    return encode_int(len(orders)) + b"".join(pairs)


def _encode_ends(
    ends: tuple[Order, Order], last: RawRow | None, reverse: bool
) -> tuple[bytes, ...]:
    """Encode the range of the rows that follow the last row that was read, in order of reading."""
    low, high = ends
    if last is not None and reverse:
        high = (decode_long(last[0]), decode_long(last[1]) - 1)
    elif last is not None:
        low = (decode_long(last[0]), decode_long(last[1]) + 1)
    return tuple(map(encode_long, (*low, *high)))


@lru_cache(maxsize=1024)
def _list(names: tuple[str, ...]) -> str:
    """Return names of columns as CQL."""
    return ", ".join(quote_name(name) for name in names)


@lru_cache(maxsize=1024)
def _in_range(checks: tuple[tuple[str, str], ...], reverse: bool) -> str:
    """Return the end of the SELECT of a range; ``checks`` are columns and operators."""
    conditions = "".join(f" AND {quote_name(name)} {operator} ?" for name, operator in checks)
    order, allow = _NEWEST if reverse else "", " ALLOW FILTERING" if checks else ""
    return f"{_RANGE}{conditions}{order}{allow}"


def bind(
    statement: PreparedStatement, values: Iterable[bytes | memoryview], page_rows: int | None = None
) -> BoundStatement:
    """Bind values that are already encoded; page_rows = maximum number of rows in a page."""
    bound = BoundStatement(statement)
    bound.values = list(values)
    if page_rows is not None:
        bound.fetch_size = page_rows
    return bound


class RowEncoder(Protocol):
    """Turns serialised messages into the columns of rows, and back."""

    @property
    def columns(self) -> Sequence[str]:
        """Names of the format's columns, in the format's order."""

    @property
    def zone_columns(self) -> Sequence[str]:
        """Names of the columns with minimum and maximum values in a block."""

    def encode_wire(self, wire: bytes) -> Encoded:
        """Return the columns of a message."""

    def encode_together(self, wires: Sequence[bytes]) -> Sequence[bytes | None]:
        """Return the columns of each message, each column after its size.

        None for a message = encode_wire must encode it. There is one result for each message.
        """

    def decode_together(
        self, data: bytes, starts: Offsets, ends: Offsets, sizes: Offsets
    ) -> Sequence[bytes | None]:
        """Return the messages, of these sizes, whose columns are from starts to ends in data.

        Each column follows its size. None for a message = the row must be decoded by itself.
        """

    def zones(self, wires: Sequence[bytes]) -> Zones:
        """Return the zones of serialised messages; the bytes may be damaged."""


class Shadows(NamedTuple):
    """The columns of a table's indexes."""

    names: tuple[str, ...]
    values: Callable[[bytes], Indexed]
    """Returns the values of the columns for a serialised message."""


class IndexEncoder(Protocol):
    """Turns serialised messages into the columns of indexes."""

    def shadows(self, indexes: Mapping[str, str]) -> Shadows | None:
        """Return the columns of a table's indexes; None if it has no index.

        Args:
            indexes: Indexed field → shadow column, as the table's comment says.
        """
