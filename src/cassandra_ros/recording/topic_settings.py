# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The settings of recorded topics: patterns of topic names with the settings of matching topics."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Callable, Mapping, Sequence

from cassandra_ros.arguments import (
    check_event_name,
    check_fields,
    check_labels,
    check_pattern,
    check_ros_name,
    check_text,
)
from cassandra_ros.errors import CassandraRosError, InvalidOption, InvalidQuery
from cassandra_ros.messages.formats.table import format_class
from cassandra_ros.messages.stamps import seconds_to_ns
from cassandra_ros.query.tree.parse import parse_condition, terms_of_condition
from cassandra_ros.query.tree.syntax import TIMED, InEvent, Literal, TimeNs, inside, leaves
from cassandra_ros.recording.event_marks import WatchedEvent
from cassandra_ros.recording.option_values import (
    Rule,
    SettingsFile,
    read_duration,
    read_rate,
    read_ttl,
)
from cassandra_ros.recording.recorder_options import RecorderOptions
from cassandra_ros.yaml_text import check_keys, yaml_content


@dataclass(frozen=True)
class TopicSettings:
    """The settings of one topic."""

    format: str | None = None
    """Format, as addTopic takes it; None = that of the stored topic, for a new topic ros."""
    ttl: int = 0
    """Time until a message expires, s; 0 = never. It is used when the topic's table is made."""
    rate_limit: float = 0.0
    """Maximum rate over all publishers together, Hz; 0 = no maximum."""
    where: str = ""
    """Condition that recorded messages must satisfy, as after WHERE in CQL; '' = none."""
    key_part: str = ""
    """Field that is the key (key_format msg_part); '' = the time of reception is the key."""
    index: tuple[str, ...] = ()
    """Fields that get an index when the topic's table is made."""


@dataclass(frozen=True)
class RecordingSettings:
    """The settings of all topics.

    In each list of rules only the first rule that matches a topic is used; a later list has
    precedence over an earlier one. Values that no rule has are those of ``default``.
    """

    default: TopicSettings = field(default_factory=TopicSettings)
    rules: Sequence[Sequence[Rule]] = ()
    events: Sequence[WatchedEvent] = ()
    """Events that last while a condition holds."""

    def of(self, topic: str) -> TopicSettings:
        """Return the settings of a topic."""
        settings = self.default
        for rules in self.rules:
            matching = (values for pattern, values in rules if re.fullmatch(pattern, topic))
            settings = replace(settings, **next(matching, {}))
        return settings


def recording_settings(options: RecorderOptions) -> RecordingSettings:
    """Return the settings of all topics that the options of a recorder give."""
    conditions: Sequence[Rule] = [(p, {"where": text}) for p, text in options.where]
    rates: Sequence[Rule] = [(p, {"rate_limit": rate}) for p, rate in options.rate_limit]
    default = TopicSettings(format=options.format, ttl=options.ttl)
    config = options.config
    return RecordingSettings(default, [config.rules, conditions, rates], config.events)


def settings_as_json(settings: RecordingSettings) -> Mapping[str, Any]:
    """Return settings as values of JSON, of which settings_from_json makes them again.

    Events are left out: they are for messages as they are received, and the values are for a drain.
    """
    rules = [
        [[pattern, dict(values)] for pattern, values in topic_rules]
        for topic_rules in settings.rules
    ]
    return {"default": asdict(settings.default), "rules": rules}


def settings_from_json(values: Mapping[str, Any]) -> RecordingSettings:
    """Return the settings that settings_as_json returned as JSON, or raise InvalidOption.

    Unknown names of settings are ignored: another release may have written them.
    """
    try:
        rules = [
            [(pattern, _setting_values(rule)) for pattern, rule in topic_rules]
            for topic_rules in values["rules"]
        ]
        return RecordingSettings(TopicSettings(**_setting_values(values["default"])), rules)
    except (KeyError, TypeError, ValueError, AttributeError) as exc:
        raise InvalidOption(f"the settings {str(values)!r:.200} cannot be used: {exc!r}") from exc


def _setting_values(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the values of one TopicSettings; JSON has lists for tuples."""
    names = {member.name for member in fields(TopicSettings)}.intersection(values)
    return {n: tuple(values[n]) if isinstance(values[n], list) else values[n] for n in names}


def read_settings(text: str, source: str = "settings") -> SettingsFile:
    """Read a YAML text with rules for topics, and with events; see config/recorder.yaml.

    Raises:
        InvalidOption: The text cannot be read; the error has ``source``, entry and remedy.
    """
    with yaml_content(text, source) as content:
        content = {} if content is None else content
        if not isinstance(content, dict) or not set(content) <= {"topics", "events"}:
            raise InvalidOption("it must be a mapping with the keys topics and events, each a list")
        topics = _entries(content, "topics", "each with a pattern")
        events = _entries(content, "events", "each with name, topic and where")
        return SettingsFile(
            [_rule(number, entry) for number, entry in enumerate(topics, 1)],
            [_event(number, entry) for number, entry in enumerate(events, 1)],
        )


def _entries(content: Mapping[str, object], key: str, form: str) -> list[object]:
    """Return the list under a key of a settings file."""
    entries = content.get(key) or []
    if not isinstance(entries, list):
        raise InvalidOption(f"{key} must be a list of mappings, {form}")
    return entries


def _event(number: int, entry: object) -> WatchedEvent:
    """Read the entry with this number, from 1, of the events; raises InvalidOption."""
    if not isinstance(entry, dict) or not {"name", "topic", "where"} <= set(entry):
        reason = f"entry {number} of events is not a mapping with name, topic and where"
        raise InvalidOption(f"{reason}: {entry!r:.80}")
    check_keys(number, entry, ("hold", "labels", "name", "topic", "where"))
    try:
        hold = entry.get("hold", 0)
        return WatchedEvent(
            check_event_name(entry["name"]),
            check_ros_name(check_text("topic", entry["topic"], wanted="a topic, as /imu"), "topic"),
            check_condition(entry["where"]),
            0 if hold == 0 else seconds_to_ns(read_duration(hold)),
            check_labels(entry.get("labels") or {}),
        )
    except CassandraRosError as exc:
        raise InvalidOption(f"entry {number}, event {entry['name']!r:.80}: {exc}") from exc


def _rule(number: int, entry: object) -> Rule:
    """Read the entry with this number, from 1, of the topics; raises InvalidOption."""
    if not isinstance(entry, dict) or "pattern" not in entry:
        raise InvalidOption(
            f"entry {number} of topics is not a mapping with a pattern: {entry!r:.80}"
        )
    check_keys(number, entry, sorted(["pattern", *_READERS]))
    try:
        values = {name: _READERS[name](entry[name]) for name in entry if name != "pattern"}
        return check_pattern(entry["pattern"]), values
    except CassandraRosError as exc:
        raise InvalidOption(f"entry {number}, pattern {entry['pattern']!r:.80}: {exc}") from exc


def check_condition(value: object) -> str:
    """Return a condition that can be parsed; its fields are checked with the first message.

    Raises:
        InvalidOption: It is not a text.
        InvalidQuery: It cannot be parsed, or asks for what a message alone does not tell: EVENT,
            NEAR, now().
    """
    text = check_text("where", value, wanted="a condition, as 'linear.x > 0.5'")
    parsed = parse_condition(text)
    for leaf in leaves(parsed):
        if isinstance(leaf, TIMED):
            what = "EVENT asks for events" if isinstance(leaf, InEvent) else "NEAR asks for places"
            reason = f"{what} of a robot, which are known for stored messages only: query those"
            raise InvalidQuery(text, leaf.position, reason)
    for term in terms_of_condition(parsed):
        for operand in inside(term):
            if isinstance(operand, Literal) and isinstance(operand.value, TimeNs):
                reason = (
                    "now() would stay the time at which the recorder read this condition; KEY is "
                    "the time of reception of each message, as in header.stamp > KEY - 1s"
                )
                raise InvalidQuery(text, operand.position, reason)
    return text


def _read_format(value: object) -> str | None:
    if value is None:
        return None
    text = check_text("format", value)
    format_class(text)
    return text


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
"""Functions that read the values of TopicSettings from YAML, by name."""
assert set(_READERS) == {member.name for member in fields(TopicSettings)}  # noqa: S101
