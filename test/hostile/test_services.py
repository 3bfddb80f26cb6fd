# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Changed requests of the services of query_server; the bytes, too, that become requests."""

from __future__ import annotations

import contextlib
import importlib
from io import BytesIO

import genpy
from hostile.inputs import Refused
from hostile.mutate import LONGS, changed_bytes, changed_text
from hostile.test_statements import WORDS, statements
from mapping.room import T0, Drive

TEXTS = {
    "topic": ["/tf", "/odom", "/scan", "/none", ""],
    "key_text": ["", str(T0), "1400000000.5", "2014-05-13T16:53:20Z", "name", "-1", "nan"],
    "nearest": ["", "before", "after", "either", "x"],
    "where": ["", "header.stamp > 0", "pose.pose.position.x > 1", "ranges contains 1"],
    "node_id": ["", "a", "é"],
    "name": ["bump", "", "é"],
    "values": ["", '{"force": 12.5}', "[1]", '{"a": NaN}'],
    "run": ["", "a", "5", "-1"],
    "target_frame": ["odom", "map", "/odom", ""],
    "source_frame": ["base", "laser", ""],
    "tf": ["", "/tf", "/scan"],
    "tf_static": ["", "/tf_static"],
    "type": ["", "std_msgs/String", "pkg/T"],
    "definition": ["", "string data", "int8 x\nint8[] y"],
    "md5sum": ["", "*", "992ce8a1687cec8c8bd883ec73ca41d1"],
    "yaml": ["", "{data: text}", "{data: *a}", "[" * 500, "!!python/object:os.system x"],
    "format": ["", "ros", "packed", "yaml", "x"],
}
"""Real values by the names of fields."""


def request_of(chance, request_class, statement):
    """Return a request whose fields hold real values, of which some are changed."""
    request = request_class()
    for name, kind in zip(request_class.__slots__, request_class._slot_types):
        changed = chance.random() < 0.3
        if kind == "string":
            real = [statement] if name == "statement" else TEXTS.get(name, [""])
            text = chance.choice(real)
            value = changed_text(chance, text, WORDS) if changed else text
            value = value.encode("utf-8", "replace").decode()
        elif kind == "string[]":
            value = [chance.choice(("1", '"a"', "null", "[1]", "{", "NaN", "1e999")) for _ in "ab"]
            value = value[: chance.choice((0, 0, 1, 2))]
        elif kind in ("time", "duration"):
            secs = chance.choice((0, T0 // 10**9, 2**32 - 1)) if changed else T0 // 10**9 + 1
            value = genpy.Time(secs, chance.choice((0, 5, 999_999_999)))
        elif kind == "uint32":
            value = chance.choice(LONGS) % 2**32 if changed else 5
        elif kind == "bool":
            value = chance.random() < 0.5
        else:
            assert kind == "uint8[]", kind
            value = b"\x04\0\0\0text" if not changed else changed_bytes(chance, b"\x04\0\0\0text")
        setattr(request, name, value)
    return request


def test_service_requests(give, rosCas):
    from cassandra_ros.nodes.query_node import QueryServices
    from cassandra_ros.recording.event_marks import EventMarks

    srv = importlib.import_module("cassandra_ros.srv")

    Drive().store(rosCas, ("/tf", "/tf_static", "/odom", "/scan"), "a")
    marks = EventMarks(rosCas.catalog.keyspace.events.put)
    reading, writing = (QueryServices(rosCas, able, marks) for able in (False, True))
    handlers = [
        (srv.GetDataRequest, reading.get_data),
        (srv.RangeRequest, reading.range),
        (srv.ExecuteCQLRequest, reading.execute_cql),
        (srv.ExplainCQLRequest, reading.explain_cql),
        (srv.InfoRequest, reading.info),
        (srv.MarkRequest, reading.mark),
        (srv.MarkRequest, writing.mark),
        (srv.LookupTransformRequest, reading.lookup_transform),
        (srv.AddDataRequest, writing.add_data),
        (srv.AddDataRequest, reading.add_data),
        (srv.RemoveDataRequest, reading.remove_data),
    ]
    real = [text for text in statements() if text.lower().startswith("select")]

    def attempt(chance):
        request_class, handler = chance.choice(handlers)
        request = request_of(chance, request_class, chance.choice(real))
        if handler == writing.add_data:  # each new topic is a table: few names
            request.topic = chance.choice(("/new", "/tf", "new", "", "a b", "/scan"))
        wire = BytesIO()
        request.serialize(wire)
        data = wire.getvalue()
        if chance.random() < 0.3:
            data = changed_bytes(chance, data, range(0, len(data), 4))
            if handler == writing.add_data:
                handler = reading.add_data
        try:
            request = request_class().deserialize(data)
        except (genpy.DeserializationError, ValueError, TypeError, AttributeError) as exc:
            raise Refused("genpy") from exc
        handler(request).serialize(BytesIO())

    @contextlib.contextmanager
    def adding():
        yield
        rosCas.catalog.adder.close()  # its thread lives as long as the client

    give("service requests", 400, attempt, within=adding)
