# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A statement in DuckDB's SQL, parsed by sqlglot and checked: it may only read tables of ours."""

from __future__ import annotations

import logging
import re
import sys
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, Iterator, Mapping, Sequence, Union

from cassandra_ros.arguments import plain_value
from cassandra_ros.client.sql.pushed_conditions import UNSURE
from cassandra_ros.client.sql.topic_functions import (
    RATE_COLUMNS,
    TOPIC_FUNCTIONS,
    USAGE,
    TopicArgument,
    topic_arguments,
    wrong_calls,
)
from cassandra_ros.errors import InvalidQuery
from cassandra_ros.installation import optional_module
from cassandra_ros.messages.stamps import is_time, iso_time, length_object_ns, to_ns

Params = Union[Sequence[Any], Mapping[str, Any]]
"""Values for ``?`` in order, or for ``$name`` by name."""

MAX_STATEMENT_CHARACTERS = 64 * 1024
"""Maximum length of a statement, characters."""
TABLE_FUNCTIONS = {"range", "generate_series", "unnest", "tf", *TOPIC_FUNCTIONS}
"""Functions that may stand in FROM. All others could read files."""
_ONE_UNIT = re.compile(r"\s*-?\d+\s*[A-Za-z]*\s*")
"""Texts of intervals that sqlglot reads as DuckDB does; of others it drops the time of day."""
_UNREAD = re.compile(r"\blambda\b|%|#\d", re.IGNORECASE)
"""What sqlglot for Python 3.8 cannot read."""
_ZONED_TIME = re.compile(
    r"\d{4}-\d{2}-\d{2}[Tt ]\d{2}:\d{2}(?::\d{2}(?:\.(?P<fraction>\d+))?)?"
    r"\s*(?P<zone>[Zz]|[+-]\d{2}(?::?\d{2})?)?"
)
_READ_ONLY = (
    "sql reads topics and changes nothing: it takes a SELECT. To delete messages or to make an "
    "index, use CQL (executeCQL, cassandra_bag query)"
)


def load_parser() -> Any:
    """Return the module sqlglot; raises MissingDependency if it is not installed."""
    parser = optional_module("sqlglot", "sql")
    # It warns of statements that it does not know; they are refused here, with a better text.
    logging.getLogger("sqlglot").setLevel(logging.ERROR)
    optional_module("sqlglot.optimizer.scope", "sql")
    return parser


@dataclass(frozen=True)
class TableName:
    """The name of a table, as it stands in a statement."""

    name: str
    position: int
    """Index of its first character in the text."""


class SqlStatement:
    """A SELECT statement.

    Attributes:
        text: Its text, in which each ``?`` has a number, and each call of rate all its arguments.
        params: Values of its parameters; times are DuckDB's, with all digits.
        tree: Its syntax tree, of sqlglot.

    Raises:
        InvalidQuery: It cannot be parsed, or does more than read tables. The text shows the place.
        MissingDependency: sqlglot is not installed.
    """

    def __init__(self, text: str, params: Params = ()) -> None:
        if not isinstance(text, str):
            raise InvalidQuery(repr(text)[:200], 0, "a statement is text")
        if len(text) > MAX_STATEMENT_CHARACTERS:
            raise InvalidQuery(
                text[:200], 0, f"a statement has at most {MAX_STATEMENT_CHARACTERS} characters"
            )
        self._glot = load_parser()
        self.text = self._completed_text(text)
        self.params = _params(text, params)
        self.tree: Any = self._parse_tree()
        self._check()

    def _completed_text(self, text: str) -> str:
        """Return the text with $1, $2, … for each ?, so that the tree tells them apart.

        The name map gets quotes, without which sqlglot takes it for the type. A call of rate gets
        the columns that it needs of each row.
        """
        glot, kinds = self._glot, self._glot.TokenType
        try:
            tokens = glot.tokenize(text, read="duckdb")
        except glot.errors.TokenError as exc:
            raise InvalidQuery(text, len(text.rstrip()), f"a text is not closed: {exc}") from exc
        number = sum(token.token_type == kinds.PLACEHOLDER for token in tokens)
        next_kinds = [*(token.token_type for token in tokens[1:]), None]
        # The name before each token; '' = there is something else.
        words = ["", *(token.text.lower() * (token.token_type == kinds.VAR) for token in tokens)]
        # From the end, so that the positions of the tokens before stay what they are.
        for token, after, word in reversed(list(zip(tokens, next_kinds, words))):
            if token.token_type == kinds.PLACEHOLDER:
                changed, number = f"${number}", number - 1
            elif token.token_type == kinds.MAP and after not in (kinds.L_PAREN, kinds.L_BRACE):
                changed = f'"{token.text}"'
            elif token.token_type == kinds.L_PAREN and word == "rate" and after != kinds.R_PAREN:
                changed = f"({RATE_COLUMNS}, "
            else:
                continue
            text = f"{text[: token.start]}{changed}{text[token.end + 1 :]}"
        return text

    def _parse_tree(self) -> Any:
        """Return the tree of the text; its intervals are marked UNSURE if one is not simple."""
        glot = self._glot
        try:
            trees = [tree for tree in glot.parse(self.text, read="duckdb") if tree is not None]
        except glot.errors.ParseError as exc:
            first = exc.errors[0] if exc.errors else {}
            spot = self._spot(first.get("line") or 1, first.get("col") or 1, first)
            reason = first.get("description") or str(exc)
            if self.text[spot : spot + 1] == "/":
                reason = 'quote the name of a topic with slashes: "/imu/data"'
            elif sys.version_info < (3, 9) and _UNREAD.search(self.text):
                reason += "; Python 3.8 reads no lambda, no LIMIT in %, no column by its number"
            raise InvalidQuery(self.text, spot, reason) from exc
        except RecursionError as exc:
            raise InvalidQuery(self.text, 0, "the statement is nested too deeply") from exc
        if len(trees) != 1:
            raise InvalidQuery(self.text, 0, "give one statement")
        if not self._has_simple_intervals():
            for interval in trees[0].find_all(glot.exp.Interval):
                interval.meta[UNSURE] = True
        return trees[0]

    def _has_simple_intervals(self) -> bool:
        """Return whether each text after INTERVAL is a number with at most one unit."""
        kinds, tokens = self._glot.TokenType, self._glot.tokenize(self.text, read="duckdb")
        return all(
            _ONE_UNIT.fullmatch(text.text)
            for token, text in zip(tokens, tokens[1:])
            if token.token_type == kinds.INTERVAL and text.token_type == kinds.STRING
        )

    def _spot(self, line: int, column: int, error: Mapping[str, Any]) -> int:
        """Return the index of the first character that an error of sqlglot means.

        Args:
            line: Number of the line, from 1.
            column: Column of its last character, from 1.
            error: The error, which has the characters as 'highlight'.
        """
        before = self.text.split("\n")[: line - 1]
        end = sum(len(earlier_line) + 1 for earlier_line in before) + column
        return max(0, min(end, len(self.text)) - len(error.get("highlight") or " "))

    def _check(self) -> None:
        """Refuse what does more than read tables of ours; raises InvalidQuery."""
        exp = self._glot.exp
        if not isinstance(self.tree, (exp.Query, exp.Pivot)):
            raise InvalidQuery(self.text, 0, _READ_ONLY)
        if self.tree.find(exp.DML, exp.DDL, exp.Command, exp.Into) not in (None, self.tree):
            raise InvalidQuery(self.text, 0, _READ_ONLY)
        self._check_times()
        for name in wrong_calls(self._glot, self.tree):
            spot = max(0, self.text.lower().find(name))
            raise InvalidQuery(self.text, spot, f"{name} takes {USAGE[name]}")
        for table in self.tree.find_all(exp.Table, exp.Lateral):
            if isinstance(table.this, exp.Func):
                self._check_function(table.this)
            elif isinstance(table, exp.Lateral):
                continue
            elif table.db or table.catalog:
                spot = _start(table.parts[0])
                reason = "tables have no schema; a topic is named whole, in quotes if needed"
                raise InvalidQuery(self.text, spot, reason)

    def _check_times(self) -> None:
        """Refuse texts of times whose nanoseconds or zone DuckDB drops without a word."""
        exp, kinds = self._glot.exp, self._glot.exp.DataType.Type
        micro = {kinds.TIMESTAMP, kinds.TIMESTAMPNTZ, kinds.TIMESTAMPTZ, kinds.TIMESTAMPLTZ}
        zoned = {kinds.TIMESTAMPTZ, kinds.TIMESTAMPLTZ}
        for node in self.tree.find_all(exp.Literal, exp.Placeholder, exp.Parameter):
            text, within = self._constant_text(node), node.parent
            time = _ZONED_TIME.fullmatch(text.strip())
            if time is None:
                continue
            # sqlglot reads TIMESTAMPTZ '…'::TIMESTAMP from the right, DuckDB from the left.
            casts = {c.to.this for c in (within, within.parent) if isinstance(c, exp.Cast)}
            cast = within.to.this if isinstance(within, exp.Cast) else None
            if cast is not None and cast in micro and (time["fraction"] or "")[6:].strip("0"):
                reason = f"{cast.value} has microseconds, {text} more: write TIMESTAMP_NS '…'"
                raise InvalidQuery(self.text, max(0, self.text.find(text)), reason)
            compared = isinstance(within, (exp.Predicate, exp.Between, exp.In))
            drops = bool(cast) and not casts & zoned
            if (time["zone"] or "").strip("+-0:Zz") and (compared or drops):
                reason = f"DuckDB ignores the zone of {text}: write it in UTC, as '…Z'"
                raise InvalidQuery(self.text, max(0, self.text.find(text)), reason)

    def _constant_text(self, node: Any) -> str:
        """Return the text of a literal or of a parameter; '' = it is another expression."""
        if isinstance(node, self._glot.exp.Literal):
            return str(node.this) if node.is_string else ""
        name = node.name
        try:
            value = self.params[name if isinstance(self.params, dict) else int(name) - 1]
        except (LookupError, ValueError):
            return ""  # DuckDB says which parameter is missing
        return value if isinstance(value, str) else ""

    def _check_function(self, function: Any) -> None:
        """Refuse a function in FROM that could read something else than topics."""
        anonymous = isinstance(function, self._glot.exp.Anonymous)
        name = function.name if anonymous else function.sql_name()
        if name.lower() not in TABLE_FUNCTIONS:
            spot = max(0, self.text.lower().find(name.lower()))
            raise InvalidQuery(self.text, spot, f"{name} does not read a topic; files are not read")

    def table_names(self) -> Iterator[TableName]:
        """Yield the names of all tables that the statement reads, also of its own WITH."""
        exp = self._glot.exp
        for table in self.tree.find_all(exp.Table):
            if not isinstance(table.this, exp.Func):
                yield TableName(table.name, _start(table.this))

    def own_tables(self) -> set[str]:
        """Return the names that WITH gives, in lower case."""
        return {cte.alias.lower() for cte in self.tree.find_all(self._glot.exp.CTE)}

    def calls(self, name: str) -> bool:
        """Return whether the statement calls a function of ours."""
        calls = self.tree.find_all(self._glot.exp.Anonymous)
        return any(call.name.lower() == name for call in calls)

    def pivots(self) -> bool:
        """Return whether the statement has a PIVOT."""
        return self.tree.find(self._glot.exp.Pivot) is not None

    def frames(self) -> Iterator[tuple[str, str]]:
        """Yield the frames of each tf('target', 'source') in FROM."""
        exp = self._glot.exp
        for table in self.tree.find_all(exp.Table):
            call = table.this
            if not isinstance(call, exp.Anonymous) or call.name.lower() != "tf":
                continue
            frames = call.expressions
            if len(frames) != 2 or not all(frame.is_string for frame in frames):
                reason = "tf takes two frames: tf('map', 'base_link')"
                raise InvalidQuery(self.text, max(0, self.text.lower().find("tf")), reason)
            yield frames[0].name, frames[1].name

    def topic_arguments(self) -> Iterator[TopicArgument]:
        """Yield the topics that calls of nearest and joints in FROM read."""
        for table in self.tree.find_all(self._glot.exp.Table):
            yield from topic_arguments(table)

    def position_of(self, name: str) -> int:
        """Return where a name stands first in the text; 0 = it is not in the tree."""
        exp = self._glot.exp
        spots = [_start(i) for i in self.tree.find_all(exp.Identifier) if i.name == name]
        return min(spots, default=0)


def _start(identifier: Any) -> int:
    return int(identifier.meta.get("start", 0))


def _params(text: str, params: Params) -> Any:
    """Return the parameters as DuckDB takes them, in a dict or a list; ``text`` is for errors."""
    if isinstance(params, Mapping):
        return {str(name): _param(text, value) for name, value in params.items()}
    return [_param(text, value) for value in params]


def _param(text: str, given: Any) -> Any:
    """Return a parameter as DuckDB takes it; raises InvalidQuery for an interval of single ns."""
    value = plain_value(given)
    if is_time(value) and not isinstance(value, (int, float, str)):
        return optional_module("duckdb", "sql").Value(ns_text(to_ns(value)), "TIMESTAMP_NS")
    length = length_object_ns(value)
    if length is None:
        return value
    if length % 1000:
        reason = f"an interval of SQL has microseconds, the parameter {length} ns: round it"
        raise InvalidQuery(text, 0, reason)
    return timedelta(microseconds=length // 1000)


def ns_text(ns: int) -> str:
    """Return a time as a text that DuckDB reads as TIMESTAMP_NS."""
    return iso_time(ns).rstrip("Z").replace("T", " ")
