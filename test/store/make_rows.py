# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Makes the folder rows_v1: rows of schema version 1, as release 1.0.0 writes them.

Later releases read and change them. By hand, against a Cassandra without a keyspace of the folder's
name: PYTHONPATH=src python3 test/store/make_rows.py 127.0.0.1 9042
For a format that is added later, append its name: then only its rows are added.
"""

from __future__ import annotations

import base64
import json
import sys
import zlib
from pathlib import Path

from geometry_msgs.msg import Point, TransformStamped
from std_msgs.msg import Int32, String, UInt8MultiArray
from tf2_msgs.msg import TFMessage

from cassandra_ros import RosCassandra
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection, live_connection
from cassandra_ros.messages.definition import definition_of, parse_definition
from cassandra_ros.metadata import FORMAT_NAMES, SCHEMA_VERSION

KEYSPACE = f"rows_v{SCHEMA_VERSION}"
FOLDER = Path(__file__).with_name(KEYSPACE)
T0 = 1_500_000_000 * 10**9
SIDE_TABLES = ("cr_connection", "cr_definition", "cr_node", "cr_bucket", "cr_active")
THING = "int32 number\nstring[] names\nlost_msgs/Part[] parts\n" + "=" * 80
THING += "\nMSG: lost_msgs/Part\ntime stamp\nfloat32 value\n"
THING_WIRE = b"\7\0\0\0" + b"\1\0\0\0\2\0\0\0hi" + b"\1\0\0\0" + bytes(8) + b"\0\0\x80?"


def short(data):
    """Write a value as hex, a long one deflated; None stays None."""
    if data is None or len(data) <= 200:
        return data if data is None else data.hex()
    return "zlib:" + base64.b64encode(zlib.compress(data, 9)).decode()


def long(text):
    """Undo short."""
    if text is None or not text.startswith("zlib:"):
        return text if text is None else bytes.fromhex(text)
    return zlib.decompress(base64.b64decode(text[5:]))


def fill(rosCas, form):
    """Write one row or two of each kind in a format, under topics of its name."""
    with rosCas.messageWriter(format=form, nodeID="robot") as writer:
        counter = iter(range(1000))

        def write(topic, cls, wire, **header):
            connection = api_connection(f"/{form}/{topic}", definition_of(cls), "/maker")
            if header:
                connection = live_connection(connection.topic, header)
            number = next(counter)
            writer.write(writer.connect(connection), T0 + number * 10**8, number, wire)

        def other(type_, md5sum, text):
            return {"type": type_, "md5sum": md5sum, "message_definition": text}

        write("text", String, serialize(String(data="plain ☃ 'text'")))
        write("text", String, serialize(String()))
        write("text", String, b"\2\0\0\0\xff\0")  # no UTF-8
        write("text", String, bytes(9))  # surplus bytes
        write("text", Int32, serialize(Int32(data=-1)))
        moved = TransformStamped(child_frame_id="robot")
        moved.transform.rotation.w = float("nan")
        tf = serialize(TFMessage([moved, TransformStamped()]))
        write("tf", TFMessage, tf)
        old_name = other("tf/tfMessage", TFMessage._md5sum, TFMessage._full_text)
        write("tf", TFMessage, tf, **old_name)
        write("big", UInt8MultiArray, serialize(UInt8MultiArray(data=bytes(600_000))))
        md5sum = parse_definition("lost_msgs/Thing", THING).md5sum
        write("thing", String, THING_WIRE, **other("lost_msgs/Thing", md5sum, THING))
        # An installed type that had other fields when it was recorded.
        old = "string data\nint8 level\n"
        md5sum = parse_definition("std_msgs/String", old).md5sum
        old_string = other("std_msgs/String", md5sum, old)
        write("text", String, serialize(String(data="old")) + b"\5", **old_string)


def fill_keys(rosCas):
    """Write rows of the other kinds of keys."""
    point = Point(x=1.5, y=-0.0)
    rosCas.addTopic("/hash", key_format="hash").addData(point)
    for n in range(2):
        named = rosCas.addTopic("/manual", key_format="manual")
        named.addData(Point(x=float(n)), key="kitchen")
    rosCas.addTopic("/part", key_format="msg_part", key_part="x").addData(point)
    stamped = TransformStamped(child_frame_id="part")
    stamped.header.stamp.secs = 1_400_000_000
    rosCas.addTopic("/stamp", key_format="msg_part", key_part="header.stamp").addData(stamped)


def ask(rosCas, cql, parameters):
    return rosCas.cassandra.execute(cql, parameters, what="reading the schema")


def table_text(rosCas, table):
    """Rebuild the statements that make a table; return them with the columns' names."""
    rows = ask(
        rosCas,
        "SELECT column_name, kind, position, type FROM system_schema.columns "
        "WHERE keyspace_name = ? AND table_name = ?",
        (KEYSPACE, table),
    )
    keys = {
        kind: ", ".join(f'"{n}"' for n, k, _, _ in sorted(rows, key=lambda r: r[2]) if k == kind)
        for kind in ("partition_key", "clustering")
    }
    primary = f"({keys['partition_key']})" + (f", {keys['clustering']}" * bool(keys["clustering"]))
    columns = ", ".join(f'"{name}" {cql}' for name, _, _, cql in rows)
    statements = [f'CREATE TABLE {{keyspace}}."{table}" ({columns}, PRIMARY KEY ({primary}))']
    for name, options in ask(
        rosCas,
        "SELECT index_name, options FROM system_schema.indexes "
        "WHERE keyspace_name = ? AND table_name = ?",
        (KEYSPACE, table),
    ):
        target = options["target"].strip('"')
        statements.append(
            f'CREATE INDEX "{name}" ON {{keyspace}}."{table}" ("{target}") USING \'sai\''
        )
    return statements, [name for name, *_ in rows]


def dump(rosCas, table, comment):
    """Describe a table: its name, statements, comment, columns and rows."""
    statements, names = table_text(rosCas, table)
    listing = ", ".join(f'"{name}"' for name in names)
    statement = rosCas.cassandra.prepare(f'SELECT {listing} FROM {KEYSPACE}."{table}"')
    rows = rosCas.cassandra.send_raw(statement.bind(())).result()
    return {
        **{"table": table, "comment": comment, "statements": statements, "columns": names},
        "rows": [[short(value) for value in row] for row in rows],
    }


def expected(rosCas):
    """Tell by topic what is to be read: [time, node, type, md5sum, wire] of each message."""
    return {
        topic.name: [
            [row.t, row.node, row.type, row.md5sum, short(row.wire)] for row in topic.rows()
        ]
        for topic in rosCas.getAllTopics()
    }


def beside(path, found):
    """Put what an earlier run wrote before what this one found."""
    old = json.loads(path.read_text())
    if isinstance(found.get("rows"), list):
        return {**found, "rows": old["rows"] + found["rows"]}
    return {**old, **found}


def keep(path, found, adding):
    if adding and path.exists():
        found = beside(path, found)
    path.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")


def main(host, port, *forms):
    with RosCassandra(host, int(port), keyspace=KEYSPACE) as rosCas:
        for form in forms or FORMAT_NAMES:
            fill(rosCas, form)
        if not forms:
            fill_keys(rosCas)
        rosCas.catalog.adder.close()
        FOLDER.mkdir(exist_ok=True)
        tables = ask(
            rosCas,
            "SELECT table_name, comment FROM system_schema.tables WHERE keyspace_name = ?",
            (KEYSPACE,),
        )
        names = {}
        for table, comment in tables:
            if comment.startswith('{"cassandra_ros"'):
                values = json.loads(comment)["cassandra_ros"]
                part = values["topic"].strip("/").replace("/", "_")
                names[table] = f"{part}_{values['md5sum'][:4]}"
                names[table + "_c"] = names[table] + "_chunks"
        for table, comment in tables:
            if table in names or table in SIDE_TABLES:
                path = FOLDER / f"{names.get(table, table)}.json"
                keep(path, dump(rosCas, table, comment), bool(forms))
        keep(FOLDER / "expected.json", expected(rosCas), bool(forms))
        ask(rosCas, f"DROP KEYSPACE {KEYSPACE}", ())


if __name__ == "__main__":
    main(*sys.argv[1:])
