# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The forty questions of doc/sql.md are asked about a robot of which each answer is known."""

from __future__ import annotations

import math
import re
from datetime import timedelta

import pytest
from conftest import ROOT
from pages import small_robot
from pages.small_robot import BEGAN, STEPS, WRITERS, at, images, recorded, speed, travelled

from cassandra_ros.messages.classes import serialize

pytest.importorskip("duckdb", reason="SQL needs DuckDB")

PAGE = (ROOT / "doc/sql.md").read_text(encoding="utf-8")
SECTION = PAGE.partition("\n## Forty questions about a robot\n")[2].partition("\n## ")[0]
QUESTIONS = re.findall(r"^\*\*(\d+)\. (.*?)\*\*\n\n```sql\n(.*?)```$", SECTION, re.M | re.S)
TOPICS = sorted({name for _, name, _ in recorded()})
COUNTS = {name: sum(name == other for _, other, _ in recorded()) for name in TOPICS}


def sizes():
    """Return the most frequent topics with messages, rate and mean size."""
    wires = {name: [] for name in TOPICS}
    for _, name, message in recorded():
        wires[name].append(len(serialize(message)))
    most = sorted(TOPICS, key=lambda name: (-COUNTS[name], name))[:3]
    return [(name, COUNTS[name], 10.0, sum(wires[name]) // COUNTS[name]) for name in most]


def periods():
    times = images()
    steps = [later - earlier for earlier, later in zip(times, times[1:])]
    mean = sum(steps) / len(steps)
    spread = math.sqrt(sum((step - mean) ** 2 for step in steps) / (len(steps) - 1))
    return [(round(mean, 3), round(spread, 3), pytest.approx(max(steps)))]


def speeds():
    rounded = [round(speed(n), 1) for n in STEPS]
    counts = {value: rounded.count(value) for value in sorted(set(rounded))}
    return [(pytest.approx(value), n) for value, n in counts.items() if n > 1]


def second(n):
    return BEGAN.replace(tzinfo=None) + timedelta(seconds=n)


def mean(values):
    return round(sum(values) / len(values), 3)


BUMPS = [at(2.003), at(7.003)]
BRAKES = [n for n in STEPS if n and speed(n) < speed(n - 1)]
ANSWERS = [
    [("r1", TOPICS), ("r2", ["/odom"])],
    sizes(),
    [(f"patrol {robot}", robot, at(0), 10.0 * n) for robot, n in WRITERS.items()],
    [("/scan", "r1", "patrol r1", "buffer full", 3, 0.5)],
    [("bump", 2, 0.4), ("docking", 1, 4.0)],
    [("r1", at(0), at(9.903)), ("r2", at(0), at(9.9))],
    [(at(6.63), at(7.43), 0.8)],
    periods(),
    [(at(3.1), 1)],
    [(0.002, 0.002)],
    [(second(6), 4), (second(7), 3)],
    [(at(3), 43.003)],
    [(0.5,)],
    [("r1", round(travelled(99), 3)), ("r2", 4.95)],
    [(at(BRAKES[0] / 10), -2.0)],
    [(at(BRAKES[0] / 10), at(BRAKES[-1] / 10), len(BRAKES))],
    [("r1", sum(speed(n) < 0.01 for n in STEPS[:-1]) / 10)],
    [(at(9.9), round(math.degrees(0.99), 1))],
    [("r1", 0.1), ("r2", 0.1)],
    speeds(),
    [(0.0, -1.0)],
    [(1.0,)],
    [(min(abs(travelled(n) - 0.05 * n) for n in STEPS[11:]),)],
    [(bump, 20.0) for bump in BUMPS],
    [(BUMPS[0], at(2.03), 0.027), (BUMPS[1], None, None)],
    [(BUMPS[1],)],
    [(0.03, 0)],
    [(BUMPS[0], 1.0), (BUMPS[1], 0.0)],
    [(1,)],
    [
        (False, mean([speed(n) for n in STEPS if not 50 <= n <= 90])),
        (True, mean([speed(n) for n in STEPS if 50 <= n <= 90])),
    ],
    [(at(0), 0.0), (at(0.1), 0.01)],
    [(at(0), 0.0, 0.0), (at(0.1), 0.01, -0.005)],
    [("elbow", 0.0, 0.99), ("wrist", -0.495, 0.0)],
    [("elbow", 0.0), ("wrist", 0.0)],
    [("elbow", at(3))],
    [(at(9.9),)],
    [(-7.5,)],
    [(at(2), True)],
    [(at(n), float(min(1 + n, 2))) for n in range(3)],
    [("wheel slips", travelled(50), speed(50))],
]


@pytest.fixture(scope="module")
def robot(fresh):
    with fresh() as store:
        small_robot.fill(store)
        yield store


def test_there_are_forty():
    assert [int(number) for number, _, _ in QUESTIONS] == list(range(1, 41))
    assert len(ANSWERS) == 40


@pytest.mark.suite("test", "each statement of the page")
@pytest.mark.parametrize("number", range(40), ids=lambda n: str(n + 1))
def test_a_question_has_its_answer(robot, number):
    _, question, statement = QUESTIONS[number]
    rows = robot.sql(statement).fetchall()
    wanted = [tuple(map(near, row)) for row in ANSWERS[number]]
    assert rows == wanted, question


def near(value):
    return pytest.approx(value, abs=1e-9) if isinstance(value, float) else value
