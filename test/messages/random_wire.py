# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Random messages as wire bytes, random definitions, and all message types installed here."""

from __future__ import annotations

import random
import struct
import sys
from pathlib import Path

SEPARATOR = "\n" + "=" * 80 + "\n"

_INTEGERS = {
    "int8": "b",
    "byte": "b",
    "uint8": "B",
    "char": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
}
FLOATS32 = [0, 1 << 31, 0x3F800000, 0x7F800000, 0xFF800000, 0x7FC00000, 0x00000001, 0x7F7FFFFF]
FLOATS64 = [0, 1 << 63, 0x3FF << 52, 0x7FF << 52, 0xFFF << 52, 0x7FF8 << 48, 1, (0x7FF << 52) - 1]
SIGNALLING32 = [0x7F800001, 0xFFA00001]
SIGNALLING64 = [0x7FF0000000000001, 0xFFF4000000000001]
TEXTS = [
    "",
    "a",
    "base_link",
    'it\'s "quoted"; --',
    "nul\0inside",
    "Zoë ☃ 𝄞",
    "line\nline",
    "x" * 300,
]
BAD_TEXTS = [b"\xff", b"abc\xc3", b"\xed\xa0\x80", b"\xc0\x80", b"\xf5\x80\x80\x80"]


class WireMaker:
    """Makes random wire bytes of a definition.

    Args:
        definition: Of the type.
        seed: Of the random numbers.
        odd: Whether values occur that no column can hold exactly.
        signalling: Whether floats may be signalling NaNs (which genpy changes).
    """

    def __init__(self, definition, seed, odd=False, signalling=True):
        self.specs = definition.specs
        self.type = definition.type
        self.random = random.Random(seed)
        self.odd = odd
        self.signalling = signalling

    def make(self):
        return self._message(self.type)

    def _message(self, name):
        return b"".join(self._field(field) for field in self.specs[name].fields)

    def _field(self, field):
        if not field.is_array:
            return self._one(field.type)
        if field.length is not None:
            return b"".join(self._one(field.type) for _ in range(field.length))
        counts = [0, 1, 2, 3] if not field.is_primitive else [0, 1, 2, 7, 200]
        count = self.random.choice(counts)
        return struct.pack("<I", count) + b"".join(self._one(field.type) for _ in range(count))

    def _one(self, type_):
        if type_ in _INTEGERS:
            return self._integer(_INTEGERS[type_])
        maker = getattr(self, "_" + type_, None)
        return maker() if maker is not None else self._message(type_)

    def _integer(self, code):
        bits = 8 * struct.calcsize("<" + code)
        low = -(1 << bits - 1) if code.islower() else 0
        high = low + (1 << bits) - 1
        value = self.random.choice([low, high, 0, 1, self.random.randint(low, high)])
        return struct.pack("<" + code, value)

    def _bool(self):
        return bytes([self.random.choice([0, 1, 2, 255] if self.odd else [0, 1])])

    def _float32(self):
        choices = FLOATS32 + SIGNALLING32 * self.signalling
        return struct.pack("<I", self.random.choice(choices))

    def _float64(self):
        choices = FLOATS64 + SIGNALLING64 * self.signalling
        return struct.pack("<Q", self.random.choice(choices))

    def _string(self):
        text = self.random.choice(TEXTS).encode()
        if self.odd and self.random.random() < 0.3:
            text = self.random.choice(BAD_TEXTS)
        return struct.pack("<I", len(text)) + text

    def _time(self):
        secs = self.random.choice([0, 1, 2**31, 2**32 - 1, self.random.getrandbits(32)])
        return struct.pack("<II", secs, self._nsecs())

    def _duration(self):
        secs = self.random.choice([0, -1, 1, -(2**31), 2**31 - 1])
        nsecs = self._nsecs()
        return struct.pack("<iI", secs, nsecs)  # also negative ones, where nsecs is odd

    def _nsecs(self):
        if self.odd and self.random.random() < 0.3:
            return self.random.choice([10**9, 2**32 - 1, 2**31])
        return self.random.choice([0, 1, 999_999_999, self.random.randrange(10**9)])


def fuzzed(wire, seed):
    """Return wire bytes with bits flipped, a length gone wild, the end cut or something added."""
    numbers = random.Random(seed)
    changed = bytearray(wire)
    for _ in range(numbers.choice([0, 0, 1, 4]) if wire else 0):
        changed[numbers.randrange(len(wire))] ^= 1 << numbers.randrange(8)
    if len(wire) >= 4 and numbers.random() < 0.4:
        length = numbers.choice([0, 1, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 1])
        struct.pack_into("<I", changed, numbers.randrange(len(wire) - 3), length)
    if numbers.random() < 0.4:
        del changed[numbers.randrange(len(wire) + 1) :]
    if numbers.random() < 0.4:
        changed += numbers.getrandbits(8 * 9).to_bytes(9, "little")[: numbers.randrange(10)]
    return bytes(changed)


def installedTypes():
    """Return the names of all message types that packages on sys.path bring."""
    found = set()
    for folder in sys.path:
        for path in Path(folder or ".").glob("*/msg/_[A-Za-z]*.py"):
            found.add(f"{path.parts[-3]}/{path.stem[1:]}")
    return sorted(found)


# Names that mean something to Python, genpy, CQL or to this package.
NAMES = (
    "a b x y z from class self None lambda import data seq key size t conn select order token "
    "header stamp name str end start length buff numpy value text type struct codecs genpy"
).split()
PRIMITIVES = [*_INTEGERS, "bool", "float32", "float64", "string", "time", "duration"]


class DefinitionMaker:
    """Makes random definitions: every message uses only those made before it."""

    def __init__(self, seed, depth=4):
        self.random = random.Random(seed)
        self.depth = depth

    def make(self):
        """Return (type, full text)."""
        made = []
        for level in range(self.depth):
            for i in range(self.random.choice([1, 2])):
                name = (
                    f"pkg{self.random.randrange(2)}/{self.random.choice(['T', 'Int32', 'Header'])}"
                )
                made.append((f"{name}{level}x{i}", self._text(made)))
        root = ("pkg0/Root", self._text(made))
        parts = [root[1], *(f"MSG: {name}\n{text}" for name, text in reversed(made))]
        return root[0], SEPARATOR.join(parts)

    def _text(self, made):
        names = self.random.sample(NAMES, self.random.choice([0, 1, 2, 3, 5, 8]))
        lines = [f"{self._type(made)} {name}  # a comment" for name in names]
        if self.random.random() < 0.3:
            lines.append('string TEXT= it\'s "here" # and here ')
            lines.append("uint8 TWO = 2 # two")
        self.random.shuffle(lines)
        return "\n".join(lines)

    def _type(self, made):
        if made and self.random.random() < 0.5:
            base = self.random.choice(made)[0]
        else:
            base = self.random.choice(PRIMITIVES)
        return base + self.random.choice(["", "", "", "[]", "[3]", "[0]", "[1]"])
