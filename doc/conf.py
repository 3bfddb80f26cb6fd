# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How Sphinx makes the pages: make doc. What they show of the code is read from it."""

from __future__ import annotations

import logging
import os
import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))  # directives.py

# What is imported to be described says nothing of its own.
logging.getLogger("rospy").setLevel(logging.WARNING)

# Defaults are shown as the program has them, not as this shell does.
for name in [name for name in os.environ if name.startswith("CASSANDRA_ROS_")]:
    del os.environ[name]

project = "cassandra_ros"
project_copyright = "2026, cassandra_ros authors"
version = release = re.findall(
    r"<version>(.*)</version>", (HERE.parent / "package.xml").read_text(encoding="utf-8")
)[0]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "directives"]
html_theme = "furo"
html_title = f"cassandra_ros {version}"
html_show_sourcelink = False
html_css_files = ["wide.css"]
html_static_path = ["static"]
smartquotes = False  # or --yaml would be shown with a dash
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False


def setup(app: object) -> None:
    """Show what modules hold, not what they say to who reads the code."""

    def process(
        _app: object, what: str, _name: str, _object: object, _: object, lines: list
    ) -> None:
        if what == "module":
            lines.clear()

    app.connect("autodoc-process-docstring", process)  # type: ignore[attr-defined]
