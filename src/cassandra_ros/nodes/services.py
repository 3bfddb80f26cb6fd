# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What the services of the query server answer: unpack, ask the library, pack."""

from __future__ import annotations

import functools
import logging
from itertools import islice
from typing import Callable, Iterator, Optional, TypeVar

import rospy

from cassandra_ros.errors import CassandraRosError, CorruptMessage, DefinitionError, InvalidKey
from cassandra_ros.keys import SECOND_NS, decode_cursor, encode_cursor
from cassandra_ros.messages.classes import to_yaml
from cassandra_ros.messages.stamps import iso_time, to_ns
from cassandra_ros.msg import Row, StoredMessage
from cassandra_ros.query.conditions import Condition
from cassandra_ros.query.json_values import from_json, to_json
from cassandra_ros.query.parse import parse_statement
from cassandra_ros.query.syntax import Select
from cassandra_ros.srv import (
    ExecuteCQLRequest,
    ExecuteCQLResponse,
    GetDataRequest,
    GetDataResponse,
    LookupTransformRequest,
    LookupTransformResponse,
    RangeRequest,
    RangeResponse,
)
from cassandra_ros.topics.ros_cassandra import RosCassandra
from cassandra_ros.topics.stored_row import StoredRow

_log = logging.getLogger(__name__)

DEFAULT_LIMIT = 100
MAX_REPLY_BYTES = 16 * 1024 * 1024
"""A page ends behind the message that passes this."""
YAML_BYTES = 1024 * 1024
"""Larger messages are not written as YAML: it takes seconds, and ten times the bytes."""
READ_ONLY = (
    "the statement changes what is stored, and this node only reads; start it with the parameter "
    "~allow_writes, as rosrun cassandra_ros query_server _allow_writes:=true, or run the statement "
    "with RosCassandra.executeCQL"
)

Request = TypeVar("Request")
Response = TypeVar("Response")
Handler = Callable[["Services", Request], Response]


def _answers(
    response_class: Callable[..., Response],
) -> Callable[[Handler[Request, Response]], Handler[Request, Response]]:
    """Let a handler answer ``success: false`` for whatever goes wrong in it."""

    def decorate(handler: Handler[Request, Response]) -> Handler[Request, Response]:
        @functools.wraps(handler)
        def answer(self: Services, request: Request) -> Response:
            try:
                return handler(self, request)
            except CassandraRosError as exc:
                return response_class(success=False, message=clean(str(exc)))
            except Exception as exc:  # noqa: BLE001 - a mistake of ours must not end the node
                _log.exception("%s failed", handler.__name__)
                reason = f"internal error: {type(exc).__name__}: {exc}; the node's log has more"
                return response_class(success=False, message=clean(reason))

        return answer

    return decorate


class Services:
    """The handlers, for one store. Thread-safe.

    Args:
        ros_cas: A RosCassandra connected to a keyspace.
        allow_writes: Run statements that change what is stored.
    """

    def __init__(self, ros_cas: RosCassandra, allow_writes: bool = False) -> None:
        self._rosCas = ros_cas
        self._allow_writes = allow_writes

    @_answers(GetDataResponse)
    def get_data(self, request: GetDataRequest) -> GetDataResponse:
        """Answer GetData."""
        topic = self._rosCas.getTopic(request.topic)
        key = topic.keyOfText(request.key_text) if request.key_text.strip() else request.key
        nearest, node = request.nearest or None, request.node_id or None
        where = request.where or None
        row = topic.getRow(key, nearest=nearest, nodeID=node, where=where)
        while row is None:
            # Raises with what lies near; or the message has come just now.
            topic.getData(key, nearest=nearest, nodeID=node, where=where)
            row = topic.getRow(key, nearest=nearest, nodeID=node, where=where)
        return GetDataResponse(True, "", pack(row, request.omit_data, request.omit_yaml))

    @_answers(RangeResponse)
    def range(self, request: RangeRequest) -> RangeResponse:
        """Answer Range."""
        limit = request.limit or DEFAULT_LIMIT
        response = RangeResponse(success=True)
        size = 0
        rows = self._rows(request, limit + 1)
        for row in islice(rows, limit):
            try:
                message = pack(row, request.omit_data, request.omit_yaml)
            except CorruptMessage as exc:
                if response.data:
                    return response  # the next page begins with it
                # The cursor leads past it.
                cursor = encode_cursor(row.position)
                return RangeResponse(False, clean(str(exc)), [], cursor)
            response.data.append(message)
            response.next_cursor = encode_cursor(row.position)
            size += size_of(message)
            if size > MAX_REPLY_BYTES:
                break
        # With a condition the next match may be far away; the next page then may be empty.
        full = len(response.data) == limit or size > MAX_REPLY_BYTES
        if not full or (not request.where and next(rows, None) is None):
            response.next_cursor = ""
        return response

    def _rows(self, request: RangeRequest, most: int) -> Iterator[StoredRow]:
        topic = self._rosCas.getTopic(request.topic)
        low = to_ns(request.key)
        high = to_ns(request.to_key) or None
        if high is not None and high < low:
            raise InvalidKey(f"to_key ({high} ns) lies before key ({low} ns)")
        after = decode_cursor(request.cursor) if request.cursor else None
        node = request.node_id or None
        if request.where:
            return Condition(request.where, node=node).rows(topic, low, high, after)
        return topic.rows(low, high, nodeID=node, limit=most, after=after)

    @_answers(ExecuteCQLResponse)
    def execute_cql(self, request: ExecuteCQLRequest) -> ExecuteCQLResponse:
        """Answer ExecuteCQL."""
        params = [from_json(text, f"params[{n}]") for n, text in enumerate(request.params)]
        statement = parse_statement(request.statement, params)
        node = request.node_id or None
        if isinstance(statement, Select):
            return self._page(statement, node, request.limit or DEFAULT_LIMIT, request.cursor)
        if not self._allow_writes:
            return ExecuteCQLResponse(success=False, message=READ_ONLY)
        if request.cursor:
            raise InvalidKey("a cursor leads to the next page of a SELECT; leave it out here")
        found = self._rosCas.statements.run(statement, node=node)
        rows = [Row([to_json(value) for value in values]) for values in found]
        return ExecuteCQLResponse(success=True, columns=list(found.columns), rows=rows)

    def _page(
        self, select: Select, node: Optional[str], limit: int, cursor: str
    ) -> ExecuteCQLResponse:
        with self._rosCas.statements.select(
            select, node=node, limit=limit + 1, after=cursor
        ) as result:
            response = ExecuteCQLResponse(success=True, columns=[clean(c) for c in result.columns])
            size = 0
            for values in islice(result, limit):
                row = Row([to_json(value) for value in values])
                response.rows.append(row)
                response.next_cursor = result.cursor
                size += 64 + sum(len(text) + 16 for text in row.values)
                if size > MAX_REPLY_BYTES:
                    break
            full = len(response.rows) == limit or size > MAX_REPLY_BYTES
            if not full or (result.direct and next(result, None) is None):
                response.next_cursor = ""
        return response

    @_answers(LookupTransformResponse)
    def lookup_transform(self, request: LookupTransformRequest) -> LookupTransformResponse:
        """Answer LookupTransform."""
        asked = {"nodeID": request.node_id, "tf": request.tf, "tf_static": request.tf_static}
        found = self._rosCas.lookupTransform(
            request.target_frame,
            request.source_frame,
            request.time,
            **{name: value for name, value in asked.items() if value},
        )
        return LookupTransformResponse(True, "", found)


def pack(row: StoredRow, omit_data: bool, omit_yaml: bool) -> StoredMessage:
    """Make a StoredMessage of a stored row."""
    return StoredMessage(
        key=rospy.Time(*divmod(row.t, SECOND_NS)),
        key_text=clean(row.name) or (iso_time(row.t) if row.table.valued else str(row.t)),
        node_id=clean(row.node),
        topic=clean(row.topic),
        type=clean(row.type),
        md5sum=clean(row.md5sum),
        data=b"" if omit_data else row.wire,
        yaml="" if omit_yaml else clean(_yaml(row)),
    )


def size_of(message: StoredMessage) -> int:
    """Return about how many bytes a StoredMessage takes in a reply."""
    return len(message.data) + len(message.yaml) + 200


def clean(text: str) -> str:
    """Return text that is valid UTF-8, for what came from outside may hold anything."""
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def _yaml(row: StoredRow) -> str:
    if row.size > YAML_BYTES:
        return f"# {row.size} bytes of {row.type}, too many to be shown here: read data"
    try:
        return to_yaml(row.message())
    except (CorruptMessage, DefinitionError) as exc:
        return "# " + " ".join(str(exc).split())
