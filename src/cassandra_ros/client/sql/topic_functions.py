# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Functions of our own in SQL: nearest and joints, which read topics, and rate and yaw.

They are macros of DuckDB, in words that all of its releases take. A topic that nearest or joints
reads is a table of its own beside that of the same topic in FROM, because other rows of it are
needed.
"""

from __future__ import annotations

from typing import Any, Iterator, NamedTuple, Sequence

TOPIC_FUNCTIONS = {"nearest": 2, "joints": 1}
"""Number of topics that a function takes before its other arguments, by its name."""
USAGE = {
    "nearest": "two topics and a length of time: nearest('/imu/data', '/fix', '50ms')",
    "joints": "a topic: joints('/joint_states')",
    "rate": "a column, and by name gap and per: rate(position, gap := '2 seconds', per := name)",
}
"""Arguments of a function, for errors."""
NEAREST_COLUMNS = ("partner", "apart", "tie")
"""Columns that nearest adds: the message of the second topic, its distance, and whether another
one is as near. If a field of the first topic has the name, the column gets _1."""
PARTNERS = (NEAREST_COLUMNS[0], NEAREST_COLUMNS[0] + "_1")
"""Possible names of the first one of them."""
JOINT_FIELDS = ("name", "position", "velocity", "effort")
"""Arrays of a message that joints makes rows of."""
RATE_COLUMNS = "KEY, NODE, RUN"
"""First arguments of rate, which are put before those in the statement: a macro has no columns."""
_RATE_OPTIONS = ("gap", "per")


class TopicArgument(NamedTuple):
    """A topic that a call in FROM reads."""

    function: str
    number: int
    """Place among the arguments, from 1."""
    topic: str

    @property
    def table(self) -> str:
        """Name of the table that DuckDB reads for it, as the macros make it: without quotes."""
        code = self.topic.encode("utf-8", "surrogatepass").hex().upper()
        return f"{self.function}_{self.number}_{code}"


def topic_arguments(table: Any) -> Sequence[TopicArgument]:
    """Return the topics that a table of sqlglot reads, if it is a call of nearest or joints."""
    name = table.this.name.lower() if table.this is not None else ""
    if table.name or name not in TOPIC_FUNCTIONS:  # a call has no name as a table
        return ()
    topics = table.this.expressions[: TOPIC_FUNCTIONS[name]]
    return [TopicArgument(name, n, topic.name) for n, topic in enumerate(topics, 1)]


def table_names(table: Any) -> Sequence[str]:
    """Return the names of the tables that DuckDB reads for a table of sqlglot."""
    return [argument.table for argument in topic_arguments(table)] or [table.name]


def wrong_calls(parser: Any, tree: Any) -> Iterator[str]:
    """Yield the name of each function of ours that a statement calls otherwise than USAGE says.

    Args:
        parser: The module sqlglot.
        tree: The statement, whose calls of rate have RATE_COLUMNS already.
    """
    exp = parser.exp
    if any(a.name.lower() == "rate" and a.columns for a in tree.find_all(exp.TableAlias)):
        yield "rate"
    for call in tree.find_all(exp.Anonymous):
        name, given = call.name.lower(), call.expressions
        if name in TOPIC_FUNCTIONS:
            topics = TOPIC_FUNCTIONS[name]
            right = len(given) == topics + (name == "nearest")
            right = right and all(topic.is_string for topic in given[:topics])
            right = right and not any(isinstance(value, exp.PropertyEQ) for value in given)
            right = right and isinstance(call.parent, exp.Table)
        elif name == "rate":
            named = [value for value in given if isinstance(value, exp.PropertyEQ)]
            columns = len(RATE_COLUMNS.split(",")) + 1
            right = len(given) == columns + len(named) and not set(given[:columns]) & set(named)
            right = right and all(value.name.lower() in _RATE_OPTIONS for value in named)
        else:
            continue
        if not right:
            yield name


_NS = """
CREATE MACRO ns_of(time) AS
epoch_us(CAST(time AS TIMESTAMP_NS)) * 1000 + nanosecond(CAST(time AS TIMESTAMP_NS)) % 1000
"""
"""Makes the ns since 1970 of a time that is not before; epoch_ns of DuckDB 1 has only us."""
_JOINTS = """
CREATE MACRO joints(topic) AS TABLE
SELECT KEY, NODE, RUN, unnest(name) AS name, unnest(position) AS position,
  unnest(velocity) AS velocity, unnest(effort) AS effort
FROM query_table('joints_1_' || hex(topic))
"""
# No field of a message begins with an underscore, so these names are free.
_NEAREST = """
CREATE MACRO nearest(topic, other, within) AS TABLE
SELECT * EXCLUDE (_before, _after, _since, _until, _side),
  CASE _side WHEN 'before' THEN _before WHEN 'after' THEN _after END AS partner,
  CASE _side WHEN 'before' THEN -_since WHEN 'after' THEN _until END / 1e9 AS apart,
  coalesce(_side = 'before' AND _since = _until, false) AS tie
FROM (
  SELECT *, CASE WHEN least(_since, _until) <= epoch_ns(CAST(within AS INTERVAL))
    THEN CASE WHEN _since <= coalesce(_until, _since) THEN 'before' ELSE 'after' END END AS _side
  FROM (
    SELECT _one.*, _before, _after, ns_of(_one.KEY) - ns_of(_before.KEY) AS _since,
      ns_of(_after.KEY) - ns_of(_one.KEY) AS _until
    FROM (FROM query_table('nearest_1_' || hex(topic))) _one
    ASOF LEFT JOIN (FROM query_table('nearest_2_' || hex(other))) _before
      ON _one.NODE = _before.NODE AND _one.KEY >= _before.KEY
    ASOF LEFT JOIN (FROM query_table('nearest_2_' || hex(other))) _after
      ON _one.NODE = _after.NODE AND _one.KEY < _after.KEY))
"""
_WINDOW = "OVER (PARTITION BY _node, _run, per ORDER BY _key)"
_LENGTH = f"(ns_of(_key) - lag(ns_of(_key)) {_WINDOW})"
_RATE = f"""
CREATE MACRO rate(_key, _node, _run, field, gap := '2 seconds', per := NULL) AS
CASE WHEN {_LENGTH} BETWEEN 1 AND epoch_ns(CAST(gap AS INTERVAL))
  THEN (CAST(field AS DOUBLE) - lag(CAST(field AS DOUBLE)) {_WINDOW}) / {_LENGTH} * 1e9 END
"""
_SQUARE = "((q).w * (q).w + (q).x * (q).x - (q).y * (q).y - (q).z * (q).z)"
_YAW = f"""
CREATE MACRO yaw(q) AS
CASE WHEN (q).w <> 0 OR (q).x <> 0 OR (q).y <> 0 OR (q).z <> 0
  THEN atan2(2 * ((q).w * (q).z + (q).x * (q).y), {_SQUARE}) END
"""
MACROS = (_NS, _JOINTS, _NEAREST, _RATE, _YAW)
"""Statements that make the functions in DuckDB."""
