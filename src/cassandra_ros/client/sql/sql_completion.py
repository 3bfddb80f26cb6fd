# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Completion of an SQL statement that is being typed: tables after FROM and JOIN, else columns."""

from __future__ import annotations

import re
from typing import Callable, Iterator, Sequence

from cassandra_ros.client.sql.event_names import EVENT, has_event_field
from cassandra_ros.client.sql.listed_tables import LISTED
from cassandra_ros.client.sql.sql_statement import MAX_STATEMENT_CHARACTERS
from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.arrays.arrow_types import OWN_COLUMNS, ArrowField, ColumnNames, fields_of
from cassandra_ros.query.tree.statement_completion import MAX_OFFERS, Offer, Offers

DefinitionsOf = Callable[[str], Sequence[Definition]]
"""Returns the definitions of a topic in any spelling; empty if it is not stored."""

_KEYWORDS = (
    *("SELECT", "DISTINCT", "FROM", "WHERE", "GROUP BY", "HAVING", "ORDER BY", "LIMIT", "WITH"),
    *("JOIN", "ASOF JOIN", "LEFT JOIN", "ON", "USING", "AND", "OR", "NOT", "IN", "BETWEEN", "LIKE"),
    *("IS NULL", "AS", "CASE", "WHEN", "THEN", "ELSE", "END", "OVER", "PARTITION BY", "INTERVAL"),
    *("UNION", "DESC"),
)
_FUNCTIONS = (
    *("count", "min", "max", "avg", "sum", "stddev", "quantile_cont", "arg_max", "abs", "round"),
    *("sqrt", "lag", "lead", "time_bucket", "epoch_ns", "epoch", "unnest", "now"),
    *("constant", "rate", "yaw", "degrees", "lat_lon_distance"),
)
_WORD_BACKWARDS = re.compile(r"[\w.]*")
_PLAIN_NAME = re.compile(r"[A-Za-z_]\w*")
_TABLE = re.compile(
    r"\b(?:from|join)\s+(\"(?:[^\"]|\"\")+\"|\w+)(?:\s+(?:as\s+)?(?=(\w+)))?", re.IGNORECASE
)
_TABLE_DUE = re.compile(r"\b(?:from|join)\s+$", re.IGNORECASE)
"""What stands before a word that is the name of a table."""
_MOST_SPACE = 64
"""Maximum number of characters before the word in which FROM or JOIN is looked for."""
_MOST_SEARCHED = 8 * 1024
"""Length of the part of a statement in which tables are looked for, characters."""
_NO_ALIAS = {word.lower() for phrase in _KEYWORDS for word in phrase.split()}


def complete_sql(
    text: str,
    cursor: int,
    topics: Sequence[str],
    definitions: DefinitionsOf,
    most: int = MAX_OFFERS,
) -> Offers:
    """Return the possible completions at a position of a statement.

    Args:
        text: The statement as typed so far; may continue after the cursor.
        cursor: The position, 0 to the length of the text; a larger one is reduced to that.
        topics: Names of the topics.
        definitions: See DefinitionsOf.
        most: Maximum number of offers.
    """
    cursor = max(0, min(cursor, len(text), MAX_STATEMENT_CHARACTERS))
    before = text[:cursor]
    quoted = before.count('"') % 2 == 1
    if before.count("'") % 2:  # in a text
        return Offers(cursor, ())
    word = _WORD_BACKWARDS.match(before[::-1])
    start = before.rindex('"') if quoted else cursor - (0 if word is None else word.end())
    if _TABLE_DUE.search(before[max(0, start - _MOST_SPACE) : start]):
        offers = list(_tables(topics))
    elif quoted:
        return Offers(start, ())
    else:
        offers = [*_columns(text[:_MOST_SEARCHED], definitions), *_words()]
    typed = before[start:].strip('"').lower()
    fitting = [offer for offer in offers if _fits(offer, typed)]
    fitting.sort(key=lambda offer: not offer.text.lower().strip('"/').startswith(typed.strip("/")))
    is_complete = len(fitting) == 1 and fitting[0].text == before[start:]
    return Offers.first(start, () if is_complete else fitting, most)


def table_text(topic: str) -> str:
    """Return the name of a topic as it stands in a statement, in quotes if needed."""
    bare = topic.lstrip("/")
    plain = _PLAIN_NAME.fullmatch(bare) and bare.lower() not in {*_NO_ALIAS, *LISTED}
    return bare if plain else '"' + topic.replace('"', '""') + '"'


def _fits(offer: Offer, typed: str) -> bool:
    """Return whether an offer begins with what is typed; names may also contain it."""
    text = offer.text.lower()
    return text.startswith(typed) if offer.kind in ("keyword", "function") else typed in text


def _tables(topics: Sequence[str]) -> Iterator[Offer]:
    yield from (Offer(table_text(topic), "topic") for topic in topics)
    yield from (Offer(name, "table") for name in LISTED)
    yield Offer("tf('", "function", "poses of a frame in another")
    yield Offer("nearest('", "function", "messages, each with the nearest one of another topic")
    yield Offer("joints('", "function", "the joints of a topic of sensor_msgs/JointState")


def _words() -> Iterator[Offer]:
    yield from (Offer(f"{name}(", "function") for name in _FUNCTIONS)
    yield from (Offer(word, "keyword") for word in _KEYWORDS)


def _columns(text: str, definitions: DefinitionsOf) -> Iterator[Offer]:
    """Yield the columns of the tables that a statement names; of several with their alias."""
    tables = [(match[1], match[2] or "") for match in _TABLE.finditer(text)]
    columns: dict[str, str] = {}
    for name, alias in tables:
        bare = name[1:-1].replace('""', '"') if name.startswith('"') else name
        qualifier = name if not alias or alias.lower() in _NO_ALIAS else alias
        prefix = f"{qualifier}." if len(tables) > 1 else ""
        for column, kind in _columns_of(bare, definitions):
            columns.setdefault(prefix + column, kind)
    yield from (Offer(column, "field", kind) for column, kind in columns.items())


def _columns_of(table: str, definitions: DefinitionsOf) -> Iterator[tuple[str, str]]:
    """Yield name and type of the columns of a table, and of the fields in them, as dotted names."""
    if table.lower() in LISTED:
        yield from LISTED[table.lower()][0].items()
        return
    types = definitions(table)
    if types:
        yield from zip(OWN_COLUMNS, ("time", "string", "string"))
        if not has_event_field(types):
            yield EVENT, "string[]"
    names = ColumnNames()
    for definition in types:
        yield from _leaves(fields_of(definition, None, names), "")


def _leaves(fields: Sequence[ArrowField], prefix: str) -> Iterator[tuple[str, str]]:
    """Yield dotted name and ROS type of fields, and of the fields in them, but not in arrays."""
    for child in fields:
        yield prefix + child.name, child.field.type + "[]" * child.field.is_array
        if not child.field.is_array:
            yield from _leaves(child.children, f"{prefix}{child.name}.")
