# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Checks of the arguments of public methods, one function for each kind of argument.

A check returns the argument in its internal form, or raises an error that names the argument, its
value, and what to give instead. The methods check all arguments before they use the store.
"""

from __future__ import annotations

import json
import math
import re
from contextlib import suppress
from decimal import Decimal, InvalidOperation
from numbers import Integral
from typing import AbstractSet, Any, Container, Iterable, Mapping, TypeVar

from cassandra_ros.errors import (
    CassandraRosError,
    InvalidKey,
    InvalidName,
    InvalidOption,
    TopicNotFound,
)
from cassandra_ros.keys import KEY_FORMATS, MAX_WRITER
from cassandra_ros.metadata import FACTS

_Value = TypeVar("_Value")

MAX_NAME_BYTES = 256
"""Maximum length of a new name of a topic, a robot, a run or a label, and of a label's text, UTF-8
bytes. Longer names can be read and deleted, because another client may have written them."""
MAX_MESSAGE_NAME_BYTES = 4096
"""Maximum length of the name of a message, UTF-8 bytes."""
MAX_NODE_BYTES = 61_411
"""Maximum length of a nodeID in a query, UTF-8 bytes. A longer one does not fit into a partition
key of 65,535 bytes together with a name, a time and a counter."""
MAX_ARGUMENT_BYTES = 1 << 20
"""Maximum length of any text, UTF-8 bytes. Each client reads the metadata of all topics, so these
must not hold whole files."""
MAX_VALUES_BYTES = 1 << 16
"""Maximum length of the values of an event as JSON, UTF-8 bytes. Many events are read together."""
MAX_LIMIT = 2**63 - 1
"""Maximum value of a limit for the number of messages or rows."""
MAX_TTL_SEC = 18 * 365 * 86400
"""Maximum time to live, s. Chunks and directory live longer than the rows, but must also stay below
Cassandra's maximum of 20 years."""


def _shorten(value: Any) -> str:
    """Return a value as at most 80 characters of an error text. Any value will do."""
    try:
        return f"{value!r:.80}"
    except ValueError:  # an integer of thousands of digits
        return f"of type {type(value).__name__}"


def plain_value(value: Any) -> Any:
    """Return a value with its scalars of numpy as Python's own, also in lists, tuples and dicts.

    datetime64 and timedelta64 stay, because Python's types have no nanoseconds. Arrays, named
    tuples and subclasses of dict stay, too.
    """
    if isinstance(value, (list, tuple)) and not hasattr(value, "_fields"):
        return type(value)(map(plain_value, value))
    if type(value) is dict:
        return {name: plain_value(inner) for name, inner in value.items()}
    # By their names: importing numpy would slow down every program.
    if type(value).__module__ != "numpy" or getattr(value, "shape", None) != ():
        return value
    return value.item() if value.dtype.kind in "biufSU" else value


def check_text(
    name: str,
    value: Any,
    most: int = MAX_ARGUMENT_BYTES,
    error: type[CassandraRosError] = InvalidOption,
    wanted: str = "a text",
) -> str:
    """Return a plain str that can be stored: valid Unicode of at most ``most`` bytes of UTF-8.

    Args:
        name: Name of the argument, for the error text.
        value: The value that the caller gave.
        most: Maximum length, UTF-8 bytes.
        error: Class of the error that is raised.
        wanted: What to give instead, for the error text.
    """
    try:
        if not isinstance(value, str):
            reason = f"it is of type {type(value).__name__}"
        elif len(value.encode("utf-8")) <= most:
            return str(value)  # of a subclass as well, like numpy's str_
        else:
            reason = f"it has more than {most} bytes"
    except UnicodeEncodeError:
        reason = "it is not valid Unicode"
    raise error(f"{name}={_shorten(value)} cannot be used: {reason}; give {wanted}")


def check_integer(
    name: str, value: Any, least: int, most: int, error: type[CassandraRosError] = InvalidOption
) -> int:
    """Return a whole number from least to most, both included.

    Other numbers of this value are accepted, as 3.0, but not True, a text or bytes.

    Args:
        name: Name of the argument, for the error text.
        value: The value that the caller gave.
        least, most: Minimum and maximum.
        error: Class of the error that is raised.
    """
    try:
        number = None if isinstance(value, (bool, str, bytes)) else int(value)
    except (TypeError, ValueError, OverflowError):
        number = None
    if number is None or number != value or not least <= number <= most:
        raise error(
            f"{name}={_shorten(value)} cannot be used: give a whole number of {least} to {most}"
        )
    return number


def check_seconds(name: str, value: Any) -> float:
    """Return a number of seconds, at least 0 (also inf), or raise InvalidOption."""
    number = plain_value(value)
    if isinstance(number, (int, float)) and not isinstance(number, bool) and number >= 0:
        with suppress(OverflowError):
            return float(number)
    raise InvalidOption(f"{name}={_shorten(value)} is not a number of seconds: give 0.0 or more")


def check_node(node: Any) -> str:
    """Return a nodeID ('' = unknown robot), or raise InvalidName."""
    wanted = f"the name of a robot, as 'robot_1', of up to {MAX_NODE_BYTES} bytes"
    return check_text("nodeID", node, MAX_NODE_BYTES, InvalidName, wanted)


def check_new_node(node: Any) -> str:
    """Return a nodeID that new messages can have ('' = unknown robot), or raise InvalidName."""
    wanted = f"the name of a robot, as 'robot_1', of up to {MAX_NAME_BYTES} bytes"
    return check_text("nodeID", node, MAX_NAME_BYTES, InvalidName, wanted)


def check_nodes(node: Any) -> tuple[str, ...] | None:
    """Return the robots that a nodeID selects (None = all), or raise InvalidName."""
    return None if node is None else (check_node(node),)


def check_run(run: Any) -> None | str | int:
    """Return the name or the writer id of a run (None = all runs), or raise InvalidName."""
    if run is None:
        return None
    if isinstance(run, Integral) and not isinstance(run, bool):
        return check_integer("run", run, 1, MAX_WRITER, InvalidName)
    wanted = f"the name of a run, or its writer id of 1 to {MAX_WRITER}"
    return check_text("run", run, MAX_ARGUMENT_BYTES, InvalidName, wanted)


def check_run_name(name: Any) -> str:
    """Return the name of a new run ('' = no name), or raise InvalidName."""
    wanted = f"the name of a run, of up to {MAX_NAME_BYTES} bytes"
    return check_text("run.name", name, MAX_NAME_BYTES, InvalidName, wanted)


def check_labels(labels: Any) -> dict[str, str]:
    """Return the labels of a run or an event (name -> text), or raise InvalidName.

    A text may be empty, a name may not.
    """
    if not isinstance(labels, Mapping):
        raise InvalidName(
            f"labels={_shorten(labels)} are not a mapping: give one like {{'site': 'lab'}}"
        )
    wanted = f"labels that are texts of up to {MAX_NAME_BYTES} bytes, as {{'site': 'lab'}}"
    checked: dict[str, str] = {}
    for given_name, text in labels.items():
        name = check_text("label", given_name, MAX_NAME_BYTES, InvalidName, wanted)
        if not name:
            raise InvalidName(f"a label without a name cannot be used: give {wanted}")
        checked[name] = check_text(f"label {name}", text, MAX_NAME_BYTES, InvalidName, wanted)
    return checked


def check_topic(topic: Any) -> str:
    """Return the name of a topic to look up, of any length, or raise InvalidName."""
    if isinstance(topic, str):
        return topic
    raise InvalidName(f"{_shorten(topic)} is not a name of a topic: give a text like '/scan'")


def spellings(topic: str) -> tuple[str, str]:
    """Return the names by which a topic is found: with and without slash, the given one first."""
    return topic, topic[1:] if topic.startswith("/") else "/" + topic


def check_new_topic(topic: Any) -> str:
    """Return the name of a topic for which a table can be made, or raise InvalidName."""
    wanted = f"a name like '/scan', of up to {MAX_NAME_BYTES} bytes"
    name = check_text("topic", topic, MAX_NAME_BYTES, InvalidName, wanted)
    if not name or "\0" in name:
        raise InvalidName(f"{name!r:.80} is not a topic name: it is empty or contains NUL")
    return name


def check_ros_name(name: str, what: str = "") -> str:
    """Return the name of a topic that is valid in ROS, or raise InvalidName.

    Args:
        name: The name.
        what: What the name stands for, at the beginning of the error text; '' = nothing.
    """
    without_tilde = name[1:] if name.startswith("~") else name  # only the first one is allowed
    wrong = re.search(r"[^A-Za-z0-9_/]|//", without_tilde)
    if wrong:
        reason = f"{wrong[0]!r} may not stand in it"
    elif not re.match(r"[A-Za-z/~]", name):
        reason = "it must begin with a letter, / or ~"
    else:
        return name
    raise InvalidName(
        f"{what} {name!r:.80} is not a name of a ROS topic: {reason}; a name has letters, digits, "
        "_ and single /, as /camera/image_raw".lstrip()
    )


def check_topics(topics: Any) -> list[str] | None:
    """Return a list of topic names (None = all), or raise InvalidName. A text means one name."""
    if topics is None:
        return None
    return [check_topic(topic) for topic in check_list("topics", topics, "['/scan', '/tf']")]


def check_field(field: Any) -> str:
    """Return the name of a field to look up in a message type, or raise InvalidName."""
    return check_text("field", field, MAX_ARGUMENT_BYTES, InvalidName, "a name like 'linear.x'")


def check_fields(name: str, fields: Any) -> tuple[str, ...]:
    """Return the names of fields, or raise InvalidName. A text means one name."""
    return tuple(check_field(field) for field in check_list(name, fields, "['linear.x']"))


def check_list(name: str, values: Any, example: str) -> list[Any]:
    """Return a list of unchecked names, or raise InvalidName. A text means one name."""
    if isinstance(values, str):
        return [values]
    if isinstance(values, Iterable) and not isinstance(values, (bytes, bytearray)):
        return list(values)
    raise InvalidName(f"{name}={_shorten(values)} is not a list of names: give one like {example}")


def check_pairs(
    name: str, pairs: Iterable[tuple[str, _Value]], remedy: str = "give it once"
) -> dict[str, _Value]:
    """Return pairs as a mapping, or raise InvalidOption if two of them have the same key."""
    values_by_key: dict[str, _Value] = {}
    for key, value in pairs:
        if key in values_by_key:
            raise InvalidOption(f"{name}: {key!r:.80} is given twice: {remedy}")
        values_by_key[key] = value
    return values_by_key


def check_limit(limit: Any) -> int | None:
    """Return a maximum number of messages or rows (None = no maximum), or raise InvalidOption."""
    if limit is None:
        return None
    whole = isinstance(limit, Integral) and not isinstance(limit, bool)
    if whole and 0 <= int(limit) <= MAX_LIMIT:
        return int(limit)
    raise InvalidOption(
        f"limit={_shorten(limit)} is not a number of messages: give 0 to {MAX_LIMIT}, or None for "
        "all"
    )


def check_ttl(ttl_sec: Any) -> int:
    """Return a time to live, 0 to MAX_TTL_SEC s (0 = for ever), or raise InvalidOption."""
    return check_integer("ttl", ttl_sec, 0, MAX_TTL_SEC)


def check_key_format(key_format: Any, key_part: Any) -> str:
    """Return a key format ('' for None) if key_part fits to it, or raise InvalidKey."""
    check_text("key_part", key_part, error=InvalidKey, wanted="a field like 'header.stamp'")
    if key_format not in (None, "", *KEY_FORMATS):
        raise InvalidKey(
            f"there is no key_format {_shorten(key_format)}; there are: {', '.join(KEY_FORMATS)}"
        )
    if (key_format == "msg_part") != bool(key_part):
        raise InvalidKey(
            "key_part names the field that is the key, as 'header.stamp', and goes with "
            f"key_format='msg_part': given were key_format={key_format!r}, key_part={key_part!r}"
        )
    return key_format or ""


def check_message_name(topic: str, name: Any) -> str:
    """Return a name under which a message of a topic can be stored, or raise InvalidKey."""
    wanted = f"a text of 1 to {MAX_MESSAGE_NAME_BYTES} bytes"
    if name != "":
        remedy = f"a name, for messages of topic {topic} are kept under names: {wanted}"
        return check_text("key", name, MAX_MESSAGE_NAME_BYTES, InvalidKey, remedy)
    raise InvalidKey(
        f"messages of topic {topic} are kept under names, and '' is not a name: {wanted}"
    )


def check_event_name(name: Any) -> str:
    """Return the name of an event, or raise InvalidName."""
    wanted = f"the name of an event, as 'bump', of 1 to {MAX_NAME_BYTES} bytes"
    text = check_text("name", name, MAX_NAME_BYTES, InvalidName, wanted)
    if not text:
        raise InvalidName(f"name='' cannot be used: give {wanted}")
    return text


def exact_json(text: str) -> object:
    """Return the value of a JSON text whose numbers keep all their digits.

    Raises:
        InvalidOption: A number would change as a float, as seconds since 1970 with ns.
        ValueError, RecursionError: The text is no JSON. (InvalidOption is a ValueError, too: catch
            it first.)
    """
    return json.loads(text, parse_float=_exact_float)


def _exact_float(text: str) -> float:
    value = float(text)
    try:
        if math.isfinite(value) and Decimal(repr(value)) == Decimal(text):
            return value
    except InvalidOperation:  # an exponent of too many digits
        pass
    raise InvalidOption(
        f"the number {text:.80} would become {value!r}, the nearest that a float of 64 bits holds: "
        f'give it as a text, "{text:.80}", or times as whole ns'
    )


def check_event_values(values: Any) -> dict[str, Any]:
    """Return the values of an event if JSON can store them without change, or raise InvalidName.

    As JSON with all characters beyond ASCII escaped they have at most MAX_VALUES_BYTES.
    """
    json_values = _json_keys("values", values, ())
    check_text("values", json.dumps(json_values), MAX_VALUES_BYTES, InvalidName, "smaller values")
    return json_values


def check_user_keys(keys: Any) -> dict[str, Any]:
    """Return the user's own metadata if JSON can store them without change, or raise InvalidName.

    JSON cannot store tuples, sets, bytes, NaN, keys that are not texts, and invalid Unicode. The
    keys in FACTS are taken.
    """
    return _json_keys("metadata", keys, FACTS)


def _json_keys(what: str, keys: Any, taken: Container[str]) -> dict[str, Any]:
    """Return a mapping that JSON can store without change, none of whose keys is taken.

    Args:
        what: What the mapping is, for error texts.
        keys: The mapping.
        taken: Keys that it may not have: FACTS, or () = any key that is not empty is free.
    """
    if not isinstance(keys, Mapping):
        raise InvalidName(
            f"{what}={_shorten(keys)} is not a mapping: give one like {{'site': 'lab'}}"
        )
    checked: dict[str, Any] = {}
    for name, given in keys.items():
        value = plain_value(given)
        if not isinstance(name, str) or not name or name in taken:
            others = f", or one of {', '.join(FACTS)}" if taken else " of one letter or more"
            raise InvalidName(f"{name!r:.80} cannot be set as {what}: it is not a text{others}")
        try:
            text = json.dumps({name: value}, allow_nan=False, ensure_ascii=False)
            checked.update(json.loads(text.encode("utf-8")))
            reason = "" if checked[name] == value else "it comes back changed"
        except (TypeError, ValueError, RecursionError) as exc:
            reason = str(exc)
        if reason:
            raise InvalidName(
                f"{what} {name!r:.80}={_shorten(value)} cannot be kept as JSON: {reason}; give "
                "texts, finite numbers, true, false, None, lists, and dicts whose keys are texts"
            )
    return checked


def check_pattern(pattern: object) -> str:
    """Return a regular expression of topic names, or raise InvalidOption."""
    text = check_text("pattern", pattern, wanted="a regular expression, as /camera/.*")
    try:
        re.compile(text)
    except (re.error, OverflowError, RecursionError) as exc:
        raise InvalidOption(f"{text!r:.80} is not a regular expression: {exc}") from exc
    return text


def compile_pattern(option: str, text: str) -> re.Pattern[str]:
    """Compile the regular expression of an option; raises InvalidOption if it is not valid.

    In it a dot also matches a line break, which a stored name may contain.
    """
    try:
        return re.compile(text, re.DOTALL)
    except (re.error, OverflowError, RecursionError, TypeError) as exc:
        raise InvalidOption(f"{option} {text!r:.80} is not a regular expression: {exc}") from exc


def matching(
    option: str, expressions: Iterable[str], names: AbstractSet[str], where: str
) -> set[str]:
    """Return the names that one of the expressions matches in full.

    Args:
        option: Name of the option, for error texts.
        names: The names.
        where: The place that holds the names, for error texts: 'keyspace ros'.

    Raises:
        InvalidOption: An expression is not valid.
        TopicNotFound: An expression matches no name.
    """
    names_matching: set[str] = set()
    for text in expressions:
        pattern = compile_pattern(option, text)
        matches = {name for name in names if pattern.fullmatch(name)}
        if not matches:
            raise TopicNotFound(
                f"no topic in {where} matches {text!r:.80}: an expression must match the whole "
                f"name, as '/camera/.*'; it has {len(names)} topics"
            )
        names_matching |= matches
    return names_matching
