# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Fixture that gives a test its inputs, and prints what became of them."""

from __future__ import annotations

import faulthandler
import tempfile

import pytest
from hostile.inputs import Inputs
from suites import examples


def pytest_collection_modifyitems(items):
    for item in items:
        if "hostile" in item.path.parts:
            item.add_marker(pytest.mark.search)


@pytest.fixture
def give(request, record_property, tmp_path, monkeypatch):
    """Give a target its inputs: ``give('name', tenth of its number in the campaign, attempt)``."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setattr(tempfile, "tempdir", str(folder))

    def run(target, number, attempt, **options):
        asked, first = (request.config.getoption(name) for name in ("inputs", "first"))
        count = examples(number) if asked is None else asked
        # A million inputs take longer than pytest waits before it prints a running thread's stack,
        # which may crash the interpreter; an input that hangs is found by Inputs.
        faulthandler.cancel_dump_traceback_later()
        inputs = Inputs(target, range(first, first + count), request.config.getoption("every"))
        report = inputs.give(attempt, **options)
        record_property("told", str(report))
        return report

    return run
