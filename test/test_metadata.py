# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Comments of tables that others changed: any change gives metadata that work, or leaves it out."""

from __future__ import annotations

import json
import logging
from dataclasses import fields

import pytest
from hypothesis import given
from hypothesis import strategies as st
from std_msgs.msg import String

from cassandra_ros.errors import UnsupportedSchema
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.metadata import (
    _CHECKS,
    SCHEMA_VERSION,
    SIDE_COMMENT,
    MetaView,
    TopicMetadata,
    from_comment,
)

GOOD = TopicMetadata(
    "/t",
    "std_msgs/String",
    "992ce8a1687cec8c8bd883ec73ca41d1",
    "ros",
    60 * 10**9,
    definition="string data",
    indexes={"data": "_ix0"},
    index_names={"by_data": "data"},
    index_count=1,
    columns=({"name": "data"},),
    user={"site": "lab"},
    replaces=("t_old",),
)
NAMES = [field.name for field in fields(TopicMetadata)]
SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text()
    | st.sampled_from(["os", "ros", "\ud800", "_ix1", "hash", -1, 0, 2**63, 10**30])
)
VALUES = st.recursive(
    SCALARS, lambda each: st.lists(each, max_size=3) | st.dictionaries(st.text(), each, max_size=3)
)


def test_every_field_is_checked():
    assert set(_CHECKS) == set(NAMES)


def test_a_comment_is_read_as_it_was_written():
    assert from_comment(GOOD.to_comment(), "k.t") == GOOD


def use(metadata):
    """Do what listing, reading and writing a topic do with its metadata."""
    format_class(metadata.format)
    assert metadata.topic.encode() and metadata.topic < "~" * 2**10
    assert metadata.next_shadow >= 0 and 10**18 // metadata.bucket_ns >= 0
    assert metadata.received_columns is not None and metadata.partition in ("_key", "_bucket")
    assert metadata.with_user({"a": 1}, None).user["a"] == 1
    assert {*metadata.replaces, metadata.nodeID, metadata.md5sum, metadata.msg_type}
    assert max(metadata.date, "") >= "" and metadata.ttl // 60 >= 0
    assert MetaView(metadata, [])["topic"] == metadata.topic
    assert from_comment(metadata.to_comment(), "k.t") == metadata


@given(st.sampled_from(NAMES), VALUES, st.booleans())
def test_one_changed_field_gives_metadata_that_work_or_none(name, value, drop):
    told = json.loads(GOOD.to_comment())["cassandra_ros"]
    told[name] = value
    if drop:
        del told[name]
    try:
        found = from_comment(json.dumps({"cassandra_ros": told}), "k.t")
    except UnsupportedSchema:
        assert name == "version"
        return
    if found is not None:
        use(found)


OTHERS = [SCHEMA_VERSION - 1, SCHEMA_VERSION + 1]
REFUSED = f"has schema version {{}}, .* only version {SCHEMA_VERSION}: export the topics .* import"


def of_version(comment, version):
    """Return the comment of a topic's table, or of a side table, with another version."""
    other = comment.replace(f'"version": {SCHEMA_VERSION}', f'"version": {version}')
    assert other != comment
    return other


@pytest.mark.parametrize("version", OTHERS)
@pytest.mark.parametrize("comment", [GOOD.to_comment(), SIDE_COMMENT], ids=["topic", "side table"])
def test_another_version_is_refused_with_what_to_do(comment, version):
    with pytest.raises(UnsupportedSchema, match="table k.t " + REFUSED.format(version)):
        from_comment(of_version(comment, version), "k.t")


@pytest.mark.parametrize("version", OTHERS)
@pytest.mark.parametrize("whose", ["topic", "cr_run"])
def test_a_keyspace_of_another_version_is_not_read_and_not_written(
    rosCas, connect, cql, whose, version
):
    rosCas.addTopic("/t").addData(String("x"))
    (table,) = rosCas.getTopic("/t").tables
    name, comment = table.name, table.metadata.to_comment()
    if whose != "topic":
        name, comment = whose, SIDE_COMMENT
    assert from_comment(SIDE_COMMENT, name) is None
    cql.execute(
        f"ALTER TABLE {rosCas.keyspace}.{name} WITH comment = '{of_version(comment, version)}'"
    )
    words = f"{rosCas.keyspace}.{name} " + REFUSED.format(version)
    with connect(keyspace=rosCas.keyspace) as other:
        for use in (
            other.getAllTopics,
            other.info,
            lambda: other.getTopic("/t"),
            lambda: other.addTopic("/u").addData(String("x")),
            lambda: other.upkeep.check(repair=True),
        ):
            with pytest.raises(UnsupportedSchema, match=words):
                use()


@given(VALUES)
def test_anything_under_our_key_is_left_out(value):
    assert from_comment(json.dumps({"cassandra_ros": value}), "k.t") is None


@given(st.text(), st.integers(0, 2000), st.integers(0, 2000))
def test_a_comment_that_was_cut_or_written_into_is_no_error(text, begin, end):
    comment = GOOD.to_comment()
    try:
        found = from_comment(comment[:begin] + text + comment[end:], "k.t")
    except UnsupportedSchema:
        return
    if found is not None:
        use(found)


@pytest.mark.parametrize(
    ("field", "value"),
    [("topic", 5), ("format", "os"), ("bucket_ns", 0), ("ttl", -1), ("indexes", {"data": "_t"})],
)
def test_such_a_table_is_left_out_with_one_warning_that_names_it(rosCas, cql, caplog, field, value):
    rosCas.addTopic("/good").addData(String("x"))
    rosCas.addTopic("/bad").addData(String("x"))
    (table,) = rosCas.getTopic("/bad").tables
    told = json.loads(table.metadata.to_comment())
    told["cassandra_ros"][field] = value
    cql.execute(f"ALTER TABLE {table.qualified} WITH comment = '{json.dumps(told)}'")
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            assert [topic.name for topic in rosCas.getAllTopics()] == ["/good"]
            assert [info.topic for info in rosCas.info()] == ["/good"]
    (warning,) = [r.getMessage() for r in caplog.records if "left out" in r.getMessage()]
    assert f"table {rosCas.keyspace}.{table.name} is left out" in warning
    assert f"{field} cannot be {value!r}" in warning


@pytest.mark.parametrize("version", ["Infinity", "-Infinity", "NaN", "1e999", "[1]", "null"])
def test_a_version_that_is_no_number_is_no_error(version):
    """Python reads Infinity in JSON; one changed comment must not break all reads."""
    made = TopicMetadata(
        topic="/x", msg_type="a/B", md5sum="0" * 32, definition="", format="ros", bucket_ns=1
    )
    comment = made.to_comment().replace(f'"version": {SCHEMA_VERSION}', f'"version": {version}')
    assert comment != made.to_comment()
    assert from_comment(comment, "t_1") is None
