# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""An option of a program, declared once: as a field of a dataclass.

``cli/parsers.py`` makes the parser of it, with help text and completion. ``cli/parameters.py``
reads the private ROS parameter of the same name, for all nodes but the player. ``make doc`` writes
its row in the page of the program, and its argument in the launch file.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Callable, Mapping, NamedTuple, Sequence, TypeVar

_Value = TypeVar("_Value")
_KEY = "option"


class OptionGroup(NamedTuple):
    """Options that the help text of a program shows together."""

    title: str
    text: str = ""
    """What is true for all of them; '' = nothing."""


FIRST_GROUP = OptionGroup("options")


@dataclass(frozen=True)
class Option:
    """How the command line of a program gives a value.

    The default decides how: that of a flag is a bool, which the flag turns into its opposite; an
    option whose default is a list or a dict takes a value, or a pair, each time that it is given;
    all others take one value.
    """

    names: tuple[str, ...]
    """As typed, the shortest first; () = words of the command line that belong to no option."""
    help: str
    metavar: str = ""
    read: Callable[[str], object] = str
    """Reads the text of a value; raises InvalidOption. Words of no option stay texts."""
    group: OptionGroup = FIRST_GROUP
    rare: bool = False
    """Whether only --help-all shows it."""
    choices: Sequence[str] = ()
    """The texts that are possible; () = all."""
    many: bool = False
    """Whether several values of a list may follow at once, as in rosbag's --pause-topics /a /b."""

    def with_default(self, default: _Value, group: OptionGroup | None = None) -> _Value:
        """Return the field of a dataclass that has this option and a default.

        Its type is that of the default, as dataclasses.field has it for the checker of types.

        Args:
            group: The group in which help shows it there; None = that of the option.
        """
        declared = {_KEY: self if group is None else replace(self, group=group)}
        if isinstance(default, (list, dict)):
            copied: Callable[[], _Value] = partial(copy, default)
            field_with_copies: _Value = field(default_factory=copied, metadata=declared)
            return field_with_copies
        plain_field: _Value = field(default=default, metadata=declared)
        return plain_field


def option(
    default: _Value,
    *names: str,
    help: str,  # noqa: A002 - as argparse calls it
    metavar: str = "",
    read: Callable[[str], object] = str,
    group: OptionGroup = FIRST_GROUP,
    rare: bool = False,
    choices: Sequence[str] = (),
    many: bool = False,
) -> _Value:
    """Return the field of a dataclass that is an option of a program, with its default.

    The other arguments are those of ``Option``.
    """
    return Option(names, help, metavar, read, group, rare, choices, many).with_default(default)


def declared_options(kind: type[object]) -> Mapping[str, tuple[Option, object]]:
    """Return the options of a dataclass, each with its default, by the name of the field.

    All fields of the dataclass must have defaults; those that are no options are left out.
    """
    defaults = kind()
    return {
        member.name: (member.metadata[_KEY], getattr(defaults, member.name))
        for member in fields(kind)  # type: ignore[arg-type]
        if _KEY in member.metadata
    }
