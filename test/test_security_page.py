# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""SECURITY.md: its figures are those of the code."""

from __future__ import annotations

from pathlib import Path

from cassandra_ros.bag import message_file
from cassandra_ros.cli.recorder import make_parser
from cassandra_ros.local_server.cluster_settings import Settings
from cassandra_ros.messages import definition, shape
from cassandra_ros.nodes import history_subscriber, query_node, subscription
from cassandra_ros.query.rows import answer_bound
from cassandra_ros.query.tree import parse
from cassandra_ros.recording import place_keeper, recording, topic_settings
from cassandra_ros.spool import spool_folder
from cassandra_ros.sql import (
    duck_database,
    process_frames,
    sql_statement,
    statement_process,
    statement_processes,
)
from cassandra_ros.viewing import viewer_settings

ROOT = Path(__file__).resolve().parents[1]
LIMITS = viewer_settings.Limits()


def mib(nbytes):
    count, rest = divmod(nbytes, 1 << 20)
    assert rest == 0
    return f"{count} MiB"


FIGURES = [
    mib(recording.DEFAULT_BUFFER_BYTES),
    f"{spool_folder.DEFAULT_BYTES >> 30} GiB",
    mib(place_keeper.MAX_HELD_BYTES),
    mib(subscription.MAX_HEADER_BYTES),
    mib(history_subscriber.DEFAULT_BUFFER_BYTES),
    mib(query_node.MAX_REPLY_BYTES),
    mib(answer_bound.MAX_ANSWER_BYTES),
    mib(parse.MAX_STATEMENT),
    f"{sql_statement.MAX_TEXT >> 10} KiB",
    duck_database.MEMORY,
    duck_database.SPILL,
    f"{statement_process.MORE_BYTES >> 30} GiB",
    f"{statement_process.SPILL_BYTES // 10**9} GB",
    f"{statement_process.KEPT_BYTES // 10**9} GB",
    f"{statement_processes.MOST_SEC:g} s",
    str(statement_processes.AT_ONCE),
    mib(process_frames.MAX_BYTES),
    mib(definition.MAX_TEXT),
    str(definition.MAX_TYPES),
    str(shape.MAX_DEPTH),
    mib(shape.MAX_FIXED_BYTES),
    mib(message_file.MAX_CHUNK_BYTES),
    f"{message_file.MAX_RATIO} times",
    str(message_file.MAX_RECORDS),
    str(LIMITS.clients),
    str(viewer_settings.DEFAULT_THREADS),
    mib(LIMITS.answers_bytes),
    f"{viewer_settings.DEFAULT_CACHE_BYTES // 10**9} GB",
    mib(topic_settings.MAX_CONFIG_BYTES),
]


def test_each_figure_is_that_of_the_code():
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    table = text.split("| piece | bound | figure |")[1].split("\n\n")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]
    assert [row[2] for row in rows] == FIGURES


def test_the_ports_are_those_of_the_code():
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8")
    port = Settings("x").port
    assert f"| {viewer_settings.DEFAULT_PORT} (`--port`) |" in text
    assert f"| {port} (`--port`) |" in text
    assert viewer_settings.DEFAULT_HOST == "127.0.0.1"
    assert make_parser().get_default("min_space") == "1G"
