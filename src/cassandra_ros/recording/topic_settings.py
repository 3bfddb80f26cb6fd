# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""How each topic is recorded: patterns of topic names, and what holds for those that match."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, field, fields, replace
from typing import Any, Callable, Mapping, Optional, Sequence, Tuple

import yaml

from cassandra_ros.arguments import check_fields, check_labels, check_text, check_ttl
from cassandra_ros.errors import CassandraRosError, InvalidOption, InvalidQuery
from cassandra_ros.formats.table import format_class
from cassandra_ros.query.tree.binding import terms_of_condition
from cassandra_ros.query.tree.parse import parse_condition
from cassandra_ros.query.tree.syntax import Literal, Near, TimeNs, inside, leaves

_UNITS = {"": 1, "s": 1, "m": 60, "h": 3600, "d": 86400}
MAX_RATE_HZ = 1e6
MAX_CONFIG_BYTES = 1 << 20


@dataclass(frozen=True)
class TopicSettings:
    """How one topic is recorded."""

    format: Optional[str] = None
    """As addTopic takes it; None = as it is stored, a new one as ros."""
    ttl: int = 0
    """Seconds until a message expires; 0 = never. Counts where the topic's table is made."""
    rate_limit: float = 0.0
    """Most messages a second, over all publishers together; 0 = all."""
    where: str = ""
    """Only messages that satisfy this condition, as after WHERE in CQL; '' = all."""
    key_part: str = ""
    """The field that is the key (key_format msg_part); '' = the time of reception."""
    index: Tuple[str, ...] = ()
    """Fields that get an index where the topic's table is made."""


Rule = Tuple[str, Mapping[str, Any]]
"""A regular expression for whole topic names, and some of TopicSettings' values by name."""


@dataclass(frozen=True)
class Settings:
    """The settings of all topics.

    What the rules do not say is as in ``default``. Of each list of rules the first that matches a
    topic holds for it, and no other one; a later list has precedence over an earlier one.
    """

    default: TopicSettings = field(default_factory=TopicSettings)
    rules: Sequence[Sequence[Rule]] = ()

    def of(self, topic: str) -> TopicSettings:
        """Return what holds for a topic."""
        found = self.default
        for rules in self.rules:
            first = (values for pattern, values in rules if re.fullmatch(pattern, topic))
            found = replace(found, **next(first, {}))
        return found


def read_settings(text: str, source: str = "settings") -> list[Rule]:
    """Read the rules of a YAML text; config/recorder.yaml shows how it looks.

    Raises:
        InvalidOption: It is something else; the text names ``source``, the entry and the remedy.
    """
    try:
        if len(text) > MAX_CONFIG_BYTES:
            raise InvalidOption(f"it is longer than {MAX_CONFIG_BYTES} characters")
        found = yaml.safe_load(text)
        if found is None:
            return []
        if not isinstance(found, dict) or set(found) != {"topics"}:
            raise InvalidOption("it must be a mapping with one key, topics, a list")
        entries = found["topics"] or []
        if not isinstance(entries, list):
            raise InvalidOption("topics must be a list of mappings, each with a pattern")
        return [_rule(number, entry) for number, entry in enumerate(entries, 1)]
    except (yaml.YAMLError, CassandraRosError, RecursionError) as exc:
        raise InvalidOption(f"{source} cannot be used: {exc}") from exc


def _rule(number: int, entry: object) -> Rule:
    known = {"pattern", *_READERS}
    if not isinstance(entry, dict) or "pattern" not in entry:
        raise InvalidOption(f"entry {number} of topics is no mapping with a pattern: {entry!r:.80}")
    for name in entry:
        if name not in known:
            near = difflib.get_close_matches(str(name), known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(sorted(known))}"
            raise InvalidOption(f"entry {number} has an unknown key {name!r:.80}; {hint}")
    try:
        values = {name: _READERS[name](entry[name]) for name in entry if name != "pattern"}
        return check_pattern(entry["pattern"]), values
    except CassandraRosError as exc:
        raise InvalidOption(f"entry {number}, pattern {entry['pattern']!r:.80}: {exc}") from exc


def check_pattern(pattern: object) -> str:
    """Return a regular expression of topic names, or raise InvalidOption."""
    text = check_text("pattern", pattern, wanted="a regular expression, as /camera/.*")
    try:
        re.compile(text)
    except (re.error, OverflowError, RecursionError) as exc:
        raise InvalidOption(f"{text!r:.80} is not a regular expression: {exc}") from exc
    return text


def read_duration(value: object) -> float:
    """Return seconds, more than 0: a number, or one with s, m, h or d behind it."""
    text = str(value) if isinstance(value, (int, float, str)) else ""
    match = re.fullmatch(r"([0-9]{1,15}(?:\.[0-9]*)?|\.[0-9]+)([smhd]?)", text)
    if match is None or not float(match[1]):
        raise InvalidOption(f"{str(value)!r:.80} is not a duration, like 30, 5m or 2h")
    return float(match[1]) * _UNITS[match[2]]


def read_rate(value: object) -> float:
    """Return a number of messages a second, more than 0 and at most a million."""
    try:
        rate = float(value) if isinstance(value, (int, float, str)) else 0.0
    except ValueError:
        rate = 0.0
    if isinstance(value, bool) or not 0 < rate <= MAX_RATE_HZ:
        raise InvalidOption(f"{str(value)!r:.80} is no rate: give messages a second, like 5 or 0.1")
    return rate


def read_label(text: str) -> Tuple[str, str]:
    """Read KEY=VALUE; raises InvalidOption."""
    key, equals, value = text.partition("=")
    if not (key.strip() and equals):
        raise InvalidOption(f"{text!r:.80} is no label: give KEY=VALUE, as site=lab")
    ((key, value),) = check_labels({key.strip(): value.strip()}).items()
    return key, value


def check_condition(value: object) -> str:
    """Return a condition that can be parsed; its fields are known with the first message."""
    text = check_text("where", value, wanted="a condition, as 'linear.x > 0.5'")
    parsed = parse_condition(text)
    for leaf in leaves(parsed):
        if isinstance(leaf, Near):
            reason = (
                "NEAR asks where a robot was, which is known of stored messages: ask it of those"
            )
            raise InvalidQuery(text, leaf.position, reason)
    for term in terms_of_condition(parsed):
        for part in inside(term):
            if isinstance(part, Literal) and isinstance(part.value, TimeNs):
                reason = (
                    "now() would remain the moment in which the recorder read this; KEY is the "
                )
                reason += "time at which a message came, as in header.stamp > KEY - 1s"
                raise InvalidQuery(text, part.position, reason)
    return text


def _read_format(value: object) -> Optional[str]:
    if value is None:
        return None
    text = check_text("format", value)
    format_class(text)
    return text


def read_ttl(value: object) -> int:
    """Return whole seconds, 0 = never: a number, or one with s, m, h or d behind it."""
    if value == "0":
        return 0
    return check_ttl(int(read_duration(value)) if isinstance(value, str) else value)


def _read_key_part(value: object) -> str:
    return check_text("key_part", value, wanted="a field like 'header.stamp'")


_READERS: Mapping[str, Callable[[object], object]] = {
    "format": _read_format,
    "ttl": read_ttl,
    "rate_limit": read_rate,
    "where": check_condition,
    "key_part": _read_key_part,
    "index": lambda value: check_fields("index", value),
}
"""How the values of TopicSettings are read from YAML."""
assert set(_READERS) == {each.name for each in fields(TopicSettings)}  # noqa: S101
