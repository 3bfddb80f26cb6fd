# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What may stand next in a statement that is being typed, by the grammar's own state.

What stands before the word at the cursor is parsed as far as it goes; what the grammar accepts
there are keywords, and places for topics, fields and values, of which whoever asks knows the names.
"""

from __future__ import annotations

import re
from typing import Callable, NamedTuple, Optional, Sequence, Set

from lark import Token, UnexpectedInput

from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.tree.field_names import all_fields
from cassandra_ros.query.tree.parse import MAX_STATEMENT, grammar
from cassandra_ros.query.tree.syntax import StatementError

MOST = 200
"""So many are offered."""
_WORD_BACKWARDS = re.compile(r"[\w./\[\]~]*")
"""From its end on: a search for it would begin at each character of a long text."""
_TOPIC = re.compile(r"\bfrom\s+(\"(?:[^\"]|\"\")+\"|[\w/~]+)", re.IGNORECASE)
_PLAIN_TOPIC = re.compile(r"/?[A-Za-z~_][A-Za-z0-9_/~]*")
_KEYWORDS = {
    "_SELECT": "SELECT",
    "DISTINCT": "DISTINCT",
    "_FROM": "FROM",
    "_WHERE": "WHERE",
    "_GROUP": "GROUP BY",
    "_ORDER": "ORDER BY",
    "_BY": "BY",
    "_LIMIT": "LIMIT",
    "_OR": "OR",
    "_AND": "AND",
    "NOT": "NOT",
    "_IN": "IN (",
    "_BETWEEN": "BETWEEN",
    "LIKE": "LIKE",
    "CONTAINS": "CONTAINS",
    "_IS": "IS NULL",
    "NEAR": "NEAR(",
    "_NULL": "NULL",
    "_AS": "AS",
    "ASC": "ASC",
    "DESC": "DESC",
    "KEY": "KEY",
    "NODE": "NODE",
    "RUN": "RUN",
    "TRUE": "true",
    "FALSE": "false",
    "STAR": "*",
}
"""How they are offered; what changes the store is not."""
_FUNCTIONS = ("avg", "count", "len", "max", "min", "sum", "abs", "sqrt", "time", "now")
_QUANTIFIERS = ("any", "all")


class Offer(NamedTuple):
    """One thing that may stand at the cursor."""

    text: str
    """What replaces the word there."""
    kind: str
    """'topic', 'field', 'keyword', 'function' or 'value'."""
    note: str = ""
    """The type of a field, say."""


class Offers(NamedTuple):
    """What may stand at the cursor, the likeliest first."""

    start: int
    """Where the word begins that is replaced; it ends at the cursor."""
    offers: Sequence[Offer]


class Known(NamedTuple):
    """Who knows the names."""

    topics: Callable[[], Sequence[str]]
    definitions: Callable[[str], Sequence[Definition]]
    """Of a topic, however it is spelt; none where it is not stored."""
    nodes: Callable[[], Sequence[str]]
    runs: Callable[[], Sequence[str]]


def complete(text: str, cursor: int, known: Known) -> Offers:
    """Return what may stand at a place of a statement.

    Args:
        text: The statement, as far as it is typed; may go on behind the cursor.
        cursor: The place, 0 to its length; what is beyond is taken for that.
    """
    cursor = max(0, min(cursor, len(text), MAX_STATEMENT))
    before = text[:cursor]
    start = _begin(before)
    tokens = _tokens(before[:start])
    if tokens is None:
        return Offers(cursor, ())
    accepted, previous = tokens
    offers = _offers(accepted, previous, text, known)
    word = before[start:].lower()
    fitting = [_indexed(offer, before[start:]) for offer in offers if _fits(offer, word)]
    # What begins with the word first; else as they are, for fields have the order of the message.
    fitting.sort(key=lambda offer: not offer.text.lower().lstrip("/").startswith(word.lstrip("/")))
    alone = len(fitting) == 1 and fitting[0].text == before[start:]
    return Offers(start, () if alone else tuple(fitting[:MOST]))


def _begin(before: str) -> int:
    """Return where the word begins that ends with a text, or the value in quotes."""
    if before.count("'") % 2:
        return before.rindex("'")
    found = _WORD_BACKWARDS.match(before[::-1])
    return len(before) - (0 if found is None else found.end())


def _fits(offer: Offer, word: str) -> bool:
    if not word:
        return True
    text = offer.text.lower()
    if offer.kind in ("keyword", "function"):
        return text.startswith(word)
    return word in text or _without_indexes(word) in text


def _indexed(offer: Offer, word: str) -> Offer:
    """Return a field with the indexes that were typed already."""
    plain = _without_indexes(word)
    begins = offer.kind == "field" and offer.text.lower().startswith(plain.lower())
    if plain == word or not begins:
        return offer
    return offer._replace(text=word + offer.text[len(plain) :])


def _without_indexes(word: str) -> str:
    return re.sub(r"\[\d*\]?", "", word)


def _tokens(before: str) -> Optional[tuple[Set[str], Sequence[Token]]]:
    """Return which tokens the grammar takes behind a text, and those in it; None: it is wrong."""
    parser = grammar().parse_interactive(before, start="statement")
    previous: list[Token] = []
    try:
        for token in parser.iter_parse():
            previous.append(token)
    except (UnexpectedInput, StatementError):
        return None
    accepted: Set[str] = parser.accepts()  # type: ignore[no-untyped-call]
    return accepted, previous


def _offers(
    accepted: Set[str], previous: Sequence[Token], text: str, known: Known
) -> Sequence[Offer]:
    offers: list[Offer] = []
    if "TOPIC" in accepted:
        offers += [Offer(_topic(name), "topic") for name in known.topics()]
    offers += _values(previous, accepted, known)
    if "NAME" in accepted and "_ON" not in accepted and not _names_something(previous):
        offers += _fields(text, known)
    if "FUNCTION" in accepted:
        wanted = _FUNCTIONS + (_QUANTIFIERS if _is_condition(previous) else ())
        offers += [Offer(f"{name}(", "function") for name in wanted]
    if "STAR" in accepted and previous and previous[-1].type != "_SELECT":
        accepted = accepted - {"STAR"}  # there it multiplies
    offers += [Offer(word, "keyword") for name, word in _KEYWORDS.items() if name in accepted]
    return offers


def _topic(name: str) -> str:
    return name if _PLAIN_TOPIC.fullmatch(name) else '"' + name.replace('"', '""') + '"'


def _names_something(previous: Sequence[Token]) -> bool:
    """Say whether a new name is to come."""
    return bool(previous) and previous[-1].type == "_AS"


def _is_condition(previous: Sequence[Token]) -> bool:
    places = [t.type for t in previous if t.type in ("_WHERE", "_GROUP", "_ORDER")]
    return places[-1:] == ["_WHERE"]


def _values(previous: Sequence[Token], accepted: Set[str], known: Known) -> Sequence[Offer]:
    """Return the nodes and runs that there are, where one is compared with a text."""
    if "TEXT" not in accepted or len(previous) < 2 or previous[-1].type != "OPERATOR":
        return ()
    names = {"NODE": known.nodes, "RUN": known.runs}.get(previous[-2].type)
    every = () if names is None else names()
    return [Offer("'" + name.replace("'", "''") + "'", "value") for name in every]


def _fields(text: str, known: Known) -> Sequence[Offer]:
    """Return the fields of the topic that the statement names, or of none while it names none."""
    named = _TOPIC.search(text)
    if named is None:
        return ()
    topic = named[1]
    if topic.startswith('"'):
        topic = topic[1:-1].replace('""', '"')
    fields: dict[str, str] = {}
    for definition in known.definitions(topic):
        for ref in all_fields(definition):
            fields.setdefault(ref.name, ref.type + "[]" * ref.is_array)
    return [Offer(name, "field", kind) for name, kind in fields.items()]
