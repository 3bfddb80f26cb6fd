# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Completion of a statement that is being typed, from the state of the grammar.

The text before the word at the cursor is parsed. What the grammar accepts next are keywords, and
names of topics, fields and values, which the caller provides.
"""

from __future__ import annotations

import re
from typing import Callable, NamedTuple, Sequence

from lark import Token, UnexpectedInput

from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.tree.field_names import all_fields
from cassandra_ros.query.tree.grammar import grammar
from cassandra_ros.query.tree.parse import MAX_STATEMENT
from cassandra_ros.query.tree.syntax import QUANTIFIERS, StatementError

MAX_OFFERS = 200
"""Usual maximum number of offers."""
_WORD_BACKWARDS = re.compile(r"[\w./\[\]~]*")
"""Pattern for the reversed text. A forward search would start at each character of a long text."""
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
    "EVENT": "EVENT '",
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
"""Keywords as they are offered, by token; those of statements that change the store are left
out."""
_FUNCTIONS = ("avg", "count", "len", "max", "min", "sum", "abs", "sqrt", "time", "now")


class Offer(NamedTuple):
    """One possible completion."""

    text: str
    """Text that replaces the word at the cursor."""
    kind: str
    """'topic', 'field', 'keyword', 'function' or 'value'."""
    note: str = ""
    """Additional information, as the type of a field."""


class Offers(NamedTuple):
    """Possible completions, best first."""

    start: int
    """Start of the word that is replaced; it ends at the cursor."""
    offers: Sequence[Offer]
    more: int = 0
    """Number of further ones."""

    @classmethod
    def first(cls, start: int, fitting: Sequence[Offer], most: int) -> Offers:
        """Return the first ones of the fitting ones, at most ``most``."""
        return cls(start, tuple(fitting[:most]), max(0, len(fitting) - most))


class NameSource(NamedTuple):
    """Functions that return the known names."""

    topics: Callable[[], Sequence[str]]
    definitions: Callable[[str], Sequence[Definition]]
    """Returns the definitions of a topic in any spelling; empty if it is not stored."""
    nodes: Callable[[], Sequence[str]]
    runs: Callable[[], Sequence[str]]


def complete(text: str, cursor: int, source: NameSource, most: int = MAX_OFFERS) -> Offers:
    """Return the possible completions at a position of a statement.

    Args:
        text: The statement as typed so far; may continue after the cursor.
        cursor: The position, 0 to the length of the text (at most MAX_STATEMENT); another one is
            moved to the nearest of these.
        source: Known names.
        most: Maximum number of offers.
    """
    cursor = max(0, min(cursor, len(text), MAX_STATEMENT))
    before = text[:cursor]
    start = _begin(before)
    tokens = _tokens(before[:start])
    if tokens is None:
        return Offers(cursor, ())
    accepted, previous = tokens
    offers = _offers(accepted, previous, text, source)
    word = before[start:].lower()
    fitting = [_indexed(offer, before[start:]) for offer in offers if _fits(offer, word)]
    # Names that begin with the word come first; the sort is stable, to keep fields in wire order.
    fitting.sort(key=lambda offer: not offer.text.lower().lstrip("/").startswith(word.lstrip("/")))
    complete_already = len(fitting) == 1 and fitting[0].text == before[start:]
    return Offers.first(start, () if complete_already else fitting, most)


def _begin(before: str) -> int:
    """Return the start of the last word of a text, or of its last open quote."""
    if before.count("'") % 2:
        return before.rindex("'")
    match = _WORD_BACKWARDS.match(before[::-1])
    return len(before) - (0 if match is None else match.end())


def _fits(offer: Offer, word: str) -> bool:
    """Return whether an offer may be what the word, in lower case, begins or is a part of."""
    if not word:
        return True
    text = offer.text.lower()
    if offer.kind in ("keyword", "function"):
        return text.startswith(word)
    return word in text or _without_indexes(word) in text


def _indexed(offer: Offer, word: str) -> Offer:
    """Return an offer; a field offer with the indexes that are typed already in ``word``."""
    plain = _without_indexes(word)
    begins = offer.kind == "field" and offer.text.lower().startswith(plain.lower())
    if plain == word or not begins:
        return offer
    return offer._replace(text=word + offer.text[len(plain) :])


def _without_indexes(word: str) -> str:
    return re.sub(r"\[\d*\]?", "", word)


def _tokens(before: str) -> tuple[set[str], Sequence[Token]] | None:
    """Return the types of tokens accepted after a text, and its tokens; None: it is wrong."""
    parser = grammar().parse_interactive(before, start="statement")
    previous: list[Token] = []
    try:
        for token in parser.iter_parse():
            previous.append(token)
    except (UnexpectedInput, StatementError):
        return None
    accepted: set[str] = parser.accepts()  # type: ignore[no-untyped-call]
    return accepted, previous


def _offers(
    accepted: set[str], previous: Sequence[Token], text: str, source: NameSource
) -> Sequence[Offer]:
    """Return all that may follow the tokens before the word at the cursor, whatever the word."""
    offers: list[Offer] = []
    if "TOPIC" in accepted:
        offers += [Offer(_topic(name), "topic") for name in source.topics()]
    offers += _values(previous, accepted, source)
    if "NAME" in accepted and "_ON" not in accepted and not _new_name_follows(previous):
        offers += _fields(text, source)
    if "FUNCTION" in accepted:
        functions = _FUNCTIONS + (QUANTIFIERS if _is_in_where(previous) else ())
        offers += [Offer(f"{name}(", "function") for name in functions]
    if "STAR" in accepted and previous and previous[-1].type != "_SELECT":
        accepted = accepted - {"STAR"}  # here it means multiplication
    words = _KEYWORDS if "_BETWEEN" in accepted else {**_KEYWORDS, "_IN": "IN '"}  # of NEAR
    offers += [Offer(word, "keyword") for name, word in words.items() if name in accepted]
    return offers


def _topic(name: str) -> str:
    return name if _PLAIN_TOPIC.fullmatch(name) else '"' + name.replace('"', '""') + '"'


def _new_name_follows(previous: Sequence[Token]) -> bool:
    return bool(previous) and previous[-1].type == "_AS"


def _is_in_where(previous: Sequence[Token]) -> bool:
    clauses = [t.type for t in previous if t.type in ("_WHERE", "_GROUP", "_ORDER")]
    return clauses[-1:] == ["_WHERE"]


def _values(previous: Sequence[Token], accepted: set[str], source: NameSource) -> Sequence[Offer]:
    """Return the known nodes or runs if NODE or RUN is compared with a text."""
    if "TEXT" not in accepted or len(previous) < 2 or previous[-1].type != "OPERATOR":
        return ()
    read_names = {"NODE": source.nodes, "RUN": source.runs}.get(previous[-2].type)
    names = () if read_names is None else read_names()
    return [Offer("'" + name.replace("'", "''") + "'", "value") for name in names]


def _fields(text: str, source: NameSource) -> Sequence[Offer]:
    """Return the fields of the topic that the statement names; empty without a topic."""
    named = _TOPIC.search(text)
    if named is None:
        return ()
    topic = named[1]
    if topic.startswith('"'):
        topic = topic[1:-1].replace('""', '"')
    fields: dict[str, str] = {}
    for definition in source.definitions(topic):
        for ref in all_fields(definition):
            fields.setdefault(ref.name, ref.type + "[]" * ref.is_array)
    return [Offer(name, "field", kind) for name, kind in fields.items()]
