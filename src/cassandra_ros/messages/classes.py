# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Message classes and objects: installed ones, and those generated from a definition."""

from __future__ import annotations

import importlib.abc
import struct
import threading
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from io import BytesIO
from itertools import repeat
from types import ModuleType
from typing import Any, Callable, Iterator, Sequence, cast

import genmsg
import genmsg.msg_loader
import genpy
import genpy.dynamic
import genpy.generator
import genpy.message
import numpy as np
import yaml

from cassandra_ros.errors import CorruptMessage, DefinitionError, TypeMismatch
from cassandra_ros.keys import SECOND_NS
from cassandra_ros.messages.definition import (
    Definition,
    attribute_name,
    definition_of,
    installed_class,
    read_definition,
    render_spec,
)
from cassandra_ros.messages.spec import Field
from cassandra_ros.messages.wire.field_ends import compile_object_check, compile_skip
from cassandra_ros.messages.wire.fields import CannotBatch
from cassandra_ros.messages.wire.objects import MIN_TOGETHER, ObjectMaker

_TIMES = {"time": genpy.Time, "duration": genpy.Duration}
_lock = threading.RLock()  # genpy keeps the state of its generator in global variables
_classes: dict[Definition, Any] = {}
"""Class of each definition so far, read and written under ``_lock``: a definition has one class."""


class RawMessage(genpy.Message):
    """A message whose definition is unusable: only its bytes, in ``_buff``."""

    __slots__ = ["_buff"]
    _slot_types = ["uint8[]"]
    _type = "*"
    _md5sum = "*"
    _full_text = ""
    _has_header = False

    def __init__(self, _buff: bytes = b"") -> None:
        self._buff = _buff

    def __reduce__(self) -> tuple[object, ...]:
        if type(self) is RawMessage:
            return RawMessage, (self._buff,)
        return _new_raw_message, (self._type, self._md5sum, self._buff)

    def _get_types(self) -> list[str]:
        return self._slot_types

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other._buff == self._buff

    def serialize(self, buff: Any) -> None:
        """Write the bytes unchanged."""
        buff.write(self._buff)

    def deserialize(self, str: bytes) -> RawMessage:  # noqa: A002 - genpy calls it so
        """Keep the bytes unchanged."""
        self._buff = bytes(str)
        return self


class _GeneratedMessage(genpy.Message):
    """The base of generated classes. Pickle sends their definition, because they lie in no module.

    Not by a metaclass: rospy publishes only classes whose type is ``type``.
    """

    __slots__: list[str] = []
    _generated_for: Definition

    def __reduce__(self) -> tuple[object, ...]:
        of = self._generated_for
        recipe = _new_message, (of.type, of.text, of.md5sum, self._type)
        return (*recipe, self.__getstate__())


def _new_message(of_type: str, text: str, md5sum: str, msg_type: str) -> Any:
    """Return a message without values, of a type in a definition that was pickled."""
    cls = message_class(read_definition(of_type, text, md5sum))
    return (cls if msg_type == cls._type else cls.serialize.__globals__[_name(msg_type)])()


def _name(msg_type: str) -> str:
    """Return the name that genpy's generated source has for the class of a type."""
    return "_{}__{}".format(*msg_type.split("/"))


class _Source(importlib.abc.InspectLoader):
    """Loads a module from source text that this package generated."""

    def __init__(self, text: str) -> None:
        self._text = text

    def get_source(self, fullname: str) -> str:
        return self._text


def installed_definition(msg_type: str) -> Definition:
    """Return the definition of an installed type; DefinitionError: not installed, or broken."""
    cls = installed_class(msg_type)
    if cls is None:
        raise DefinitionError(f"message type {msg_type} is not installed on this machine")
    return definition_of(cls)


def message_class(definition: Definition) -> Any:
    """Return the installed class if it has this definition, else a generated class.

    Raises DefinitionError where genpy cannot generate a class.
    """
    with _lock:
        if definition not in _classes:
            cls = installed_class(definition.type)
            if cls is None or definition_of(cls) != definition:
                cls = _generate(definition)
            _classes[definition] = cls
        return _classes[definition]


@lru_cache(maxsize=1024)
def raw_class(msg_type: str, md5sum: str) -> Any:
    """Return a class for messages whose definition is unusable: it holds their bytes."""
    attributes = {"__slots__": [], "_type": msg_type, "_md5sum": md5sum}
    return type("RawMessage", (RawMessage,), attributes)


def _new_raw_message(msg_type: str, md5sum: str, buff: bytes) -> Any:
    return raw_class(msg_type, md5sum)(buff)


def _generate(definition: Definition) -> Any:
    """Return a class that genpy makes of a definition; called under ``_lock``."""
    names = {name: _name(name) for name in definition.specs}
    if len(set(names.values())) < len(names):
        raise DefinitionError(f"genpy cannot tell the types of {definition.type} apart")
    try:
        module = ModuleType(f"cassandra_ros.generated.{names[definition.type]}")
        setattr(module, _GeneratedMessage.__name__, _GeneratedMessage)
        _Source(_source(definition)).exec_module(module)
        for msg_type, name in names.items():
            _complete(getattr(module, name), definition, msg_type)
    except Exception as exc:  # SyntaxError, MemoryError, RecursionError and others
        why = f"{type(exc).__name__}: {str(exc)[:200]}"
        raise DefinitionError(f"genpy cannot make a class of {definition.type}: {why}") from exc
    return getattr(module, names[definition.type])


def _source(definition: Definition) -> str:
    """Return the generated source, as genpy.dynamic.generate_dynamic, but without files in /tmp."""
    context = genmsg.MsgContext.create_default()
    load = genmsg.msg_loader.load_msg_from_string
    specs = {name: load(context, render_spec(s), name) for name, s in definition.specs.items()}
    return "\n".join(
        _with_base(genpy.dynamic._gen_dyn_modify_references(line, name, list(specs)))
        for name, spec in specs.items()
        for line in genpy.generator.msg_generator(context, spec, {})
    )


def _with_base(line: str) -> str:
    """Return a line of generated source, in which a class begins with the base of ours."""
    if not line.startswith("class "):
        return line
    return line.replace("(genpy.Message)", f"({_GeneratedMessage.__name__})")


def _complete(generated: Any, definition: Definition, msg_type: str) -> None:
    """Set on a class what genpy was not given, see render_spec: full text, md5 and constants."""
    nested = msg_type != definition.type
    inner = definition.nested(msg_type) if nested else definition
    generated._generated_for = definition
    generated._definition = inner
    generated._md5sum = inner.md5sum
    generated._full_text = inner.text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")
    for constant in inner.root.constants:
        name = attribute_name(constant.name)
        if not hasattr(generated, name):  # as in genpy, a constant replaces no method
            setattr(generated, name, constant.value)


def serialize(msg: Any) -> bytes:
    """Return the wire bytes of a message; TypeMismatch: a value does not fit its field's type."""
    if getattr(type(msg), "_type", None) == "*":
        return bytes(msg._buff)  # RawMessage and rospy.AnyMsg
    buffer = BytesIO()
    try:
        msg.serialize(buffer)
    except Exception as exc:
        name = getattr(type(msg), "_type", type(msg).__name__)
        raise TypeMismatch(f"this {name} cannot be serialised: {str(exc)[:300]}") from exc
    return buffer.getvalue()


def deserialize(cls: Any, wire: bytes) -> Any:
    """Make a message from wire bytes, surplus bytes ignored; CorruptMessage: malformed bytes."""
    try:
        return _maker(cls)(wire)
    except struct.error as exc:
        why = "they end too early, or a length exceeds them"
        raise CorruptMessage(f"{len(wire)} bytes are no {cls._type}: {why}") from exc
    except Exception as exc:
        raise CorruptMessage(f"{len(wire)} bytes are no {cls._type}: {str(exc)[:300]}") from exc


def deserialize_all(cls: Any, wires: Sequence[bytes]) -> Iterator[Any]:
    """Make many messages, like ``deserialize`` for each, in a fraction of the time.

    The iterator makes each message when it is requested.

    Raises:
        CorruptMessage: The next message is malformed. Raised by the iterator.
    """
    maker = _object_maker(cls) if len(wires) >= MIN_TOGETHER else None
    if maker is not None:
        sizes = np.fromiter(map(len, wires), np.int64, len(wires))
        with suppress(CannotBatch):
            return maker.make(b"".join(wires), np.cumsum(sizes) - sizes, sizes)
    return map(deserialize, repeat(cls), wires)


@lru_cache(maxsize=1024)
def _object_maker(cls: Any) -> ObjectMaker | None:
    """Return what makes many objects of a class at once; None = they are made one by one."""
    if issubclass(cls, RawMessage):
        return None
    try:
        return ObjectMaker(cls, definition_of(cls))
    except CannotBatch:
        return None


@lru_cache(maxsize=1024)
def _maker(cls: Any) -> Callable[[bytes], Any]:
    """Return the function from wire bytes to an object of a class; it may raise any exception."""
    if issubclass(cls, RawMessage):
        return cast("Callable[[bytes], Any]", cls)
    definition = definition_of(cls)
    skip = compile_skip(definition.type, definition.specs)
    check = compile_object_check(definition.type, definition.specs)

    def make(wire: bytes) -> Any:
        skip(wire, 0)  # genpy does not report a string cut at the end of a short buffer
        if check is not None:
            check(wire)
        return cls().deserialize(wire)

    return make


def exact_message(cls: Any, wire: bytes) -> Any:
    """Make a message from wire bytes that must serialise to the same bytes; else CorruptMessage."""
    message = deserialize(cls, wire)
    if serialize(message) != wire:
        raise CorruptMessage(
            f"{len(wire)} bytes are no {cls._type}: serialised again they "
            "would differ, because a bool is neither 0 nor 1, or bytes follow the end"
        )
    return message


def message_of_yaml(cls: Any, text: str) -> Any:
    """Make a message from what ``rostopic pub`` takes: a mapping, or a list of all field values.

    The value of a single field may be given without a list. Aliases (``*name``) are refused: a few
    hundred bytes of aliases can expand to any number of values. Only plain YAML values are read.

    Raises:
        TypeMismatch: The text is not YAML, or does not fit the message type.
    """
    try:
        if "*" in text and any(isinstance(e, yaml.AliasEvent) for e in yaml.parse(text)):
            raise TypeMismatch("the YAML has an alias (*name), which is not read: write it out")
        values = yaml.safe_load(text)
        arguments = values if isinstance(values, list) else [] if values is None else [values]
        single = len(arguments) == 1 and isinstance(arguments[0], dict)
        message = _fill(cls, arguments[0] if single else arguments)
        serialize(message)  # it checks numbers and texts
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as exc:
        why = " ".join(str(exc).split())[:300]
        raise TypeMismatch(f"the YAML is no {cls._type}: {why}") from exc
    return message


def _fill(cls: Any, values: Any) -> Any:
    """Return a message with values of some fields by name, or of all fields in their order.

    Not by genpy's fill_message_args: it makes floats of times, and needs the types installed.
    """
    msg, definition = cls(), definition_of(cls)
    fields = {attribute_name(field.name): field for field in definition.root.fields}
    if isinstance(values, list) and len(values) == len(fields):
        values = dict(zip(fields, values))
    if not isinstance(values, dict):
        raise ValueError(f"{_short(values)} is no {definition.type} with {len(fields)} fields")
    for name, value in values.items():
        if name not in fields:
            raise ValueError(f"{definition.type} has no field {_short(name)}")
        setattr(msg, name, _value(fields[name], value, definition))
    return msg


def _value(field: Field, value: Any, definition: Definition) -> Any:
    """Return a value as a field holds it; numbers and texts are checked when it is serialised."""
    if field.is_array:
        if field.is_primitive and field.type not in _TIMES:
            return value
        if not isinstance(value, list):
            raise ValueError(f"{field.name} is a list, not {_short(value)}")
        one = replace(field, is_array=False)
        return [_value(one, element, definition) for element in value]
    if field.type in _TIMES:
        return _time(_TIMES[field.type], value)
    if field.is_primitive:
        return "" if value is None else value
    return _fill(message_class(definition.nested(field.type)), value)


def _time(cls: Any, value: Any) -> Any:
    """Return a time from its ns, or from secs and nsecs by name or in their order."""
    parts = divmod(value, SECOND_NS) if type(value) is int else value
    if isinstance(value, dict) and not value.keys() - {"secs", "nsecs"}:
        parts = (value.get("secs", 0), value.get("nsecs", 0))
    if isinstance(parts, (list, tuple)) and len(parts) == 2 and {type(n) for n in parts} == {int}:
        return cls(*parts)
    raise ValueError(f"{_short(value)} is not a time: give ns, or {{secs: S, nsecs: N}}")


def _short(value: object) -> str:
    return repr(value)[:80]


def to_yaml(msg: Any) -> str:
    """Return the text that ``rostopic echo`` prints for a message."""
    if isinstance(msg, RawMessage):
        return f"# {len(msg._buff)} bytes of {msg._type}, whose definition is unusable"
    return cast(str, genpy.message.strify_message(msg))
