# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""SECURITY.md: its figures are those of the code."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path

from hostile.inputs import GROWTH_MB, INPUT_SEC

from cassandra_ros import own_files, yaml_text
from cassandra_ros.cli import viewer
from cassandra_ros.cli.recorder import make_parser
from cassandra_ros.client.sql import (
    duck_database,
    process_frames,
    sql_statement,
    statement_process,
    statement_processes,
)
from cassandra_ros.files.bag import format as bag_format
from cassandra_ros.files.bag import mcap_format, message_file
from cassandra_ros.files.spool import spool_folder
from cassandra_ros.local_server import LocalCluster, cluster_settings, ports, processes
from cassandra_ros.local_server.cluster_settings import ClusterSettings
from cassandra_ros.messages import definition, shape
from cassandra_ros.nodes import history_subscriber, query_node, ros_node, subscription
from cassandra_ros.query.tree import json_values, parse
from cassandra_ros.recording import place_keeper, recording
from cassandra_ros.viewing import security, viewer_server, viewer_settings

ROOT = Path(__file__).resolve().parents[1]
LIMITS = viewer_settings.ClientLimits()


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
    mib(query_node.YAML_BYTES),
    mib(json_values.MAX_ANSWER_BYTES),
    mib(parse.MAX_STATEMENT),
    f"{sql_statement.MAX_STATEMENT_CHARACTERS >> 10} KiB",
    duck_database.MEMORY,
    f"{duck_database.SPILL_BYTES // 10**9}GB",
    f"{statement_process.MORE_BYTES >> 30} GiB",
    f"{statement_process.SPILL_BYTES // 10**9} GB",
    f"{statement_process.KEPT_BYTES // 10**9} GB",
    f"{statement_processes.STATEMENT_SEC:g} s",
    str(statement_processes.STATEMENTS_AT_ONCE),
    mib(process_frames.MAX_FRAME_BYTES),
    mib(definition.MAX_DEFINITION_CHARACTERS),
    str(definition.MAX_TYPES),
    str(shape.MAX_DEPTH),
    mib(shape.MAX_FIXED_BYTES),
    mib(message_file.MAX_CHUNK_BYTES),
    f"{message_file.MAX_RATIO} times",
    f"{message_file.MAX_PLAIN_BYTES >> 30} GiB",
    mib(mcap_format.MAX_DESCRIPTION_BYTES),
    str(message_file.MAX_RECORDS),
    str(LIMITS.clients),
    f"{LIMITS.head_sec:g} s",
    f"{LIMITS.idle_sec:g} s",
    f"{LIMITS.stalled_sec:g} s",
    f"{viewer_server.MAX_LINE_BYTES >> 10} KiB",
    str(viewer_settings.DEFAULT_THREADS),
    mib(LIMITS.answers_bytes),
    f"{viewer_settings.DEFAULT_CACHE_BYTES // 10**9} GB",
    f"{viewer.TOKEN_BYTES} bytes",
    f"{security.COOKIE_SEC // 86_400} days",
    mib(yaml_text.MAX_CONFIG_BYTES),
]


def test_each_figure_is_that_of_the_code():
    text = (ROOT / ".github/SECURITY.md").read_text(encoding="utf-8")
    table = text.split("| piece | bound | figure |")[1].split("\n\n")[0]
    rows = [line.strip("| ").split(" | ") for line in table.splitlines()[2:]]
    assert [row[2] for row in rows] == FIGURES
    assert bag_format.MAX_CONNECTION_BYTES == mcap_format.MAX_DESCRIPTION_BYTES  # a row for both


LEAST_HEAP, MOST_HEAP = cluster_settings.OWN_HEAP_MB
PROMISES = [
    f"{LEAST_HEAP} MiB to {MOST_HEAP >> 10} GiB (`--heap`), "
    f"about {cluster_settings.BESIDE_HEAP_MB} MiB beside it",
    f"has less than {make_parser().get_default('min_space') >> 30} GiB free",
    f"takes more than {INPUT_SEC:g} s of processor time",
    f"makes the process grow by {GROWTH_MB} MB",
    f"is waited for at most {processes.LOCK_SEC:g} s; "
    f"then, and every {processes.TELL_SEC:g} s, a line says which process holds it",
    f"delay the start of a ROS node by {ros_node.ALONE_SEC:g} s",
    f"| {viewer_settings.DEFAULT_PORT} (`--port`) |",
    f"`{viewer_settings.DEFAULT_HOST}`; another one only with `--host` and a token",
    f"| {ClusterSettings('x').port} (`--port`) |",
    f"`{ClusterSettings('x').host}`, with several nodes `127.0.0.1` to `127.0.0.N`",
    f"a free one, {ports.SERVER_PORTS.start} to {ports.SERVER_PORTS.stop - 1} |",
]
"""What the text says, with the figures of the code."""
NO_FIGURES = (
    "ROS 1 ",
    "`make campaign ARGS='test/hostile --inputs 1000000'`",  # how many one wants
    "(modes 600 and 700)",  # see below
    "(mode 700)",
)


def test_the_text_has_the_figures_of_the_code_and_no_others():
    text = (ROOT / ".github/SECURITY.md").read_text(encoding="utf-8")
    table = text.split("| piece | bound | figure |")[1].split("\n\n")[0]
    rest = " ".join(text.replace(table, "").split("# Security", 1)[1].split())
    for part in (*PROMISES, *NO_FIGURES):
        assert part in rest
    for part in (*PROMISES, *NO_FIGURES):
        rest = rest.replace(part, "")
    assert re.findall(r"[^ ]* ?[^ ]*[0-9][^ ]*", rest) == []


def test_the_modes_of_our_files_are_those_that_are_named(tmp_path):
    os.close(own_files.lock_own(tmp_path / "lock"))
    own_files.own_folder(tmp_path / "folder")
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("lock", "folder")]
    text = (ROOT / ".github/SECURITY.md").read_text(encoding="utf-8")
    assert "(modes {:o} and {:o})".format(*modes) in text
    cluster = LocalCluster(tmp_path / "cassandra")
    cluster.nodes[0].write_config()
    mode = stat.S_IMODE(cluster.nodes[0].directory.stat().st_mode)
    assert f"owner alone (mode {mode:o})" in text
