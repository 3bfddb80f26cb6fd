# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which part of a file is answered."""

from __future__ import annotations

import pytest

from cassandra_ros.viewing.ranges import asked_part, names_etag

WHOLE = (200, 0, 100)


@pytest.mark.parametrize(
    ("asked", "answered"),
    [
        (None, WHOLE),
        ("bytes=0-0", (206, 0, 1)),
        ("bytes=10-19", (206, 10, 10)),
        ("Bytes= 10-", (206, 10, 90)),
        ("bytes=90-1000", (206, 90, 10)),
        ("bytes=-10", (206, 90, 10)),
        ("bytes=-1000", (206, 0, 100)),
        ("bytes=100-", (416, 0, 0)),
        ("bytes=-0", (416, 0, 0)),
        ("bytes=19-10", WHOLE),
        ("bytes=0-1,5-6", WHOLE),
        ("bytes=-", WHOLE),
        ("lines=1-2", WHOLE),
        ("bytes=" + "9" * 30 + "-", WHOLE),
    ],
)
def test_ranges(asked, answered):
    part = asked_part({} if asked is None else {"range": asked}, "tag", 100)
    assert (part.status, part.start, part.count) == answered
    said = part.headers()
    assert said["Content-Length"] == str(part.count) and said["Accept-Ranges"] == "bytes"
    ends = f"{part.start}-{part.start + part.count - 1}"
    wanted = {200: None, 206: f"bytes {ends}/100", 416: "bytes */100"}
    assert said.get("Content-Range") == wanted[part.status]


@pytest.mark.parametrize(
    ("tag", "status"),
    [('"tag"', 206), ('"other"', 200), ('W/"tag"', 200), ("tag", 200), ("Mon, 01 Jan 2035", 200)],
)
def test_a_range_of_another_content_is_answered_by_all_of_it(tag, status):
    assert asked_part({"range": "bytes=5-6", "if-range": tag}, "tag", 100).status == status


def test_lists_of_tags():
    assert names_etag('"a", W/"b"', "a") and names_etag('"a", W/"b"', "b") and names_etag("*", "c")
    assert not names_etag('"a"', "b") and not names_etag("", "a")
