# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Statements of all kinds, run on the topics that they name.

DELETE removes whole messages. If its condition contains only KEY, NODE and RUN, the range is
deleted as it is stored. Any other condition is checked for every message, page by page. If the
condition is about elements of an array, a message is deleted when one element matches. Messages
that are stored while it runs may be deleted or not.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import Any, Iterator, Mapping, Sequence

from cassandra_ros.arguments import check_limit, check_nodes
from cassandra_ros.client.explanation import Explanation, explain
from cassandra_ros.errors import InvalidName, InvalidOption, InvalidQuery, TopicNotFound
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.metadata import TopicMetadata
from cassandra_ros.query.plan.bounds import in_another_unit
from cassandra_ros.query.plan.pushdown import Watch, unwatched
from cassandra_ros.query.tree.field_names import nearest
from cassandra_ros.query.tree.parse import parse_select, parse_statement
from cassandra_ros.query.tree.syntax import (
    Change,
    CreateIndex,
    Delete,
    DropIndex,
    Indexed,
    IndexName,
    Select,
    Truncate,
)
from cassandra_ros.read import Read
from cassandra_ros.store.tables.schema import Schema
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.indexes import check_indexable
from cassandra_ros.topics.keyspace import Keyspace
from cassandra_ros.topics.overview.envelopes import EnvelopeCache
from cassandra_ros.topics.overview.plot_series import (
    WHOLE_WINDOW,
    PlotWindow,
    Series,
    SeriesRequest,
    read_series,
)
from cassandra_ros.topics.query_result import Condition, Cursor, QueryResult, Rows
from cassandra_ros.topics.removal import delete_rows
from cassandra_ros.topics.row_finder import unit_meant
from cassandra_ros.topics.run_finder import RunName
from cassandra_ros.topics.unknown_names import warn_of_unknown_names


class Statements:
    """Runs the statements of the query language on the topics of one keyspace."""

    def __init__(self, catalog: Catalog) -> None:
        self._keyspace = catalog.keyspace
        self._catalog = catalog

    def run(
        self,
        statement: str | Select | Change,
        params: Sequence[Any] = (),
        node: str | None = None,
        limit: int | None = None,
        run: RunName = None,
    ) -> Rows:
        """Run a statement, or its parsed tree, and return all its rows; see executeCQL."""
        check_nodes(node)
        if isinstance(statement, (Select, Delete, Truncate, CreateIndex, DropIndex)):
            parsed: Select | Change = statement
        else:
            parsed = parse_statement(statement, params)
        if isinstance(parsed, Select):
            result = self.select(parsed, node=node, limit=limit, run=run)
            return Rows(result, result.columns)
        text = parsed.text
        start = len(text) - len(text.lstrip())  # errors point at the first word
        if limit is not None:
            reason = "limit= bounds the rows of a SELECT, it does nothing here"
            raise InvalidQuery(text, start, reason)
        if isinstance(parsed, Delete):
            return Rows([(self._delete(parsed, node, run),)], ["deleted"])
        if node is not None or run is not None:
            reason = "this is done for the messages of all nodes and runs, not of one; "
            reason += "DELETE with NODE = '…' or RUN = '…' removes those of one"
            raise InvalidQuery(text, start, reason)
        if isinstance(parsed, Truncate):
            self._catalog.remove(self.topic_of(parsed).name, renew=True)
        elif isinstance(parsed, CreateIndex):
            self._create_index(parsed)
        else:
            self._drop_index(parsed)
        return Rows([], [])

    def select(
        self,
        statement: str | Select,
        params: Sequence[Any] = (),
        *,
        node: str | None = None,
        limit: int | None = None,
        after: Cursor = None,
        plan: str = "auto",
        run: RunName = None,
        watch: Watch = unwatched,
    ) -> QueryResult:
        """Run a SELECT statement, or its parsed tree, lazily; see QueryResult."""
        check_limit(limit)
        check_nodes(node)
        select = statement if isinstance(statement, Select) else parse_select(statement, params)
        topic, whose = self.topic_of(select), self._catalog.whose(node, run)
        # Made again if another client has added a table with the field meanwhile.
        return self._keyspace.tables.naming(
            lambda: QueryResult(
                select, topic, whose, limit=limit, after=after, plan=plan, watch=watch
            )
        )

    def explain(
        self,
        statement: str | Select,
        params: Sequence[Any] = (),
        node: str | None = None,
        run: RunName = None,
        watch: Watch = unwatched,
    ) -> Explanation:
        """Run a SELECT statement to its end without keeping rows; describe how it was answered."""
        result = self.select(statement, params, node=node, run=run, watch=watch)
        return explain(result, self.topic_of(result.select))

    def series(
        self,
        statement: str | Select,
        params: Sequence[Any] = (),
        window: PlotWindow = WHOLE_WINDOW,
        *,
        node: str | None = None,
        run: RunName = None,
        cache: EnvelopeCache | None = None,
        watch: Watch = unwatched,
    ) -> Series:
        """Read the numbers that a SELECT statement gives over time, for a plot.

        Args:
            window: Time range, resolution and time limit.
            cache: Cache for what is read; None = no cache.

        Raises:
            InvalidQuery: The statement is not valid, or names a field that the topic lacks.
        """
        check_nodes(node)
        select = statement if isinstance(statement, Select) else parse_select(statement, params)
        asker = SeriesRequest(self._catalog.whose(node, run), cache, watch)
        return read_series(self._keyspace, self.topic_of(select), select, window, asker)

    def topic_of(self, statement: Select | Delete | Truncate) -> CassandraTopic:
        """Return the topic that a statement names; raises InvalidQuery if it is not stored."""
        return self._find(statement.text, statement.topic, statement.topic_position)

    def _find(self, text: str, topic: str, position: int) -> CassandraTopic:
        """Return the topic that a statement names at a position."""
        with _at(text, position):
            return self._catalog.get(topic)

    def _delete(self, statement: Delete, node: str | None, run: RunName) -> int:
        """Delete messages; return their number.

        If the bounds are the whole condition, their range is deleted without being read. Otherwise,
        and where the keys are names, each message is read, checked and deleted alone.
        """
        self._keyspace.schema.tables(fresh=True)  # so that tables just made by others are included
        topic = self.topic_of(statement)
        named = any(table.named for table in topic.tables)
        condition, read = Condition(statement), Read(whose=self._catalog.whose(node, run))
        bounds = condition.bounds(topic.tables, read)
        if not named:
            _refuse_units(self._keyspace, topic, statement)
        if named or not bounds.whole:
            return delete_rows(self._keyspace, condition.rows(topic, read))
        if bounds.empty or not topic.tables:
            warn_of_unknown_names(statement.condition, topic.tables, bounds.read)
            return 0
        low, high = map(Stamp.from_ns, bounds.read.time_range)
        whose = bounds.read.whose
        return topic.removeData(low, high, nodeID=whose.node, run=whose.writers)

    def _create_index(self, statement: CreateIndex) -> None:
        """Make an index. It gets its name first: if that is taken no index is made."""
        text, on, name = statement.text, statement.on, statement.name
        self._keyspace.schema.tables(fresh=True)  # other clients may have made or dropped indexes
        topic = self._find(text, on.topic, on.topic_position)
        field = on.field.dotted
        if topic.hasIndex(field) and not statement.unless_exists:
            raise InvalidQuery(
                text,
                on.field.position,
                f"topic {topic.name} has an index on {field} already; IF NOT EXISTS accepts that, "
                "and completes one whose making was interrupted",
            )
        with _at(text, on.field.position):
            check_indexable(topic.name, topic.tables, field)
        if name is not None:
            with _at(text, name.position):
                _give_name(self._keyspace.schema, topic.name, field, name.text)
        topic.createIndex(field)

    def _drop_index(self, statement: DropIndex) -> None:
        index = statement.index
        if isinstance(index, IndexName):
            indexed, position = self._index_named(statement, index), index.position
        else:
            indexed, position = self._index_on(statement, index), index.field.position
        if indexed is not None:
            topic, field = indexed
            with _at(statement.text, position):  # already removed, or needed by the key
                topic.removeIndex(field)

    def _index_named(
        self, statement: DropIndex, name: IndexName
    ) -> tuple[CassandraTopic, str] | None:
        """Return topic and field of the index of a name; None = none, and IF EXISTS is given."""
        names = names_of_indexes(self._keyspace.schema.tables(fresh=True))
        columns = names.get(name.text, [])
        if len(columns) == 1:
            return self._catalog.get(columns[0][0]), columns[0][1]
        if not columns and statement.if_exists:
            return None
        places = " and ".join(f"{topic} ({field})" for topic, field in columns)
        reason = (
            f"several indexes are called {name.text}, on {places}"
            if columns
            else f"no index is called {name.text}{nearest(name.text, list(names))}"
        )
        reason += "; DROP INDEX ON topic (field) removes an index whatever its name"
        raise InvalidQuery(statement.text, name.position, reason)

    def _index_on(self, statement: DropIndex, index: Indexed) -> tuple[CassandraTopic, str] | None:
        """Return topic and field of the index on a field; None = none, and IF EXISTS is given."""
        self._keyspace.schema.tables(fresh=True)
        if statement.if_exists and not self._catalog.exists(index.topic):
            return None
        topic = self._find(statement.text, index.topic, index.topic_position)
        field, indexes = index.field.dotted, list(topic.getMeta["indexes"])
        if field in indexes:
            return topic, field
        if statement.if_exists:
            return None
        raise InvalidQuery(
            statement.text,
            index.field.position,
            f"topic {topic.name} has no index on {field}{nearest(field, indexes)}; "
            "its indexes are on " + (", ".join(sorted(indexes)) or "nothing"),
        )


@contextmanager
def _at(text: str, position: int) -> Iterator[None]:
    """Show an error about a name that a statement contains below the name."""
    try:
        yield
    except (InvalidName, InvalidOption, TopicNotFound) as exc:
        raise InvalidQuery(text, position, str(exc)) from exc


def _refuse_units(keyspace: Keyspace, topic: CassandraTopic, statement: Delete) -> None:
    """Refuse integers meant in another unit than ns: a minimum in 1970 deletes every message."""
    for literal in in_another_unit(statement.condition):
        reason = unit_meant(keyspace, topic.tables, literal.value)
        if reason:
            raise InvalidQuery(statement.text, literal.position, reason)


def names_of_indexes(tables: Mapping[str, TopicMetadata]) -> dict[str, list[tuple[str, str]]]:
    """Return name → (topic, field) of the indexes in some tables; mostly one for each name."""
    fields: dict[str, set[tuple[str, str]]] = {}
    for metadata in tables.values():
        for name, field in metadata.index_names.items():
            if field in metadata.indexes:
                fields.setdefault(name, set()).add((metadata.topic, field))
    return {name: sorted(indexed) for name, indexed in fields.items()}


def _give_name(schema: Schema, topic: str, field: str, name: str) -> None:
    """Name the index of a field, which need not exist yet; no other index may have this name."""

    def check(tables: Mapping[str, TopicMetadata]) -> None:
        for other, of in names_of_indexes(tables).get(name, []):
            if (other, of) != (topic, field):
                raise InvalidName(
                    f"the index on {other} ({of}) is called {name} already; choose another name"
                )

    def change(metadata: TopicMetadata) -> TopicMetadata:
        return metadata.with_(index_names={**metadata.index_names, name: field})

    schema.change_topic(topic, change, check)
