# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The benchmark is right about what it measures; how fast anything is is not looked at."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import pytest
from conftest import ROOT

# Its modules have names of their own: what lies there is found before folders of tests.
sys.path.append(str(ROOT / "benchmark"))

from suite.contenders import FORMAT_NAMES, NotEqual, Rosbag, verify  # noqa: E402
from suite.messages import KINDS, serialized  # noqa: E402
from suite.results import Results  # noqa: E402
from suite.tables import TABLES, fill  # noqa: E402
from suite.targets import rows, targets  # noqa: E402

EXPERIMENTS = (
    *("writing", "bags", "copies", "growth", "lookups", "clauses", "conditions", "sql", "live"),
    *("start", "writers", "cluster"),
)
FILES = ("rosbag", "mcap", "sqlite")
PAGE = ROOT / "doc/performance.md"


@pytest.mark.parametrize("kind", KINDS)
def test_messages_are_of_their_type_and_the_same_in_every_run(kind):
    batch, again = KINDS[kind](3), KINDS[kind](3)
    assert (batch.times, batch.wires) == (again.times, again.wires)
    assert [serialized(msg) for msg in batch.objects()] == batch.wires
    assert len(set(batch.wires)) == len(batch) == 3
    assert batch.times == sorted(set(batch.times))


def test_what_was_read_otherwise_is_told(tmp_path):
    bag = Rosbag(KINDS["imu"](5), tmp_path)
    bag.open()
    bag.extend(0, 5)
    bag.finish()
    verify(bag, bag.batch)
    with pytest.raises(NotEqual, match="read 5 messages of 4"):
        verify(bag, bag.batch.first(4))
    bag.batch.wires[2] = bag.batch.wires[1]
    with pytest.raises(NotEqual, match="others than were written"):
        verify(bag, bag.batch)


def made_up():
    results = Results()
    for kind, rosbag, mine in (("imu", [100, 200, 300], 500), ("tf", [10], 19)):
        results.add("writing", "write", "rosbag", rosbag, "msg/s", kind)
        results.add("writing", "write", "packed import", [mine], "msg/s", kind)
    results.add("lookups", "lookup", "ros", [1.0, 2.0, 9.0], "ms", x=100)
    results.add("lookups", "lookup", "ros", [2.3], "ms", x=1000)
    results.add("lookups", "lookup", "bare SELECT, ros", [2.0], "ms", x=100)
    results.add("lookups", "lookup", "bare SELECT, ros", [2.0], "ms", x=1000)
    return results


def find(results, work, unit):
    (found,) = [one for one in targets(results) if (one.work, one.unit) == (work, unit)]
    return found


def test_a_target_is_told_by_its_worst_case():
    importing = find(made_up(), "import packed, small messages", "x rosbag")
    # What did not run is named: it may be the worst.
    assert (importing.reached, importing.ok) == (1.9, False)
    assert importing.case == "tf; without paper, joints"
    assert importing.verdict == "missed: 95% of it"
    assert replace(importing, reached=1.999).verdict == "missed: 99.9% of it"
    lookup = find(made_up(), "lookup by key, ros", "x bare SELECT")
    assert (lookup.case, lookup.ok, lookup.verdict) == ("1,000", True, "reached")
    grown = find(made_up(), "lookup by key, ros", "x that at 100")
    assert grown.ok and grown.reached == pytest.approx(1.15)
    grown = Results(series=[one for one in made_up().series if one.x == 1000])
    grown.add("lookups", "lookup", "ros", [1.0], "ms", x=100)
    assert find(grown, "lookup by key, ros", "x that at 100").verdict == "missed: 92% above it"


def test_the_size_of_a_bag_is_told_with_and_without_the_files_that_do_not_grow():
    results = Results()
    for what, value in (("size", 0.17), ("size of data alone", 0.1), ("write", 3)):
        results.add("bags", what, "packed", [value], "", "husky.bag")
    results.add("bags", "size", "rosbag", [1.3], "", "husky.bag")
    table = TABLES["bags"](results)
    assert "| packed | 0.17 (data alone 0.1), 3/s |" in table
    assert "| rosbag | 1.3, -/s |" in table


def test_what_was_not_measured_is_neither_reached_nor_missed():
    verdicts = {row[-1] for row in rows(Results())[1:]}
    assert verdicts == {"not measured"}
    assert find(made_up(), "import packed, small messages", "x mcap").ok is None
    wanted = [row[1] for row in rows(Results())]
    assert {"≥ 20,000 msg/s", "≥ 1.3 x rosbag", "≤ 406 MB"} <= set(wanted)


def test_results_are_the_same_from_their_file(tmp_path):
    results = made_up()
    results.save(tmp_path / "some.json")
    assert Results.load(tmp_path / "some.json") == results


def test_an_experiment_that_ran_anew_takes_the_place_of_the_former(tmp_path):
    results, later = made_up(), Results({"date": "today", "commit": "abc"}, seconds={"lookups": 2})
    results.seconds = {"writing": 3.0, "lookups": 1.0}
    later.add("lookups", "lookup", "ros", [7.0], "ms", x=100)
    later.add("writing", "write", "rosbag", [1], "msg/s", "imu")
    results.take(later)
    assert [one.values for one in results.of("lookups")] == [[7.0]]
    assert results.find("writing", "write", "rosbag", "imu") == [100, 200, 300]
    assert results.seconds == {"writing": 3.0, "lookups": 2}
    assert results.machine["anew"] == {"lookups": "today, commit abc"}


@pytest.fixture(scope="module")
def smoke(cassandra, workspace_env, tmp_path_factory):
    """The results of a run of the whole suite with next to nothing to measure."""
    folder = tmp_path_factory.mktemp("results")
    command = [sys.executable, ROOT / "benchmark/bench.py", "--size", "smoke"]
    command += ["--host", cassandra.host, "--port", str(cassandra.port), "--results", folder]
    done = subprocess.run(
        list(map(str, command)), env=workspace_env, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stderr[-4000:] + done.stdout[-2000:]
    return folder, done.stdout, Results.load(folder / "smoke.json")


def test_a_day_of_a_robot(rosCas):
    from suite.day import DAY_NS, store_day
    from suite.messages import START_NS

    counts = store_day(rosCas, 4320)
    assert {t.name: t.countTopicData() for t in rosCas.getAllTopics()} == counts
    imu = rosCas.getTopic("/imu")
    assert (imu.first().ns, imu.last().ns) == (START_NS, START_NS + DAY_NS - DAY_NS // 4320)
    msg = imu.getData(START_NS + DAY_NS // 2, nearest="before")
    assert msg.header.stamp.to_nsec() == START_NS + DAY_NS // 2
    assert msg.linear_acceleration.x != msg.angular_velocity.z != 0
    moved = rosCas.lookupTransform("odom", "laser", imu.first())
    assert moved.transform.translation.x == pytest.approx(10)


def test_the_viewer_s_table_tells_what_was_missed():
    results = Results()
    results.add("viewer", "seek", "viewer", [1.0, 2.0, 9.0], "s")
    results.add("viewer", "plot of the day, first answer", "viewer", [1.5], "s")
    table = TABLES["viewer"](results)
    assert "| seek | ≤ 3 s | 2 s (1.5 to 5.5) | reached |" in table
    assert "| plot of the day, first answer | ≤ 1 s | 1.5 s | missed |" in table
    assert "| open at hour 12 | ≤ 3 s | - | not measured |" in table


def test_every_part_of_the_suite_runs(smoke):
    folder, output, results = smoke
    assert results.failures == []
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
    assert "must reach" in output
    assert len(list(folder.glob("smoke-*.png"))) == 5
    machine = json.loads((folder / "smoke.json").read_text())["machine"]
    assert machine["commit"] and machine["date"] and machine["versions"]["cassandra"]


def test_every_table_is_made_of_what_was_measured(smoke):
    _, _, results = smoke
    for name in TABLES:
        page = f"a\n<!-- bench:{name} -->\nold\n<!-- /bench:{name} -->\nb\n"
        filled = fill(page, results)
        assert "old" not in filled
        assert fill(filled, results) == filled
    for page in ("<!-- bench:done -->", "<!-- bench:nothing --><!-- /bench:nothing -->"):
        with pytest.raises(ValueError, match="bench:"):
            fill(page, results)


def test_the_figures_of_the_page_are_those_of_the_last_full_run():
    path = ROOT / "benchmark/results/full.json"
    if not path.is_file():
        pytest.skip("there was no full run yet")
    text = PAGE.read_text(encoding="utf-8")
    assert "<!-- bench:" in text
    assert fill(text, Results.load_all(path)) == text, "fill them with: make bench-page"
