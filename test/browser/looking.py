# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What tests of pages look with: the viewer's address and answers, and pixels of pictures."""

from __future__ import annotations

import io
import json
import os
import urllib.request
from dataclasses import dataclass
from urllib.parse import urlencode

import numpy as np
import pytest
from conftest import ROOT
from nodes.children import Child
from PIL import Image

HUSKY = ROOT / "examples/data/husky_gps_data.bag"
HUSKY_TOPICS = ["/tf", "/fix", "/imu/data", "/encoder", "/rosout"]
BUSY = 1_500_000_000
"""A second of 2017."""
LATER = 1_767_225_600
"""The first second of 2026."""
HUSKY_START, HUSKY_END = 1368021980018130437, 1368022017990698933


@dataclass(frozen=True)
class Viewer:
    """A running viewer."""

    url: str
    process: Child

    def at(self, path, **parameters):
        """Return the address of a page or an answer."""
        query = urlencode({name: str(value) for name, value in parameters.items()})
        return f"{self.url}{path}" + (f"?{query}" if query else "")

    def ask(self, path, **parameters):
        """Return what it answers to a script: JSON."""
        address = self.at(path, **parameters)
        with urllib.request.urlopen(address, timeout=300) as answer:  # noqa: S310 (our own)
            return json.load(answer)


def unable(what, why, needed=False):
    """Skip a test for what is missing; fail where it is needed, and where changes are checked."""
    if needed or "true" in (os.environ.get("CI"), os.environ.get("GITHUB_ACTIONS")):
        pytest.fail(f"{what}: {why}")
    pytest.skip(f"{what}: {why}")


def pixels(png):
    """Return a picture as an array: rows, columns, red-green-blue."""
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def near(array, colour, within=40):
    """Tell which pixels of an array have about a colour."""
    return np.abs(array - np.array(colour)).max(axis=2) <= within
