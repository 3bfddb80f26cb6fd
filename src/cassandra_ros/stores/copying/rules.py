# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The rules of a copy: which messages of which topics, how, and in which order."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Callable, Mapping, Sequence

from cassandra_ros.arguments import check_event_name, check_pattern, check_text
from cassandra_ros.errors import CassandraRosError, InvalidOption
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.store.tables.registry import Run
from cassandra_ros.yaml_text import check_keys, yaml_content

_UNITS = {"": 1, "k": 1 << 10, "M": 1 << 20, "G": 1 << 30}
"""Unit of a bandwidth -> bytes a second."""
_SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0}
"""Unit of a length of time -> seconds."""


@dataclass(frozen=True)
class CopyRule:
    """How the topics are copied whose whole name matches a pattern.

    What a rule leaves out counts neither as copied nor as waiting.
    """

    pattern: str = ".*"
    """Regular expression."""
    skip: bool = False
    """Whether these topics are not copied."""
    order: int = 0
    """Topics with a smaller number go first; of equal ones those with smaller messages."""
    format: str | None = None
    """Format there of topics that are new there; None = as they are stored here."""
    run: str = ""
    """Regular expression that the name of a run must match; '' = all messages."""
    label: str = ""
    """KEY=VALUE that a run must have; '' = all messages."""
    where: str = ""
    """Condition that a message must satisfy; '' = all."""
    event: str = ""
    """Name of events: only messages of a robot during them are copied; '' = of all time."""
    before_ns: int = 0
    after_ns: int = 0
    """Time before and after each event of which messages are copied, too, ns."""
    every_ns: int = 0
    """Length of a period of which one message of each connection is copied, ns; 0 = all."""
    rate: float | None = None
    """Maximum number of bytes a second that are sent; None = no limit."""

    @property
    def selects_runs(self) -> bool:
        """Whether only messages of some runs are copied."""
        return bool(self.run or self.label)

    @property
    def thins(self) -> bool:
        """Whether some messages of the selected runs are left out, so that each is looked at."""
        return bool(self.where or self.every_ns or self.event)

    @property
    def thinning(self) -> str:
        """What the books call the way in which messages are left out; '' = none are.

        The text is in the books: with another one the messages count as not copied.
        """
        if not self.thins:
            return ""
        text = f"every {self.every_ns} ns, where {self.where}"
        reach = f"{self.before_ns} ns before, {self.after_ns} ns after"
        return f"{text}, event {self.event}, {reach}" if self.event else text

    def takes(self, run: Run) -> bool:
        """Return whether the messages of a run are copied."""
        key, _, value = self.label.partition("=")
        labelled = not self.label or run.labels.get(key) == value
        return labelled and (not self.run or re.fullmatch(self.run, run.name) is not None)


@dataclass(frozen=True)
class CopyRules:
    """The rules of a file; a topic that none of them matches is not copied."""

    rules: Sequence[CopyRule]
    rate: float | None = None
    """Maximum number of bytes a second that are sent of all topics together; None = no limit."""

    def of(self, topic: str) -> CopyRule | None:
        """Return the first rule that matches a topic; None = the topic is not copied."""
        rule = next((rule for rule in self.rules if re.fullmatch(rule.pattern, topic)), None)
        return None if rule is None or rule.skip else rule

    def unused(self, topics: Sequence[str]) -> list[str]:
        """Return the patterns that are the first match of none of the topics."""
        used = set()
        for topic in topics:
            matching = (n for n, r in enumerate(self.rules) if re.fullmatch(r.pattern, topic))
            used.add(next(matching, -1))
        return [rule.pattern for n, rule in enumerate(self.rules) if n not in used]


def read_rules(text: str, source: str = "rules") -> CopyRules:
    """Read the rules of a YAML text; config/replicator.yaml is an example.

    Raises:
        InvalidOption: The text cannot be read; the error has ``source``, entry and remedy.
    """
    with yaml_content(text, source) as content:
        if not isinstance(content, dict) or not {"topics"} <= set(content) <= {"topics", "rate"}:
            raise InvalidOption("it must be a mapping with topics, a list, and perhaps rate")
        entries = content["topics"]
        if not isinstance(entries, list) or not entries:
            raise InvalidOption("topics must be a list of mappings, each with a pattern")
        rules = [_rule(number, entry) for number, entry in enumerate(entries, 1)]
        rate = content.get("rate")
        return CopyRules(rules, None if rate is None else read_bandwidth(rate))


def read_rules_file(name: str | None) -> CopyRules | None:
    """Read a file of rules; None or an empty name, which a launch file may pass = no rules.

    Raises:
        InvalidOption: The file cannot be read, or as in read_rules.
    """
    if not name:
        return None
    try:
        return read_rules(Path(name).read_text(encoding="utf-8"), name)
    except (OSError, UnicodeDecodeError) as exc:
        raise InvalidOption(f"the rules {name!r} cannot be read: {exc}") from exc


def _rule(number: int, entry: object) -> CopyRule:
    """Return the rule in an entry of the YAML text; raises InvalidOption with its number."""
    if not isinstance(entry, dict) or "pattern" not in entry:
        raise InvalidOption(
            f"entry {number} of topics is not a mapping with a pattern: {entry!r:.80}"
        )
    check_keys(number, entry, _READERS)
    try:
        values = {_NAMES.get(name, name): _READERS[name](value) for name, value in entry.items()}
        rule = CopyRule(**values)  # type: ignore[arg-type]
        if (rule.before_ns or rule.after_ns) and not rule.event:
            raise InvalidOption("before and after need an event")
        return rule
    except CassandraRosError as exc:
        raise InvalidOption(f"entry {number}, pattern {entry['pattern']!r:.80}: {exc}") from exc


def read_bandwidth(value: object) -> float:
    """Read a number of bytes a second: 500k, 2M, 2MB/s or bytes."""
    match = re.fullmatch(r"([0-9]{1,12}(?:\.[0-9]*)?)([kMG]?)(?:B)?(?:/s)?", str(value))
    if isinstance(value, bool) or match is None or not float(match[1]):
        raise InvalidOption(
            f"{str(value)!r:.80} is not a bandwidth: give one like 500k, 2M or 2MB/s"
        )
    return float(match[1]) * _UNITS[match[2]]


def _read_bool(value: object) -> bool:
    if not isinstance(value, bool):
        raise InvalidOption(f"{value!r:.80} is neither true nor false")
    return value


def _read_order(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or abs(value) > 10**6:
        raise InvalidOption(f"order {value!r:.80} is not a whole number, like 1")
    return value


def _read_format(value: object) -> str:
    """Read the name of a storage format; raises UnknownFormat if there is no such format."""
    text = check_text("format", value)
    format_class(text)  # only for its error
    return text


def _read_label(value: object) -> str:
    text = check_text("label", value)
    key, equals, _ = text.partition("=")
    if not (key and equals):
        raise InvalidOption(f"{text!r:.80} is not a label: give KEY=VALUE, as site=lab")
    return text


def _read_where(value: object) -> str:
    return check_text("where", value, wanted="a condition, as 'linear.x > 0.5'")


def _read_length(value: object) -> int:
    """Read a length of time, ns."""
    match = re.fullmatch(r"([0-9]{1,9}(?:\.[0-9]*)?|\.[0-9]+)([smh])", str(value))
    if match is None:
        raise InvalidOption(f"{str(value)!r:.80} is not a length of time, like 1s, 0.5s or 5m")
    return round(float(match[1]) * _SECONDS[match[2]] * SECOND_NS)


def _read_every(value: object) -> int:
    """Read a period above 0, ns."""
    length = _read_length(value)
    if not length:
        raise InvalidOption(f"every {value} is not a period: give a longer one, like 1s")
    return length


_READERS: Mapping[str, Callable[[object], object]] = {
    "pattern": check_pattern,
    "skip": _read_bool,
    "order": _read_order,
    "format": _read_format,
    "run": check_pattern,
    "label": _read_label,
    "where": _read_where,
    "event": check_event_name,
    "before": _read_length,
    "after": _read_length,
    "every": _read_every,
    "rate": read_bandwidth,
}
"""Functions that read the values of CopyRule from YAML, by their names there."""
_NAMES = {"every": "every_ns", "before": "before_ns", "after": "after_ns"}
"""Fields of CopyRule with another name than in YAML."""
assert {_NAMES.get(n, n) for n in _READERS} == {f.name for f in fields(CopyRule)}  # noqa: S101
