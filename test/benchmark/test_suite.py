# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The whole benchmark runs with little to measure, and the page shows its last full run."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from conftest import ROOT

# Its modules have names of their own: what lies there is found before folders of tests.
sys.path.append(str(ROOT / "benchmark"))

from suite.contenders import FORMAT_NAMES  # noqa: E402
from suite.results import Results  # noqa: E402
from suite.tables import TABLES, fill  # noqa: E402

EXPERIMENTS = (
    *("writing", "bags", "copies", "growth", "lookups", "clauses", "conditions", "sql", "live"),
    *("start", "writers", "cluster"),
)
FILES = ("rosbag", "mcap", "sqlite")
PAGE = ROOT / "doc/performance.md"


def measured(cassandra, workspace_env, folder, *experiments):
    """Run all or some experiments with little to measure; return their results."""
    command = [sys.executable, ROOT / "benchmark/bench.py", "--size", "smoke"]
    command += ["--only", *experiments] if experiments else []
    command += ["--host", cassandra.host, "--port", cassandra.port, "--results", folder]
    done = subprocess.run(
        list(map(str, command)), env=workspace_env, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr[-4000:] + done.stdout[-2000:]
    assert experiments or "must reach" in done.stdout
    results = Results.load(next(folder.glob("*.json")))
    assert results.failures == []
    return results


@pytest.mark.suite("campaign", "it starts three Cassandras, and programs of each contender")
def test_every_part_of_the_suite_runs(cassandra, workspace_env, tmp_path):
    results = measured(cassandra, workspace_env, tmp_path)
    assert tuple(results.seconds) == EXPERIMENTS
    for experiment in EXPERIMENTS:
        assert results.of(experiment), experiment
    assert all(one.values for one in results.series)
    # What was written was compared with what is read: extend, finish, raw of each contender.
    for kind in ("paper", "tf", "image"):
        for name in (*FORMAT_NAMES, *FILES, "bare driver"):
            assert results.find("writing", "write", name, kind), (name, kind)
            assert results.find("writing", "read", name, kind), (name, kind)
        for name in (*(f"{name} import" for name in FORMAT_NAMES), "rosbag objects"):
            assert results.find("writing", "write", name, kind), (name, kind)
    for name in (*FORMAT_NAMES, *FILES):
        assert len(results.find("lookups", "lookup", name, x=1000)) == 3, name
    for one in results.of("live", "lost"):
        assert one.values == [0], one
    assert len(list(tmp_path.glob("smoke-*.png"))) == 5
    machine = json.loads((tmp_path / "smoke.json").read_text())["machine"]
    assert machine["commit"] and machine["date"] and machine["versions"]["cassandra"]
    for name in TABLES:
        filled = fill(f"a\n<!-- bench:{name} -->\nold\n<!-- /bench:{name} -->\nb\n", results)
        assert "old" not in filled


@pytest.mark.suite("all", "it starts programs of each contender")
def test_messages_are_written_and_found_by_each_contender(cassandra, workspace_env, tmp_path):
    results = measured(cassandra, workspace_env, tmp_path, "lookups", "conditions")
    assert tuple(results.seconds) == ("lookups", "conditions")
    for name in (*FORMAT_NAMES, *FILES):
        assert len(results.find("lookups", "lookup", name, x=1000)) == 3, name
    assert results.of("conditions")


def test_the_figures_of_the_page_are_those_of_the_last_full_run():
    path = ROOT / "benchmark/results/full.json"
    if not path.is_file():
        pytest.skip("there was no full run yet")
    text = PAGE.read_text(encoding="utf-8")
    assert "<!-- bench:" in text
    assert fill(text, Results.load_all(path)) == text, "fill them with: make bench PAGE=1"
