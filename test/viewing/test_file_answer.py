# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Which part of a file is sent, and under which conditions."""

from __future__ import annotations

import asyncio
import contextlib

import pytest
from aiohttp import ClientSession, web

from cassandra_ros.viewing.answers import CachedFile
from cassandra_ros.viewing.handler_threads import send_file

CONTENT = bytes(range(100))
WHOLE = (200, CONTENT)


@contextlib.asynccontextmanager
async def served(path, tag):
    """Serve one file on a free port; yields its address."""
    application = web.Application()
    file = CachedFile(path, "a.bag", "application/x-rosbag", tag)

    async def answer(request):
        return await send_file(request, file)

    application.router.add_get("/", answer)
    runner = web.AppRunner(application)
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0)
    await site.start()
    try:
        yield f"http://127.0.0.1:{runner.addresses[0][1]}/"
    finally:
        await runner.cleanup()


def ask(tmp_path, method="GET", tag="tag", content=CONTENT, **headers):
    """Return status, headers and bytes of the answer."""
    path = tmp_path / "a.bag"
    path.write_bytes(content)

    async def asked():
        async with served(path, tag) as address, ClientSession() as session:
            sent = {name.replace("_", "-"): text for name, text in headers.items()}
            async with session.request(method, address, headers=sent) as answer:
                return answer.status, answer.headers, await answer.read()

    return asyncio.run(asked())


@pytest.mark.parametrize(
    ("asked", "answered"),
    [
        (None, WHOLE),
        ("bytes=0-0", (206, CONTENT[:1])),
        ("bytes=10-19", (206, CONTENT[10:20])),
        ("bytes=10-", (206, CONTENT[10:])),
        ("bytes=90-1000", (206, CONTENT[90:])),
        ("bytes=-10", (206, CONTENT[90:])),
        ("bytes=-1000", (206, CONTENT)),
        ("bytes=99-99", (206, CONTENT[99:])),
        ("bytes=100-", (416, b"")),
        ("bytes=" + "9" * 30 + "-", (416, b"")),
        ("bytes=19-10", WHOLE),
        ("bytes=0-1,5-6", WHOLE),
        ("bytes=-", WHOLE),
        ("lines=1-2", WHOLE),
    ],
)
def test_ranges(tmp_path, asked, answered):
    status, headers, data = ask(tmp_path, **({} if asked is None else {"Range": asked}))
    assert (status, data) == answered
    assert headers["Content-Length"] == str(len(data)) and headers["Accept-Ranges"] == "bytes"
    begin = CONTENT.find(data)
    ends = f"{begin}-{begin + len(data) - 1}"
    wanted = {200: None, 206: f"bytes {ends}/100", 416: "bytes */100"}
    assert headers.get("Content-Range") == wanted[status]
    assert headers["ETag"] == '"tag"' and headers["Content-Type"] == "application/x-rosbag"
    assert headers["Content-Disposition"] == 'attachment; filename="a.bag"'


def test_no_part_of_an_empty_file_exists(tmp_path):
    assert ask(tmp_path, content=b"")[::2] == (200, b"")
    assert ask(tmp_path, content=b"", Range="bytes=0-")[::2] == (416, b"")


@pytest.mark.parametrize(
    ("tag", "status"),
    [('"tag"', 206), ('"other"', 200), ('W/"tag"', 200), ("tag", 200), ("Mon, 01 Jan 2035", 200)],
)
def test_a_range_of_another_content_is_answered_by_all_of_it(tmp_path, tag, status):
    answer = ask(tmp_path, Range="bytes=5-6", If_Range=tag)
    assert (answer[0], answer[2]) == (status, CONTENT if status == 200 else CONTENT[5:7])


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"If_None_Match": '"a", W/"b"'}, 304),
        ({"If_None_Match": '"b", "c"'}, 304),
        ({"If_None_Match": "*"}, 304),
        ({"If_None_Match": '"a"'}, 200),
        ({"If_None_Match": ""}, 200),
        ({"If_Match": '"a", "b"'}, 200),
        ({"If_Match": "*"}, 200),
        ({"If_Match": '"a"'}, 412),
    ],
)
def test_lists_of_tags(tmp_path, headers, status):
    found = ask(tmp_path, tag="b", **headers)
    assert (found[0], found[2]) == (status, CONTENT if status == 200 else b"")
    assert status == 412 or found[1]["ETag"] == '"b"'


def test_a_head_has_the_length_and_no_bytes(tmp_path):
    status, headers, data = ask(tmp_path, method="HEAD", Range="bytes=-10")
    assert (status, headers["Content-Length"], data) == (206, "10", b"")
