# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Node cassandra_ros: the store, asked over ROS services. They unpack, ask the library, pack."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import islice
from typing import Callable, Iterator, Mapping, Sequence, TypeVar

import rospy

from cassandra_ros.arguments import check_new_node, check_seconds
from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.client.sql.python_values import printable_value
from cassandra_ros.client.sql.statement_processes import (
    STATEMENT_SEC,
    Statement,
    StatementProcesses,
)
from cassandra_ros.errors import (
    AnswerTooLarge,
    CassandraRosError,
    ClockNotSet,
    CorruptMessage,
    DefinitionError,
    InvalidKey,
    InvalidName,
    InvalidOption,
    StoreUnavailable,
)
from cassandra_ros.keys import RowName, decode_cursor, encode_cursor
from cassandra_ros.messages.classes import (
    exact_message,
    installed_definition,
    message_class,
    message_of_yaml,
    to_yaml,
)
from cassandra_ros.messages.definition import Definition, parse_definition
from cassandra_ros.messages.stamps import iso_time, to_ns
from cassandra_ros.msg import Row, StoredMessage, StoredTopic
from cassandra_ros.nodes.mark_answer import pack_event, read_values
from cassandra_ros.nodes.registration import Registration
from cassandra_ros.nodes.ros_node import offer_services, ros_time, start_named_node
from cassandra_ros.query.tree.json_values import AnswerBound, from_json
from cassandra_ros.query.tree.parse import parse_statement
from cassandra_ros.query.tree.syntax import Select
from cassandra_ros.read import LAST_NS, Read, TimeRange, Whose
from cassandra_ros.recording.event_marks import EventMarks
from cassandra_ros.recording.option_values import read_label
from cassandra_ros.srv import (
    AddData,
    AddDataRequest,
    AddDataResponse,
    ExecuteCQL,
    ExecuteCQLRequest,
    ExecuteCQLResponse,
    ExplainCQL,
    ExplainCQLRequest,
    ExplainCQLResponse,
    GetData,
    GetDataRequest,
    GetDataResponse,
    Info,
    InfoRequest,
    InfoResponse,
    LookupTransform,
    LookupTransformRequest,
    LookupTransformResponse,
    Mark,
    MarkRequest,
    MarkResponse,
    Range,
    RangeRequest,
    RangeResponse,
    RemoveData,
    RemoveDataRequest,
    RemoveDataResponse,
    Sql,
    SqlRequest,
    SqlResponse,
)
from cassandra_ros.topics.cassandra_topic import CassandraTopic
from cassandra_ros.topics.message_adder import clock_ns
from cassandra_ros.topics.new_tables import wished_topic, with_key
from cassandra_ros.topics.query_result import Condition
from cassandra_ros.topics.stored_row import StoredRow
from cassandra_ros.topics.stored_totals import TopicInfo

Request = TypeVar("Request")
Response = TypeVar("Response")

_log = logging.getLogger(__name__)

DEFAULT_LIMIT = 100
"""Default number of messages or rows of a page."""
MAX_REPLY_BYTES = 16 * 1024 * 1024
"""Size of an answer above which a page ends, bytes."""
YAML_BYTES = 1024 * 1024
"""Maximum size of a message that is written as YAML, bytes: that takes seconds and ten times the
bytes."""
_FEWER = (
    "select fewer columns, one element of an array as data[0], or len(…) of it, or choose another "
    "row by WHERE; Python's executeCQL has no such bound"
)
_ELSEWHERE = "set omit_data, select its fields by executeCQL, or read it by getData in Python"
READ_ONLY = (
    "this would change what is stored, and the node only reads; start it with the parameter "
    "~allow_writes, as rosrun cassandra_ros query_server _allow_writes:=true, or do it in Python, "
    "with RosCassandra"
)


def start_node(argv: Sequence[str]) -> Mapping[str, object]:
    """Start the node; return its private parameters.

    Raises:
        InvalidName: A node of the same name is running.
        KeyboardInterrupt, SystemExit: A signal came while it waited for a master.
    """
    return start_named_node("cassandra_ros", argv, signals=True, rostime=True, alone=True)


def serve(ros_cas: RosCassandra, say: Callable[[str], None], allow_writes: bool = False) -> None:
    """Answer requests until the node is shut down.

    Args:
        ros_cas: The open keyspace.
        say: Prints a line for the user.
        allow_writes: Whether requests that change stored messages are allowed.
    """
    marks = EventMarks(ros_cas.catalog.keyspace.events.put)
    services = QueryServices(ros_cas, allow_writes, marks)
    handlers = (
        (f"~{name}", kind, partial(_answer, getattr(services, method), response_class))
        for name, (kind, response_class, method) in SERVICES.items()
    )
    offer_services(handlers, say)
    Registration().start()
    absence = ros_cas.catalog.keyspace.side_tables.absence()
    if absence:
        _log.warning("%s; until then no topic is found", absence)
    how = "writes are allowed" if allow_writes else "read-only"
    say(f"serving keyspace {ros_cas.keyspace}, {how}")
    rospy.spin()
    services.close()
    with suppress(ClockNotSet):  # then no event has begun
        marks.end_all(clock_ns(None))


def _answer(
    handler: Callable[[Request], Response],
    response_class: Callable[..., Response],
    request: Request,
) -> Response:
    """Call a handler; answer ``success: false`` for every error in it."""
    try:
        return handler(request)
    except CassandraRosError as exc:
        return response_class(success=False, message=clean(str(exc)))
    except Exception as exc:  # noqa: BLE001 - an error of the package must not end the node
        _log.exception("%s failed", handler.__name__)
        reason = f"internal error: {type(exc).__name__}: {exc}; the node's log has more"
        return response_class(success=False, message=clean(reason))


@dataclass
class QueryServices:
    """The handlers of the services. Thread-safe."""

    ros_cas: RosCassandra
    allow_writes: bool
    """Whether requests that change stored messages are allowed."""
    marks: EventMarks
    """The events that requests have begun and not ended."""

    def __post_init__(self) -> None:
        self._statements = StatementProcesses(self.ros_cas.cassandra)

    def close(self) -> None:
        """End the processes of statements in SQL."""
        self._statements.close()

    def get_data(self, request: GetDataRequest) -> GetDataResponse:
        """Answer GetData."""
        topic = self.ros_cas.getTopic(request.topic)
        key = topic.keyOfText(request.key_text) if request.key_text.strip() else request.key
        nearest, node = request.nearest or None, request.node_id or None
        options = {"nearest": nearest, "nodeID": node, "where": request.where or None}
        options["run"] = request.run or None
        while (row := topic.getRow(key, **options)) is None:
            # Raises MessageNotFound with the nearest keys, unless the message was stored just now.
            topic.getData(key, **options)
        return GetDataResponse(True, "", pack(row, request.omit_data, request.omit_yaml))

    def range(self, request: RangeRequest) -> RangeResponse:
        """Answer Range."""
        limit = request.limit or DEFAULT_LIMIT
        response = RangeResponse(success=True)
        size = 0
        rows = self._rows(request, limit + 1)
        for row in islice(rows, limit):
            try:
                message = pack(row, request.omit_data, request.omit_yaml)
            except (CorruptMessage, AnswerTooLarge) as exc:
                if response.data:
                    return response  # the next page begins with this message
                # The next page begins after this message.
                cursor = encode_cursor(row.position)
                return RangeResponse(False, clean(str(exc)), [], cursor)
            response.data.append(message)
            response.next_cursor = encode_cursor(row.position)
            size += size_of(message)
            if size > MAX_REPLY_BYTES:
                break
        # With a condition no next match is searched for: it may be far away, and the next page may
        # be empty.
        full = len(response.data) == limit or size > MAX_REPLY_BYTES
        if not full or (not request.where and next(rows, None) is None):
            response.next_cursor = ""
        return response

    def _rows(self, request: RangeRequest, most: int) -> Iterator[StoredRow]:
        """Yield the rows of a range after its cursor.

        Args:
            most: Number of rows that the caller takes at most; with a condition more may come.
        """
        topic = self.ros_cas.getTopic(request.topic)
        low = to_ns(request.key)
        high = to_ns(request.to_key) or None
        if high is not None and high < low:
            raise InvalidKey(f"to_key ({high} ns) lies before key ({low} ns)")
        after = decode_cursor(request.cursor) if request.cursor else None
        node, run = (
            request.node_id or None,
            self.ros_cas.catalog.keyspace.runs.writers(request.run or None),
        )
        if request.where:
            time_range = TimeRange(low, LAST_NS if high is None else high)
            read = Read(time_range, Whose.of(node, run), after=after, wanted=most)
            return Condition(request.where).rows(topic, read)
        return topic.rows(low, high, nodeID=node, limit=most, after=after, run=run)

    def execute_cql(self, request: ExecuteCQLRequest) -> ExecuteCQLResponse:
        """Answer ExecuteCQL."""
        params = [from_json(text, f"params[{n}]") for n, text in enumerate(request.params)]
        statement = parse_statement(request.statement, params)
        node, run = request.node_id or None, request.run or None
        if isinstance(statement, Select):
            limit = request.limit or DEFAULT_LIMIT
            return self._page(statement, node, run, limit, request.cursor)
        if not self.allow_writes:
            return ExecuteCQLResponse(success=False, message=READ_ONLY)
        if request.cursor:
            raise InvalidKey("a cursor leads to the next page of a SELECT; leave it out here")
        result = self.ros_cas.statements.run(statement, node=node, run=run)
        bound = AnswerBound("the answer", _FEWER)
        rows = [Row([bound.json(value) for value in values]) for values in result]
        return ExecuteCQLResponse(success=True, columns=list(result.columns), rows=rows)

    def _page(
        self, select: Select, node: str | None, run: str | None, limit: int, cursor: str
    ) -> ExecuteCQLResponse:
        """Return at most ``limit`` rows of a SELECT, and a cursor if more may follow."""
        with self.ros_cas.statements.select(
            select, node=node, limit=limit + 1, after=cursor, run=run
        ) as result:
            response = ExecuteCQLResponse(success=True, columns=[clean(c) for c in result.columns])
            bound = AnswerBound("a row of the answer", _FEWER)
            for values in islice(result, limit):
                try:
                    bound.count_part(64 + 16 * len(values))
                    row = Row([bound.json(value) for value in values])
                except AnswerTooLarge:
                    if response.rows:
                        return response  # the next page begins with this row
                    raise
                response.rows.append(row)
                response.next_cursor = result.cursor
                if bound.bytes > MAX_REPLY_BYTES:
                    break
            full = len(response.rows) == limit or bound.bytes > MAX_REPLY_BYTES
            if not full or (result.direct and next(result, None) is None):
                response.next_cursor = ""
        return response

    def explain_cql(self, request: ExplainCQLRequest) -> ExplainCQLResponse:
        """Answer ExplainCQL."""
        params = [from_json(text, f"params[{n}]") for n, text in enumerate(request.params)]
        node, run = request.node_id or None, request.run or None
        plan = self.ros_cas.explainCQL(request.statement, params, nodeID=node, run=run)
        numbers = ("buckets", "indexed", "filtered", "whole", "skipped", "rows_read")
        return ExplainCQLResponse(
            success=True,
            text=clean(str(plan)),
            topic=clean(plan.topic),
            server=[clean(text) for text in plan.server],
            client=[clean(text) for text in plan.client],
            rows_returned=plan.rows_returned,
            **{name: getattr(plan, name) for name in numbers},
        )

    def sql(self, request: SqlRequest) -> SqlResponse:
        """Answer Sql."""
        node, run = request.node_id or None, request.run or None
        whose = self.ros_cas.catalog.whose(node, run)
        keyspace = self.ros_cas.catalog.keyspace.name
        statement = Statement(keyspace, request.statement, whose, tuple(request.params))
        seconds = check_seconds("timeout", request.timeout) or STATEMENT_SEC
        limit = request.limit or DEFAULT_LIMIT
        with self._statements.answer(statement, _until_shutdown, seconds) as answer:
            response = SqlResponse(success=True, columns=[clean(c) for c in answer.columns])
            bound, rows = AnswerBound("the answer", _FEWER), iter(answer)
            for values in islice(rows, limit):
                bound.count_part(64 + 16 * len(values))
                row = [bound.json(printable_value(value)) for value in values]
                response.rows.append(Row(row))
            response.more = len(response.rows) == limit and next(rows, None) is not None
        return response

    def info(self, request: InfoRequest) -> InfoResponse:
        """Answer Info."""
        node, run = request.node_id or None, request.run or None
        infos = self.ros_cas.info(request.topics or None, nodeID=node, run=run)
        topics = [_stored_topic(info) for info in infos]
        return InfoResponse(True, "", self.ros_cas.keyspace, topics)

    def add_data(self, request: AddDataRequest) -> AddDataResponse:
        """Answer AddData."""
        if not self.allow_writes:
            return AddDataResponse(success=False, message=READ_ONLY)
        if request.data and request.yaml:
            raise InvalidOption("give the message as data or as yaml, not as both")
        name, text, store = request.topic, request.yaml, self.ros_cas
        stored = store.getTopic(name) if store.existTopic(name) else None
        cls = message_class(_definition(request, stored))
        msg = message_of_yaml(cls, text) if text else exact_message(cls, bytes(request.data))
        # The stored name, with or without leading slash. A new topic has the type of the message,
        # whatever the master remembers of a topic of that name.
        wish = wished_topic(stored.name if stored else name, request.format or None)
        when = request.key_text.strip() or request.key or None
        if stored is None and when is not None:
            when = to_ns(when)  # refused before an empty topic is made
        topic = store.catalog.add(with_key(wish, None, ""), None, ask_master=False)
        key = topic.addData(msg, key=when, nodeID=request.node_id)
        t_ns = key.t if isinstance(key, RowName) else to_ns(key)
        return AddDataResponse(True, "", ros_time(t_ns), clean(str(key)))

    def mark(self, request: MarkRequest) -> MarkResponse:
        """Answer Mark."""
        if not self.allow_writes:
            return MarkResponse(success=False, message=READ_ONLY)
        labels, values = dict(map(read_label, request.labels)), read_values(request.values)
        node = check_new_node(request.node_id)
        event = self.marks.mark(request.name, clock_ns(None), node, labels, values)
        response = MarkResponse(success=True)
        pack_event(event, response)
        return response

    def remove_data(self, request: RemoveDataRequest) -> RemoveDataResponse:
        """Answer RemoveData."""
        if not self.allow_writes:
            return RemoveDataResponse(success=False, message=READ_ONLY)
        topic = self.ros_cas.getTopic(request.topic)
        text = request.key_text
        key = topic.keyOfText(text) if text.strip() else request.key or None
        to_key, run = request.to_key or None, request.run or None
        where, node = request.where or None, request.node_id or None
        if key is to_key is where is run is None:
            raise InvalidKey(
                "give key, to_key, key_text, where or run; all messages of a topic are removed by "
                f"executeCQL with the statement TRUNCATE {topic.name}"
            )
        work = topic.countTopicData if request.dry_run else topic.removeData
        return RemoveDataResponse(True, "", work(key, to_key, node, where=where, run=run))

    def lookup_transform(self, request: LookupTransformRequest) -> LookupTransformResponse:
        """Answer LookupTransform."""
        options = {"nodeID": request.node_id, "run": request.run}
        options.update(tf=request.tf, tf_static=request.tf_static)
        transform = self.ros_cas.lookupTransform(
            request.target_frame,
            request.source_frame,
            request.time,
            **{name: value for name, value in options.items() if value},
        )
        return LookupTransformResponse(True, "", transform)


def _until_shutdown() -> None:
    """Raise StoreUnavailable if the node ends: called while a statement runs."""
    if rospy.is_shutdown():
        raise StoreUnavailable("the query server ends")


SERVICES: Mapping[str, tuple[type, Callable[..., Response], str]] = {
    "getData": (GetData, GetDataResponse, "get_data"),
    "range": (Range, RangeResponse, "range"),
    "executeCQL": (ExecuteCQL, ExecuteCQLResponse, "execute_cql"),
    "explainCQL": (ExplainCQL, ExplainCQLResponse, "explain_cql"),
    "sql": (Sql, SqlResponse, "sql"),
    "info": (Info, InfoResponse, "info"),
    "addData": (AddData, AddDataResponse, "add_data"),
    "mark": (Mark, MarkResponse, "mark"),
    "removeData": (RemoveData, RemoveDataResponse, "remove_data"),
    "lookupTransform": (LookupTransform, LookupTransformResponse, "lookup_transform"),
}
"""Services by name: class, class of the response, and the handler of QueryServices."""


def _definition(request: AddDataRequest, topic: CassandraTopic | None) -> Definition:
    """Return the definition of a message to be stored, in an existing topic or a new one (None).

    It is that of the request, else that of the topic if type and md5 agree, else the installed one.

    Raises:
        InvalidName: A new topic needs a type.
        DefinitionError: The definition cannot be used, or has another md5 than the request.
    """
    kind, md5sum = request.type, request.md5sum or None
    if topic is not None:
        stored = topic.tables[-1].metadata
        kind = kind or stored.msg_type
        same = kind == stored.msg_type and md5sum in (None, stored.md5sum)
        if same and not request.definition:
            return parse_definition(kind, stored.definition, stored.md5sum)
    if not kind:
        raise InvalidName(f"topic {request.topic} is not stored yet: give the type, 'pkg/Name'")
    if request.definition:
        return parse_definition(kind, request.definition, md5sum)
    installed = installed_definition(kind)
    if md5sum not in (None, installed.md5sum):
        raise DefinitionError(
            f"the installed {kind} has the md5 {installed.md5sum}, not {md5sum}: give definition"
        )
    return installed


def _stored_topic(info: TopicInfo) -> StoredTopic:
    """Return the information about a topic as a StoredTopic."""
    return StoredTopic(
        topic=clean(info.topic),
        type=clean(info.type),
        md5sum=clean(info.md5sum),
        format=info.format,
        node_id=clean(info.node),
        found_by=info.key,
        messages=info.count,
        bytes=info.bytes,
        first=ros_time(info.first_ns or 0),
        last=ros_time(info.last_ns or 0),
        lost=info.lost,
    )


def pack(row: StoredRow, omit_data: bool, omit_yaml: bool) -> StoredMessage:
    """Return a stored row as a StoredMessage.

    Raises:
        AnswerTooLarge: The message is larger than an answer may be.
    """
    if not omit_data:
        what = f"the message of {row.size} bytes at {row.key} of topic {clean(row.topic)}"
        AnswerBound(what, _ELSEWHERE).count_part(row.size)
    return StoredMessage(
        key=ros_time(row.t),
        key_text=clean(row.name) or (iso_time(row.t) if row.table.value_part else str(row.t)),
        node_id=clean(row.node),
        topic=clean(row.topic),
        type=clean(row.type),
        md5sum=clean(row.md5sum),
        data=b"" if omit_data else row.wire,
        yaml="" if omit_yaml else clean(_yaml(row)),
    )


def size_of(message: StoredMessage) -> int:
    """Return the approximate size of a StoredMessage in an answer, bytes."""
    return len(message.data) + len(message.yaml) + 200


def clean(text: str) -> str:
    """Return a text without surrogates, as valid UTF-8: it may come from outside."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def _yaml(row: StoredRow) -> str:
    """Return a message as YAML, or a comment of YAML that says why it is not shown."""
    if row.size > YAML_BYTES:
        return f"# {row.size} bytes of {row.type} are too many to be shown here: read data"
    try:
        return to_yaml(row.message())
    except (CorruptMessage, DefinitionError) as exc:
        return "# " + " ".join(str(exc).split())
