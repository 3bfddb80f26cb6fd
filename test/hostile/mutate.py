# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Changes real bytes and texts at random, more often where their structure is."""

from __future__ import annotations

import re

NUMBERS = (0, 1, 2, 4, 7, 8, 127, 128, 255, 256, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
LONGS = (*NUMBERS, 2**32, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
_WORD = re.compile(r"[A-Za-z0-9_]+|\s+|.", re.DOTALL)
_ODD = ("\0", "\n", "\r", "\t", "'", '"', "\\", "%", "é", "☃", "\udcff", "𝄞", "\u202e", "0" * 50)


def changed_bytes(chance, data, places=(), others=()):
    """Return bytes with one to six changes.

    Args:
        chance: Random numbers.
        data: The real bytes.
        places: Offsets at which numbers or names stand that decide how the bytes are read.
        others: Other real bytes, of which parts are put in.
    """
    changed = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        _change(chance, changed, places, others)
    return bytes(changed)


def _change(chance, changed, places, others):
    size = len(changed)
    at = chance.randrange(size + 1)
    if places and chance.random() < 0.7:
        at = min(size, max(0, chance.choice(places) + chance.randrange(-2, 9)))
    kind = chance.randrange(9)
    if kind == 0 and at < size:
        changed[at] ^= 1 << chance.randrange(8)
    elif kind == 1 and at < size:
        changed[at] = chance.randrange(256)
    elif kind in (2, 3):
        width = chance.choice((2, 4, 4, 8))
        value = chance.choice(LONGS) % 256**width
        changed[at : at + width] = value.to_bytes(width, chance.choice(("little", "big")))
    elif kind == 4:
        del changed[at : at + chance.choice((1, 2, 4, 8, 100))]
    elif kind == 5:
        changed[at:at] = chance.getrandbits(8 * 16).to_bytes(16, "little")[: chance.randrange(17)]
    elif kind == 6 and chance.random() < 0.3:
        del changed[at:]
    elif kind == 7 and others:
        other = chance.choice(others)
        start = chance.randrange(len(other) + 1)
        changed[at : at + chance.choice((0, 8, 64))] = other[start : start + chance.choice((8, 99))]
    elif kind == 8:
        length = chance.choice((1, 4, 30, 200))
        changed[at:at] = changed[at : at + length]


def changed_text(chance, text, words):
    """Return a text with one to six words or characters deleted, doubled, moved or put in."""
    parts = _WORD.findall(text)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        at = chance.randrange(len(parts) + 1)
        kind = chance.randrange(7)
        if kind == 0:
            del parts[at : at + chance.choice((1, 1, 3, 20))]
        elif kind == 1:
            parts[at:at] = parts[at : at + chance.choice((1, 3, 20))]
        elif kind in (2, 3):
            parts[at : at + 1] = [chance.choice(words)]
        elif kind == 4:
            parts[at:at] = [chance.choice(words)]
        elif kind == 5:
            parts[at:at] = [chance.choice(_ODD)]
        elif parts:
            other = chance.randrange(len(parts))
            at = min(at, len(parts) - 1)
            parts[at], parts[other] = parts[other], parts[at]
    return "".join(parts)


def changed_json(chance, value, words):
    """Return a value of JSON in which one or two parts are changed, removed or of another type."""
    for _ in range(chance.choice((1, 1, 2))):
        value = _changed_part(chance, value, words)
    return value


def _changed_part(chance, value, words):
    if isinstance(value, dict) and value and chance.random() < 0.9:
        name = chance.choice(list(value))
        kind = chance.randrange(6)
        rest = {key: inner for key, inner in value.items() if key != name}
        if kind == 0:
            return rest
        if kind == 1:
            return {**rest, chance.choice(words): value[name]}
        return {**value, name: _changed_part(chance, value[name], words)}
    if isinstance(value, list) and value and chance.random() < 0.8:
        at = chance.randrange(len(value))
        return [*value[:at], _changed_part(chance, value[at], words), *value[at + 1 :]]
    if isinstance(value, str) and chance.random() < 0.5:
        return changed_text(chance, value, words)
    return any_value(chance, words)


def any_value(chance, words):
    """Return a value of JSON that is rarely expected."""
    choices = (
        lambda: chance.choice((None, True, False, "", [], {}, [[]], {"": ""})),
        lambda: chance.choice(LONGS) * chance.choice((1, -1)),
        lambda: chance.choice((0.5, -0.0, 1e308, float("inf"), float("-inf"), float("nan"), 1e-5)),
        lambda: chance.choice(words),
        lambda: changed_text(chance, chance.choice(words), words),
        lambda: "x" * chance.choice((300, 70_000)),
        lambda: 10 ** chance.choice((20, 400)),
    )
    return chance.choice(choices)()
