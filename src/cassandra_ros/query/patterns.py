# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The patterns of LIKE.

``%`` stands for any text, also none, ``_`` for exactly one code point, everything else for itself;
there is no escape character. The whole text must match, upper and lower case differ.
"""

from __future__ import annotations

import re
from typing import Callable, Pattern


def likePattern(pattern: str) -> Callable[[str], bool]:
    """Return a function that tells whether a text matches a pattern of LIKE.

    Its time is at worst that of text times pattern, whatever the pattern: one regular expression
    with several ``.*`` could take for ever, so each piece between two ``%`` is looked for by
    itself, where it comes first.
    """
    pieces = pattern.split("%")
    head, tail = _piece(pieces[0]), _piece(pieces[-1])
    if len(pieces) == 1:
        return lambda text: head.fullmatch(text) is not None
    middle = [_piece(piece) for piece in pieces[1:-1] if piece]

    def test(text: str) -> bool:
        found = head.match(text)
        for piece in middle:
            if found is None:
                return False
            found = piece.search(text, found.end())
        last = len(text) - len(pieces[-1])
        return found is not None and found.end() <= last and tail.match(text, last) is not None

    return test


def _piece(text: str) -> Pattern[str]:
    return re.compile("".join("." if c == "_" else re.escape(c) for c in text), re.DOTALL)
