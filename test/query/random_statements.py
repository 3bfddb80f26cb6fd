# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Random statements about stored messages; their values lie at or beside those that are stored."""

from __future__ import annotations

import functools
import math
import random
import struct
from decimal import Decimal

import genpy
from hypothesis import strategies as st
from query.brute_force import (
    KEY,
    MISSING,
    NODE,
    RUN,
    AnyAll,
    Joined,
    Leaf,
    Not,
    Op,
    Path,
    Related,
    Statement,
    Value,
    canonical,
    rows_of,
)

SECOND = 10**9
ORDERED = ("=", "!=", "<", "<=", ">", ">=")
MAX_STORED = 25
"""Maximum number of values of a field, and of values near them, that are compared with it."""

INTS = [0, 1, -1, 255, 256, 2**24 + 1, 2**31 - 1, 2**31, -(2**31) - 1, 2**32, 2**53 + 1, 2**63 - 1]
INTS += [2**63, -(2**63), -(2**63) - 1, 2**64 - 1, 2**64, 10**30, -(10**40), 10**310]
FLOATS = [0.0, -0.0, math.inf, -math.inf, *[math.nan] * 4, 0.5, 0.1, 1e-45, 5e-324, -5e-324]
FLOATS += [
    1e308,
    3.4028234663852886e38,
    3.4028235e38,
    3.5e38,
    2.0**53,
    2.0**63,
    2.0**64,
    1e19,
    1e300,
]
TEXTS = ["", "'", "''", '"', "%", "_", "a%", "\x00", "\uffff", "\U0010ffff", "\udcff", "zzz", "A"]
TIMES = [0, -1, 1, 2**32 * SECOND - 1, 2**32 * SECOND, 2**63, -(2**63) - 1, 10**30]


def ulps(value):
    """Numbers beside a float: the next doubles, the next float32 and what lies between."""
    bits = struct.unpack("<q", struct.pack("<d", value))[0]
    if 0 < abs(value) < 1e308:
        yield from (struct.unpack("<d", struct.pack("<q", bits + n))[0] for n in (-1, 1))
    if 1e-40 < abs(value) < 3e38:
        near = struct.unpack("<i", struct.pack("<f", value))[0]
        for n in (-1, 0, 1):
            single = struct.unpack("<f", struct.pack("<i", near + n))[0]
            yield single
            yield (single + value) / 2


def numbersBeside(value):
    yield value
    if isinstance(value, int):
        yield from (value - 1, value + 1, -value)
        yield from (float(value), value + 0.5) if abs(value) < 2**1000 else ()
        yield from ulps(float(value)) if abs(value) > 2**52 else ()
    elif math.isfinite(value):
        yield from (-value, math.floor(value), math.ceil(value), *ulps(value))


def number(value):
    if isinstance(value, bool):
        return Value(value, "bool", ("true" if value else "false", str(value)), (value,))
    texts = [repr(value)]
    if isinstance(value, int):
        texts += [f"+{value}"] if value >= 0 else []
        if float(f"{value}.0") == value:
            texts.append(f"{value}.0")
    elif math.isfinite(value):
        texts += [f"{value:.17g}", f"{value:.20E}", f"+{value!r}" if value > 0 else f"{value!r}"]
        if 1e-30 < abs(value) < 1e30:
            texts.append(format(Decimal(value), "f"))
            texts.append(repr(value).replace("0.", ".", 1) if repr(value)[:2] == "0." else texts[0])
    elif value == value:
        sign = "-" if value < 0 else ""
        texts = [f"{sign}inf", f"{sign}Infinity", f"{sign}INF"]
    else:
        texts = ["nan", "NaN", "-nan"]
    texts = [text for text in texts if float(text) == value or value != value or "." not in text]
    # An integer keeps its digits, and a text with a point is a float.
    return Value(value, "number", tuple(texts), (value,))


def text(value):
    literal = "'" + value.replace("'", "''") + "'"
    return Value(value, "text", (literal,), (value,))


def time(ns):
    texts, params = [str(ns), _seconds(ns)], [ns]
    if 0 <= ns < 2**32 * SECOND:
        iso = f"{_iso(ns // SECOND)}.{ns % SECOND:09d}"
        texts += [f"'{iso}'", f"'{iso}Z'"]
        params += [genpy.Time(ns // SECOND, ns % SECOND), Decimal(_seconds(ns)), iso]
    return Value(ns, "time", tuple(texts), tuple(params))


def duration(ns):
    params = [ns, Decimal(_seconds(ns))]
    if abs(ns) < 2**31 * SECOND:
        params.append(genpy.Duration(ns // SECOND, ns % SECOND))
    return Value(ns, "duration", (str(ns), _seconds(ns)), tuple(params))


def _seconds(ns):
    whole, rest = divmod(abs(ns), SECOND)
    return f"{'-' if ns < 0 else ''}{whole}.{rest:09d}"


def _iso(seconds):
    import datetime

    moment = datetime.datetime(1970, 1, 1) + datetime.timedelta(seconds=seconds)
    return moment.strftime("%Y-%m-%dT%H:%M:%S")


def textsBeside(value):
    if not value:
        return
    yield from (value, value + "a", value[:-1], value.swapcase(), value[: len(value) // 2])
    yield from (value[1:], value + "\x00", value[:-1] + chr(min(ord(value[-1]) + 1, 0xD7FF)))


def patternsBeside(value, numbers):
    """Patterns for LIKE: parts of a text with % and _ in it."""
    cut = numbers.randrange(len(value) + 1)
    yield from (value[:cut] + "%", "%" + value[cut:], f"%{value[cut : cut + 3]}%")
    yield from (value[:cut] + "_" + value[cut + 1 :], value[:cut] + "_" + value[cut:])
    yield from (value[:cut] + "%_", "_" * min(len(value), 40), value[:2] + "%" + value[-2:])
    yield from (value, value.upper())


def fits(kind, value):
    """Say whether a stored value is of a kind."""
    return isinstance(value, str) if kind == "text" else isinstance(value, (int, float))


VALUES = {
    "number": (number, numbersBeside, INTS + FLOATS),
    "bool": (number, lambda value: [], [True, False, 0, 1, 2, -0.0, 0.5, math.nan]),
    "text": (text, textsBeside, TEXTS),
    "time": (time, lambda ns: [ns - 1, ns + 1, ns - SECOND, ns + SECOND // 10], TIMES),
    "duration": (duration, lambda ns: [ns - 1, ns + 1], [0, -1, 2**63, -(10**30)]),
}
"""By the kind of a field: makes a Value, what lies beside one, what lies at the edges."""


def _distinct(found):
    # Hypothesis writes down what it looks for among others, which here is very long.
    return tuple(dict.fromkeys(found))


def _op(function, arguments, kind="number"):
    return Op(function, arguments, kind)


def _of(function, path):
    return Op(function, (path,), "number")


def _length(ns, *texts):
    return Value(ns, "duration", texts)


# Written in one way: 1 and 1.0 are not the same in GROUP BY.
SMALL = [
    Value(value, "number", (repr(value),), (value,))
    for value in (0, 1, 2, -3, 0.5, -0.0, 1e300, math.nan, math.inf)
]
SECONDS = [
    _length(SECOND, "1s", "1000ms"),
    _length(90 * SECOND, "1m30s", "1.5m"),
    _length(7, "7ns"),
]
STRETCHES = st.sampled_from([Op("time", (KEY, length), "time") for length in SECONDS[:2]])
NUMBERS = {("number", False), ("bool", False)}


def pathsOf(types, name=None, steps=()):
    """Yield paths of every field: whole arrays, some of their elements, secs and nsecs."""
    for attribute, base, length in types.fields(name or types.name):
        indexes = [None]
        if length is not None:
            most = int(length or 1000)
            indexes += [n for n in (0, 1, 2, 6, 200) if n < most]
        for index in indexes:
            here = (*steps, (attribute, index))
            if "/" in base:
                yield from pathsOf(types, base, here)
                continue
            yield Path(here)
            if base in ("time", "duration") and (length is None or index is not None):
                yield from (Path(here, part) for part in ("secs", "nsecs"))


class Asker:
    """Makes random statements about messages.

    Args:
        types: The definitions of the topic.
        messages: What is stored, and only a part of it need be: where values come from.
        indexes: Fields that are asked for more often.
    """

    def __init__(self, types, messages, indexes):
        self._types, self._messages = types, messages
        self._numbers = random.Random(str(indexes))
        self._made = {}
        paths = {path: None for t in types for path in pathsOf(t)}
        self._chains = {}
        for path in paths:
            if all(i is None or i < 2 for _, i in path.steps) or self._numbers.random() < 0.3:
                chain = max((tuple(path.unnested(t)) for t in types), key=len)
                self._chains.setdefault(chain, []).append(path)
        self._indexed = {path for path in paths if path.text in indexes}

    def statements(self):
        """Strategy of statements with a condition."""
        # Strategies that are made anew for each statement take a quarter of the time.
        return st.sampled_from(sorted(self._chains, key=str)).flatmap(
            functools.lru_cache(maxsize=None)(self._inChain)
        )

    def _inChain(self, chain):
        """Statements that name fields inside these arrays of messages, and outside of all."""
        paths = [p for n in range(len(chain) + 1) for p in self._chains.get(chain[:n], ())]
        indexed = [path for path in paths if path in self._indexed]
        operands = st.one_of(
            *[st.sampled_from(paths)] * 2,
            *[st.sampled_from(indexed)] * 3 if indexed else (),
            st.sampled_from([KEY, KEY, NODE, RUN]),
        )
        terms = self._terms(paths)
        tree = self._trees(
            st.one_of(operands, operands, operands, terms), self._ofArrays(paths, terms)
        )
        plain = st.builds(
            Statement,
            st.lists(st.sampled_from(paths), max_size=2).map(
                lambda found: (KEY, NODE, *found, RUN)
            ),
            tree,
            st.booleans(),
            st.none() | st.none() | st.sampled_from([1, 2, 7, 1000]),
        )
        totals = st.builds(
            Statement,
            st.lists(self._totals(paths), min_size=1, max_size=3).map(tuple),
            tree,
        )
        return st.one_of(plain, plain, plain, totals, self._gathered(paths, terms, tree))

    def _gathered(self, paths, terms, tree):
        """Statements whose rows are made of several, or come in another order."""
        single = [p for p in paths if len(self._kinds(p)) == 1 and not self._isArray(p)]
        by = st.one_of(st.sampled_from([*single, NODE, RUN]), terms, STRETCHES)
        limit = st.none() | st.sampled_from([1, 3, 1000])
        shown = st.lists(by, min_size=1, max_size=2).map(_distinct)

        def grouped(columns, totals, down, least, condition):
            made = (*columns, *totals)
            order = ((made[-1], down),) if least is not None else ()
            return Statement(made, condition, False, least, False, columns, order)

        def ordered(columns, order, distinct, descending, least, condition):
            if distinct:
                order = [(columns[n % len(columns)], down) for n, (_, down) in enumerate(order)]
            order = () if distinct and descending else tuple(order)
            # Without anything else ORDER BY KEY is what it is.
            return Statement(
                columns, condition, descending and not order, least, distinct, (), order
            )

        totals = st.lists(self._totals(paths), min_size=1, max_size=2).map(_distinct)
        orders = st.lists(st.tuples(by, st.booleans()), min_size=1, max_size=2)
        two = (st.booleans(), st.booleans())
        return st.one_of(
            st.builds(grouped, shown, totals, st.booleans(), limit, tree),
            st.builds(ordered, shown, orders, *two, limit, tree),
        )

    def _terms(self, paths, of_numbers=False):
        """Strategy of what is computed of some fields, and of KEY; of times, too, or not."""
        numbers = [p for p in paths if self._kinds(p) <= NUMBERS and self._kinds(p)]
        arrays = [p for p in paths if self._isNumbers(p)]
        loose = [p for p in paths if self._isLoose(p)]
        times = [KEY, *(p for p in paths if self._kinds(p) == {("time", False)})]
        lengths = [p for p in paths if self._kinds(p) == {("duration", False)}]
        texts = [p for p in paths if self._kinds(p) == {("text", False)}]
        between = [_op("-", (a, b), "duration") for a in times for b in times]
        number = [st.sampled_from(between).map(lambda length: _op("/", (length, SECONDS[0])))]
        number += [st.sampled_from(numbers)] * 3 if numbers else []
        if arrays:
            functions = st.sampled_from(("len", "min", "max", "sum", "avg"))
            number += [st.builds(_of, functions, st.sampled_from(arrays))] * 2
        if loose:
            functions = st.sampled_from(("len", "sum", "avg"))
            number += [st.builds(_of, functions, st.sampled_from(loose))]
        number += [st.sampled_from(texts).map(lambda path: _of("len", path))] if texts else []
        base = st.one_of(number)
        some = st.one_of(base, st.sampled_from(SMALL))
        made = st.one_of(
            st.builds(lambda f, x, y: _op(f, (x, y)), st.sampled_from("+-*/"), base, some),
            st.builds(lambda f, x: _op(f, (x,)), st.sampled_from(("neg", "abs", "sqrt")), base),
        )
        deeper = st.builds(lambda f, x, y: _op(f, (x, y)), st.sampled_from("+-*/"), some, made)
        scaled = st.builds(
            lambda f, x, y: _op(f, (x, y), "duration"),
            *(st.sampled_from("*/"), st.sampled_from(lengths + between), st.sampled_from(SMALL)),
        )
        shifted = st.builds(
            lambda f, x, y: _op(f, (x, y), "time"),
            *(st.sampled_from("+-"), st.sampled_from(times), st.sampled_from(SECONDS + lengths)),
        )
        return st.one_of(made, made, deeper, *(() if of_numbers else (scaled, shifted)))

    def _isNumbers(self, path):
        return bool(self._kinds(path)) and self._kinds(path) <= {("number", True)}

    def _isLoose(self, path):
        """Whether it is an array of numbers in one definition, and of texts in another."""
        kinds = self._kinds(path)
        return ("number", True) in kinds and len(kinds) > 1 and all(array for _, array in kinds)

    def _ofArrays(self, paths, terms):
        """Strategy of conditions with ANY and ALL, and on operands beside one another."""
        beside = [KEY, *(p for p in paths if len(self._kinds(p)) == 1 and not self._isArray(p))]
        of = lambda operand: next(iter(self._kinds(operand)))[0]  # noqa: E731
        like = {}
        for operand in beside:
            like.setdefault({"bool": "number"}.get(of(operand), of(operand)), []).append(operand)
        pairs = [
            st.builds(Related, some, st.sampled_from(ORDERED), some)
            for some in map(st.sampled_from, like.values())
        ]
        if "number" in like:
            number = self._terms(paths, of_numbers=True)
            field = st.sampled_from(like["number"])
            pairs += [st.builds(Related, number, st.sampled_from(ORDERED), field)] * 2
        arrays = [p for p in paths if ("number", True) in self._kinds(p)]
        # First those that some definition lacks, or has of another type.
        arrays.sort(key=lambda p: all(p.kind(types) == ("number", True) for types in self._types))
        fields = like.get("number", [])
        # Fields that make each element of an array of messages a row, whatever they stand beside.
        deep = [p for p in fields if p != KEY and any(p.unnested(t) for t in self._types)]
        for path in arrays[:4]:
            value = self._valuesOf(path)
            # Beside texts a number is refused where no definition has numbers in both.
            beside = () if self._isLoose(path) else (fields, deep)
            wanted = st.one_of(value, value, *(st.sampled_from(some) for some in beside if some))
            fixed = (st.just(path), st.booleans())
            pairs += [
                st.builds(AnyAll, *fixed, st.sampled_from(ORDERED), st.tuples(wanted)),
                st.builds(AnyAll, *fixed, st.sampled_from(ORDERED), st.tuples(wanted)),
                st.builds(
                    *(AnyAll, *fixed, st.just("BETWEEN"), st.tuples(wanted, wanted), st.booleans())
                ),
                st.builds(*(AnyAll, *fixed, st.just("IN"), st.tuples(value, value), st.booleans())),
            ]
        return st.one_of(pairs)

    def _trees(self, operands, others):
        single = operands.flatmap(self._leaves)
        leaf = st.one_of(single, single, single, others)
        joined = lambda inner: st.one_of(  # noqa: E731
            st.builds(Not, inner),
            st.builds(Joined, st.just("AND"), st.tuples(leaf, inner)),
            st.builds(Joined, st.just("AND"), st.tuples(inner, inner, leaf)),
            st.builds(Joined, st.just("OR"), st.tuples(inner, leaf)),
        )
        return leaf | joined(leaf) | st.recursive(leaf, joined, max_leaves=6)

    def _totals(self, paths):
        numbers = [p for p in paths if self._kinds(p) <= {("number", False), ("bool", False)}]
        single = [p for p in paths if len(self._kinds(p)) == 1 and not self._isArray(p)]
        made = [
            st.just(("count", None)),
            self._pairs(("min", "max", "count"), [*single, KEY, NODE, RUN]),
        ]
        if numbers:
            made.append(self._pairs(("sum", "avg", "min", "max"), numbers))
        return st.one_of(made)

    @staticmethod
    def _pairs(functions, operands):
        return st.tuples(st.sampled_from(functions), st.sampled_from(operands))

    def _leaves(self, operand):
        if operand not in self._made:
            self._made[operand] = self._makeLeaves(operand)
        return self._made[operand]

    def _makeLeaves(self, operand):
        values = self._valuesOf(operand)
        kinds = self._kinds(operand)
        array = self._isArray(operand)
        null = st.builds(Leaf, st.just(operand), st.just("NULL"), st.just(()), st.booleans())
        if array:
            held = st.builds(
                *(Leaf, st.just(operand), st.just("CONTAINS"), st.tuples(values), st.booleans())
            )
            return st.one_of(held, held, held, null)
        made = [
            *[st.builds(Leaf, st.just(operand), st.sampled_from(ORDERED), st.tuples(values))] * 5,
            st.builds(
                *(Leaf, st.just(operand), st.just("BETWEEN")),
                st.tuples(values, values),
                st.booleans(),
            ),
            null,
        ]
        if len(kinds) == 1:
            # Where a definition has a number and another a text, only = says what is meant.
            made.append(
                st.builds(
                    *(Leaf, st.just(operand), st.just("IN")),
                    st.lists(values, min_size=1, max_size=4).map(tuple),
                    st.booleans(),
                )
            )
        if "text" in {kind for kind, _ in kinds}:
            patterns = st.sampled_from(self._patternsOf(operand))
            made += [
                st.builds(
                    *(Leaf, st.just(operand), st.just("LIKE"), st.tuples(patterns), st.booleans())
                )
            ] * 2
        return st.one_of(made)

    def _kinds(self, operand):
        if isinstance(operand, Op):
            return {(operand.kind, False)}
        if operand in (KEY, NODE, RUN):
            return {("time" if operand == KEY else "text", False)}
        return {kind for kind in map(operand.kind, self._types) if kind}

    def _isArray(self, operand):
        return any(array for _, array in self._kinds(operand))

    def _valuesOf(self, operand):
        """Strategy of values: half of them stored ones, and as many beside them as at the edges."""
        stored = self._stored(operand)
        found = []
        for kind in sorted({kind for kind, _ in self._kinds(operand)}):
            make, beside, edges = VALUES[kind]
            fitting = [value for value in stored if fits(kind, value)]
            near = [other for value in fitting for other in beside(value)]
            found += [st.sampled_from([make(v) for v in near + edges])]
            found += [st.sampled_from([make(v) for v in edges])]
            found += [st.sampled_from([make(v) for v in fitting or edges])] * 2
        return st.one_of(found)

    def _stored(self, operand):
        rows = [row for message in self._messages for row in rows_of(message, [operand])]
        found = [value for value in (row.value(operand) for row in rows) if value is not MISSING]
        if self._isArray(operand):
            arrays = [array for array in found if isinstance(array, (list, bytes))]
            found = [element for array in arrays for element in array[:50]]
        # Only the beginning of very long texts: the length of a statement is limited, too.
        found = [v[:100] if isinstance(v, str) and len(v) > 100_000 else v for v in found]
        distinct = list({str(canonical(value)): value for value in found}.values())
        return self._numbers.sample(distinct, min(MAX_STORED, len(distinct)))

    def _patternsOf(self, operand):
        stored = [v for v in self._stored(operand) if isinstance(v, str)]
        found = [p for value in stored for p in patternsBeside(value, self._numbers)]
        return [text(pattern) for pattern in [*found, "", "%", "%%", "_", "%a%b%", "\n%"]]
