# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The answer to an SQL statement, computed when it is asked for."""

from __future__ import annotations

import re
import unicodedata
import weakref
from concurrent import futures
from contextlib import contextmanager
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, AbstractSet, Any, Callable, Iterator, Sequence, TypeVar

from cassandra_ros.client.sql.duck_database import (
    CONSTANT,
    MEMORY,
    TOO_LARGE,
    DuckDatabase,
    frames_table,
)
from cassandra_ros.client.sql.event_names import EVENT
from cassandra_ros.client.sql.listed_tables import LISTED, listed_source
from cassandra_ros.client.sql.pushed_conditions import UNBOUNDED_READ, pushed_reads
from cassandra_ros.client.sql.python_values import python_rows
from cassandra_ros.client.sql.sql_explanation import SqlExplanation, explain_source
from cassandra_ros.client.sql.sql_statement import Params, SqlStatement, TableName
from cassandra_ros.client.sql.table_columns import TableColumns
from cassandra_ros.client.sql.table_sources import FrameSource, TableSource, TopicSource
from cassandra_ros.client.sql.topic_functions import (
    JOINT_FIELDS,
    NEAREST_COLUMNS,
    PARTNERS,
    TopicArgument,
)
from cassandra_ros.errors import AnswerTooLarge, CassandraRosError, InvalidQuery, TopicNotFound
from cassandra_ros.installation import optional_module
from cassandra_ros.messages.stamps import is_time, iso_time, to_ns
from cassandra_ros.printable import NOTEBOOK_ROWS, html_table
from cassandra_ros.query.arrays.arrow_types import (
    OWN_COLUMNS,
    Wanted,
    load_arrow,
    struct_of,
    wanted_columns,
)
from cassandra_ros.query.plan.pushdown import Watch, unwatched
from cassandra_ros.query.tree.field_names import nearest
from cassandra_ros.read import EVERYBODY, Whose
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.catalog import Catalog
from cassandra_ros.topics.unknown_names import warn_of

if TYPE_CHECKING:
    import pyarrow

ANSWER_BATCH_ROWS = 4096
"""Number of rows of a batch of the answer."""
_LOOK_SEC = 0.1
"""Interval at which a running statement looks whether it was cancelled, and at which one that was
cancelled is interrupted again, s."""
_QUOTED = re.compile(r'"((?:[^"]|"")+)"')
_NO_WIDTH = ("Cc", "Cf", "Me", "Mn")
"""Categories of characters that take no column: controls, tabs too, and marks on others."""
_T = TypeVar("_T")


class SqlResult:
    """The rows of an SQL statement. Each method runs the statement anew, as now. For one thread.

    Iterate over it for its rows, as tuples; ``print`` shows the first ones. Ctrl-C, an exception of
    ``watch``, or the end of an iterator stops what runs.

    Args:
        catalog: The topics.
        text: The statement.
        params: Values of its parameters.
        whose: Robots and runs whose messages are read.
        memory: Memory of DuckDB, as it writes it.
        pushdown: Whether only the columns and messages are read that the statement may need; the
            answer does not depend on it.
        folder, spill: Folder for what does not fit into memory, and its maximum size, as for
            DuckDatabase.
        watch: Called repeatedly while the statement runs; an exception from it stops it.

    Raises:
        InvalidQuery: The statement cannot be parsed, does more than read, or names a table or
            column that there is not. The text shows the place.
        MissingDependency: DuckDB, sqlglot or pyarrow is not installed.
    """

    def __init__(
        self,
        catalog: Catalog,
        text: str,
        params: Params = (),
        whose: Whose = EVERYBODY,
        *,
        memory: str = MEMORY,
        pushdown: bool = True,
        folder: str | None = None,
        spill: int | None = None,
        watch: Watch = unwatched,
    ) -> None:
        self._arrow = load_arrow("sql")
        self._catalog = catalog
        self._whose = whose
        self._make_database = partial(DuckDatabase, memory, folder, spill)
        self._pushdown = pushdown
        self._watch = watch
        self._statement = SqlStatement(text, params)
        run = self._bind_run()
        self._ready: _Run | None = run
        """The run that checked the statement, for the first method that is called."""
        weakref.finalize(self, run.close)  # if no method is called
        self.columns: tuple[str, ...] = tuple(run.relation.columns)
        self.hints: list[str] = []
        """Why no message was found by what ran last: names and frames that are not stored."""

    def batches(self) -> Iterator[pyarrow.RecordBatch]:
        """Yield the rows as record batches of pyarrow, while they are computed; at least one."""
        with self._open_run() as run:
            reader = run.wait(lambda: run.relation.to_arrow_reader(ANSWER_BATCH_ROWS))
            batch = run.wait(lambda: next(reader, None))
            if batch is None:
                batch = self._arrow.RecordBatch.from_pylist([], schema=reader.schema)
            while batch is not None:
                yield batch
                batch = run.wait(lambda: next(reader, None))

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        for batch in self.batches():
            yield from python_rows(self._arrow, batch)

    def fetchall(self) -> list[tuple[Any, ...]]:
        """Return all rows as tuples; times in ns are Stamps, structs dicts, arrays lists."""
        return list(self)

    def arrow(self) -> pyarrow.Table:
        """Return all rows as a pyarrow.Table."""
        with self._open_run() as run:
            table: pyarrow.Table = run.wait(lambda: run.relation.to_arrow_table())
            return table

    def df(self) -> Any:
        """Return all rows as a pandas.DataFrame; times are datetime64[ns] in UTC without a zone.

        Raises:
            MissingDependency: pandas is not installed.
        """
        optional_module("pandas", "df")
        with self._open_run() as run:
            return run.wait(lambda: run.relation.df())

    def explain(self) -> SqlExplanation:
        """Run the statement without keeping rows; return what was read of each topic, and the plan.

        The text shows columns, times, robots, runs and conditions that bounded what was read.
        """
        with self._open_run() as run:
            plan = run.wait(run.relation.explain)
            reader = run.wait(lambda: run.relation.to_arrow_reader(ANSWER_BATCH_ROWS))
            returned = 0
            while (batch := run.wait(lambda: next(reader, None))) is not None:
                returned += batch.num_rows
            topics = [s for s in run.sources.values() if isinstance(s, TopicSource)]
            return SqlExplanation(
                self._statement.text, tuple(map(explain_source, topics)), returned, plan
            )

    def __repr__(self) -> str:
        rows = self._first()
        lines = [" | ".join(map(_value_text, row)) for row in (self.columns, *rows[:NOTEBOOK_ROWS])]
        if len(rows) > NOTEBOOK_ROWS:
            lines.append("…")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = self._first()
        shown = [list(map(_value_text, row)) for row in rows[:NOTEBOOK_ROWS]]
        return html_table(self.columns, shown, of=len(rows))

    def _first(self) -> list[tuple[Any, ...]]:
        """Return the rows that are shown, and one more."""
        rows = iter(self)
        try:
            return list(islice(rows, NOTEBOOK_ROWS + 1))
        finally:
            rows.close()  # type: ignore[attr-defined]

    @contextmanager
    def _open_run(self) -> Iterator[_Run]:
        """Yield the run that checked the statement, or a new one; close it after the block.

        Then ``hints`` are those of this run, also after an error, and each is logged as a warning.
        """
        run, self._ready = self._ready or self._bind_run(), None
        try:
            yield run
        finally:
            run.close()
            self.hints = warn_of(hint for source in run.sources.values() for hint in source.hints)

    def _bind_run(self) -> _Run:
        """Return a new run whose statement was checked."""
        run = _Run(self._catalog, self._statement, self._whose, self._make_database(), self._watch)
        try:
            run.bind(self._pushdown)
        except BaseException:
            run.close()
            raise
        return run


def _value_text(value: object) -> str:
    if is_time(value):
        return iso_time(to_ns(value))
    return "NULL" if value is None else str(value)


class _Run:
    """One execution of a statement, in a database of its own. Close it.

    DuckDB works on another thread, so that Ctrl-C and the watch of the caller reach it: the watch
    runs on the caller's thread, ``_look`` on DuckDB's.

    Attributes:
        sources: What DuckDB scans, by name of the table.
        relation: The checked statement, which runs when it is asked for rows.
    """

    def __init__(
        self,
        catalog: Catalog,
        statement: SqlStatement,
        whose: Whose,
        database: DuckDatabase,
        watch: Watch,
    ) -> None:
        self._catalog = catalog
        self._statement = statement
        self._whose = whose
        self._watch = watch
        self._database = database
        self._worker = futures.ThreadPoolExecutor(1, thread_name_prefix="sql")
        self._work: futures.Future[Any] | None = None
        """The work of DuckDB that was begun last."""
        self._stopped = self._closed = False
        self.sources: dict[str, TableSource] = {}
        self.relation: Any = None

    def bind(self, pushdown: bool) -> None:
        """Give DuckDB the tables that the statement names, and have it check the statement."""
        statement, connection = self._statement, self._database.connection
        with self._errors():
            if not self._database.is_select(statement.text, statement.pivots()):
                raise InvalidQuery(statement.text, 0, "sql takes one SELECT; use CQL for others")
        self._find_tables(needed_columns(statement.tree), pushdown)
        if statement.calls("constant"):
            constants = listed_source(load_arrow("sql"), self._catalog, "constants")
            self.sources.setdefault("constants", constants)
        for target, frame in statement.frames():
            poses = FrameSource(self._catalog, self._whose, target, frame, self._look)
            self.sources[frames_table(target, frame)] = poses
        for name, source in self.sources.items():
            self._database.add_table(name, source)
        if statement.calls("constant"):
            connection.execute(CONSTANT)
        if pushdown:
            self._push()
        with self._errors():
            self.relation = self._database.select(statement.text, statement.params)

    def _find_tables(self, needed: Wanted | None, pushdown: bool) -> None:
        """Make the sources of the tables that the statement names.

        Args:
            needed: The columns that it may read; None = all.
            pushdown: Whether only these are read.

        Raises:
            InvalidQuery: A table is no topic, or differs from another one by case only.
        """
        own_tables = self._statement.own_tables()
        # A column EVENT costs time. Where all columns are read it is there if any event is stored.
        events = names_column(self._statement.tree, EVENT.lower())
        if needed is None and not events:
            events = next(self._catalog.keyspace.events.find(), None) is not None
        wanted = needed if pushdown else None
        spelled: dict[str, str] = {}
        for table in self._statement.table_names():
            if table.name in self.sources:
                continue
            if table.name.lower() in LISTED:
                name = table.name.lower()
                self.sources[table.name] = listed_source(load_arrow("sql"), self._catalog, name)
                continue
            if table.name.lower() in own_tables and not self._catalog.exists(table.name):
                continue
            topic = self._topic(table)
            other = spelled.setdefault(table.name.lower(), table.name)
            if other != table.name:
                reason = f"{other} and {table.name} differ by case only, which SQL ignores"
                raise InvalidQuery(self._statement.text, table.position, reason)
            self.sources[table.name] = self._topic_source(topic, wanted, events)
        for argument in self._statement.topic_arguments():
            self.sources[argument.table] = self._argument_source(argument, wanted, events)

    def _argument_source(
        self, argument: TopicArgument, wanted: Wanted | None, events: bool
    ) -> TopicSource:
        """Return what nearest or joints reads of a topic."""
        text = self._statement.text
        table = TableName(argument.topic, text.find(argument.topic))
        topic = self._topic(table)
        if argument.function == "joints":
            wanted = wanted_columns((name,) for name in (*OWN_COLUMNS, *JOINT_FIELDS))
            events = False
        elif wanted is not None:
            # A partner is of the same robot, and a field called partner keeps its name.
            wanted = {**wanted, **dict.fromkeys(("node", *NEAREST_COLUMNS), {})}
        source = self._topic_source(topic, wanted, events)
        if source.schema.named:
            reason = f"the keys of {topic.name} are names, not times"
            raise InvalidQuery(text, table.position, reason)
        fields = JOINT_FIELDS if argument.function == "joints" else ()
        for field in fields:
            if field not in source.columns.names:
                reason = f"joints reads JointState, and {topic.name} has no {field}"
                raise InvalidQuery(text, table.position, reason)
        return source

    def _topic_source(
        self, topic: CassandraTopic, wanted: Wanted | None, events: bool
    ) -> TopicSource:
        keyspace = self._catalog.keyspace
        return TopicSource(keyspace, topic, self._whose, wanted, self._look, events)

    def _topic(self, table: TableName) -> CassandraTopic:
        try:
            return self._catalog.get(table.name)
        except TopicNotFound as exc:
            raise InvalidQuery(self._statement.text, table.position, str(exc)) from exc

    def _push(self) -> None:
        """Tell each source what WHERE bounds of it; all tables must be known to DuckDB."""
        topics = {n: s for n, s in self.sources.items() if isinstance(s, TopicSource)}
        columns = {n: TableColumns(s.tables, s.has_events).find for n, s in topics.items()}
        params = self._statement.params

        def value(expression: str, names: AbstractSet[str]) -> Any:
            numbered = not isinstance(params, dict)
            try:
                given = {f"p{n}": params[int(n) - 1 if numbered else n] for n in names}
            except (LookupError, ValueError):
                return None  # DuckDB says which parameter is missing
            return self._database.value(expression, given)

        reads = pushed_reads(self._statement.tree, columns, value)
        for name, source in topics.items():
            source.pushed = reads.get(name, UNBOUNDED_READ)

    def _look(self) -> None:
        """End a read of a source, which DuckDB's thread does, if the run is being closed."""
        if self._stopped:
            raise InterruptedError("the statement was stopped")

    def wait(self, work: Callable[[], _T]) -> _T:
        """Do work of DuckDB on its thread and return its result; ``close`` ends the work.

        Ctrl-C, or an exception of the watch, ends the waiting, not the work.
        """
        with self._errors():
            future: futures.Future[_T] = self._worker.submit(work)
            self._work = future
            while True:
                self._watch()
                self._database.check_spill()
                if futures.wait([future], _LOOK_SEC).done:
                    return future.result()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Raise errors of DuckDB as ours, and those of our reads as they are."""
        try:
            yield
        except CassandraRosError:
            raise
        except Exception as exc:
            failed = [s.error for s in self.sources.values() if s.error is not None]
            if failed:
                raise failed[0] from exc
            if self._database.is_lack_of_memory(exc):
                raise AnswerTooLarge(f"{TOO_LARGE} ({_first_line(str(exc))})") from exc
            if not isinstance(exc, (self._database.duckdb.Error, OSError)):
                raise
            raise self._invalid(str(exc)) from exc

    def _invalid(self, text: str) -> InvalidQuery:
        """Return an error of the statement, from the text of DuckDB's."""
        reason, statement = _first_line(text), self._statement
        named = [name.replace('""', '"') for name in _QUOTED.findall(reason)]
        for name in named:
            if re.search(r"not found|Could not find key", reason):
                columns = self._known_columns()
                return InvalidQuery(
                    statement.text,
                    statement.position_of(name),
                    f"there is no column {name}{nearest(name, columns)}",
                )
        if "TIMESTAMP_NS" in reason and "cast" in reason:
            reason += (
                "; a time is a text in UTC, '2013-05-08 14:06:20.238582676', or of a number "
                "make_timestamp_ns(NANOSECONDS)"
            )
        if "calls cannot contain window function" in reason and statement.calls("rate"):
            reason = (
                "rate(…) is a value of each message: select it in a table in FROM, and take the "
                "minimum, mean, … of that: SELECT max(r) FROM (SELECT rate(x) AS r FROM t)"
            )
        reason += self._database.advice(reason, statement.text)
        return InvalidQuery(statement.text, _caret(statement.text, text), reason)

    def _known_columns(self) -> list[str]:
        """Return the names of all columns of the tables, and of the fields in them."""
        names: list[str] = []
        for source in self.sources.values():
            if isinstance(source, TopicSource):
                names += [EVENT] * source.has_events
                fields: Sequence[Any] = list(TableColumns(source.tables).schema)
            else:
                fields = list(source.columns)
            while fields:
                names += [field.name for field in fields]
                fields = [inner for field in fields for inner in struct_of(field.type)]
        return list(dict.fromkeys(names))

    def close(self) -> None:
        """End what runs, and release the database. Can be repeated."""
        if self._closed:
            return
        self._stopped = True
        while self._work is not None and not self._work.done():
            # Not once: DuckDB forgets an interrupt that comes before it has begun the statement.
            self._database.connection.interrupt()
            futures.wait([self._work], _LOOK_SEC)
        self._worker.shutdown(wait=True)
        self._database.close()
        self._closed = True


def _first_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    first = lines[0] if lines else text
    return re.sub(r"^[A-Z][A-Za-z ]* Error: ", "", first)


def _caret(statement: str, text: str) -> int:
    """Return the place in a statement that DuckDB's error points at; 0 = it points at none."""
    pointer = re.search(r"^LINE (\d+): (.*)\n( *)\^", text, re.MULTILINE)
    if pointer is None:
        return 0
    prefix = len(f"LINE {pointer.group(1)}: ")
    shown, column = pointer.group(2), len(pointer.group(3)) - prefix
    lines = statement.split("\n")
    line = min(int(pointer.group(1)), len(lines)) - 1
    begin = sum(len(earlier_line) + 1 for earlier_line in lines[:line])
    # A long line is cut at both ends.
    bare = shown.strip(".")
    column -= len(shown) - len(shown.lstrip("."))
    cut = max(0, lines[line].find(bare))
    return begin + cut + _index_of_column(lines[line][cut:], column)


def _index_of_column(line: str, column: int) -> int:
    """Return the index of the character at a column, as DuckDB counts columns: tabs take none."""
    taken = 0
    for index, c in enumerate(line):
        width = _width(c)
        if width and taken >= column:
            return index
        taken += width
    return len(line)


def _width(c: str) -> int:
    """Return the number of columns that DuckDB counts for a character."""
    if unicodedata.category(c) in _NO_WIDTH:
        return 0
    return 2 if unicodedata.east_asian_width(c) in ("F", "W") else 1


def needed_columns(tree: Any) -> Wanted | None:
    """Return the columns that a statement of sqlglot may read, of any of its tables; None = all.

    KEY is always among them, because a table has at least one column.
    """
    exp = optional_module("sqlglot.expressions", "sql")
    if _reads_all(exp, tree):
        return None
    chains = list(_chains(exp, tree))
    tables = {table.alias_or_name.lower() for table in tree.find_all(exp.Table)}
    aliases = {alias.name.lower() for alias in tree.find_all(exp.TableAlias)}
    if any(len(chain) == 1 and chain[0].lower() in tables | aliases for chain in chains):
        return None  # the whole row as a struct
    if any(chain[-1].lower() in PARTNERS for chain in chains):
        return None  # the whole row of nearest's second topic
    # `a.b.c` means field c of column b of table a, or field b.c of column a.
    return wanted_columns([("KEY",), *(c[n:] for c in chains for n in range(len(c)))])


def names_column(tree: Any, name: str) -> bool:
    """Return whether a statement may mean a column by a name in lower case."""
    chains = _chains(optional_module("sqlglot.expressions", "sql"), tree)
    return any(chain_name.lower() == name for chain in chains for chain_name in chain)


def _reads_all(exp: Any, tree: Any) -> bool:
    """Return whether a statement may read columns that it does not name."""
    by_number = getattr(exp, "PositionalColumn", exp.Columns)  # sqlglot for Python 3.8 lacks it
    if tree.find(exp.Columns, exp.Pivot, by_number) is not None:
        return True
    if any(a.columns and isinstance(a.parent, exp.Table) for a in tree.find_all(exp.TableAlias)):
        return True  # names for the columns in their order
    if any(join.method == "NATURAL" for join in tree.find_all(exp.Join)):
        return True
    if any(kind.args.get("values") for kind in tree.find_all(exp.DataType)):
        return True  # an element of a column whose name is that of a type, as in time[1]
    if tree.find(exp.List) is not None:
        return True
    return any(not isinstance(star.parent, exp.Count) for star in tree.find_all(exp.Star))


def _chains(exp: Any, tree: Any) -> Iterator[tuple[str, ...]]:
    """Yield the dotted names in a statement, and each other name alone."""
    for column in tree.find_all(exp.Column):
        chain, node = [column_name.name for column_name in column.parts], column
        while isinstance(node.parent, exp.Dot) and node.parent.this is node:
            node = node.parent
            chain.append(node.expression.name)
        yield tuple(chain)
    for name in tree.find_all(exp.Identifier):
        if not isinstance(name.parent, (exp.Column, exp.Dot, exp.Table, exp.TableAlias, exp.Alias)):
            yield (name.name,)
