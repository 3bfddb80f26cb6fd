# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The caret that an error shows under the wrong spot of a statement."""

from __future__ import annotations


def check_caret(error):
    """Check that an InvalidQuery shows the line of its spot alone, and the caret under the spot.

    As a terminal shows it, which widens tabs.
    """
    text, position = error.statement, error.position
    begin = text.rfind("\n", 0, position) + 1
    reason, line, caret = str(error).rsplit("\n", 2)
    assert reason == error.reason
    assert line == f"  {text[begin:].partition(chr(10))[0]}"
    assert caret.strip() == "^"
    assert caret.expandtabs().index("^") == len(f"  {text[begin:position]}".expandtabs())
