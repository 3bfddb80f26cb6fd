# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Parsers that read words, and print help texts and errors, in the same way for all programs."""

from __future__ import annotations

import argparse
import difflib
import inspect
import os
import re
import shutil
import sys
import textwrap
from dataclasses import dataclass
from typing import (
    Any,
    Callable,
    Generic,
    Iterable,
    Mapping,
    NoReturn,
    Sequence,
    TypeVar,
)

from cassandra_ros.errors import CassandraRosError
from cassandra_ros.installation import shipped_file
from cassandra_ros.metadata import SCHEMA_VERSION
from cassandra_ros.option import FIRST_GROUP, Option, OptionGroup, declared_options
from cassandra_ros.printable import shown_lines

ASKED = "_ARGCOMPLETE"
"""Environment variable that the shell sets to ask for candidates."""
_STATUSES = """\
exit status:
  0    success
  1    failure, also of a part: each line '%(prog)s: …' on standard error gives a reason
  2    wrong usage; nothing was done"""
_ENDED = "  130  ended by Ctrl-C, 143 by SIGTERM, 141 by the reader of its output (| head)"
_Verb = TypeVar("_Verb", covariant=True)
_VERB_WIDTH = 11
"""Width of the column of verbs."""


class Rare(str):
    """Help text of an option that is needed rarely: --help leaves it out, --help-all shows it."""


@dataclass(frozen=True)
class VerbGroup(Generic[_Verb]):
    """Verbs of a program that --help shows together."""

    title: str
    example: str
    """A command line with one of the verbs."""
    verbs: Mapping[str, _Verb]
    """Name of a verb → what its docstring, the help text, belongs to."""


def error_line(program: str, text: object) -> str:
    """Return the line that a program prints on standard error about a failure: PROGRAM: reason."""
    return f"{program}: {shown_lines(str(text))}"


def _epilog(program: str, more: str) -> str:
    """Return the end of a help text: what each exit status means, with further lines if any."""
    # The parser of a verb is named 'PROGRAM VERB', but error lines begin with PROGRAM only.
    return "\n".join(filter(None, (_STATUSES.replace("%(prog)s", program), more, _ENDED)))


class _HelpText(argparse.RawDescriptionHelpFormatter):
    """Fills paragraphs to the width of the terminal, and shortens the line of usage."""

    _OPTIONS = argparse.Action([], "options", metavar="[OPTION ...]")

    def add_usage(
        self,
        usage: str | None,
        actions: Iterable[argparse.Action],
        groups: Iterable[Any],
        prefix: str | None = None,
    ) -> None:
        """Add a line with the words and the options that are needed."""
        needed = [action for action in actions if action.required or not action.option_strings]
        super().add_usage(usage, [self._OPTIONS, *needed], [], prefix)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Return a text whose paragraphs fill the lines; indented lines stay as they are."""
        lines: list[str] = []
        prose: list[str] = []
        for line in [*text.splitlines(), ""]:
            if line[:1] not in ("", " "):
                prose.append(line)
            else:
                filled = textwrap.wrap(" ".join(prose), width, break_on_hyphens=False)
                lines += [*filled, line]
                prose = []
        return "".join(f"{indent}{line}".rstrip() + "\n" for line in lines[:-1])


class Parser(argparse.ArgumentParser):
    """A parser that takes its words in any order, and no option that would replace another one.

    argparse takes positional arguments from one place only, and the last of several values without
    a word about the others. An option for a list must have the action append or extend. Wrong usage
    is reported in the form of all other errors, by the parser of the verb. Help texts are filled to
    the width of the terminal, and leave out options whose help is Rare.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.formatter_class = _HelpText
        self._optionals.title = FIRST_GROUP.title  # in Python 3.8 and 3.9 'optional arguments'
        if ASKED not in os.environ:  # argcomplete reads values of argparse's own actions only
            self.register("action", None, _StoreOnce)
            self.register("action", "store", _StoreOnce)
            self.register("action", "store_const", _StoreConstOnce)
        self.verbs: dict[str, Parser] = {}
        """Parsers of the verbs by name."""
        self.given: dict[str, str] = {}
        """Options with one value that the last command line gave: dest -> the option as typed."""

    def format_help(self) -> str:
        """Return the help text without the options that are needed rarely."""
        rare = [(action, action.help) for action in self._actions if isinstance(action.help, Rare)]
        for action, _ in rare:
            action.help = argparse.SUPPRESS
        text = self.format_full_help()
        for action, help_text in rare:
            action.help = help_text
        if not rare:
            return text
        what = "option is" if len(rare) == 1 else "options are"
        return f"{text}\n{len(rare)} more {what} shown by {self.prog} --help-all\n"

    def format_full_help(self) -> str:
        """Return the help text with all options."""
        return super().format_help()

    def parse_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> argparse.Namespace:
        """Parse a command line; None = that of the process. Wrong usage ends the program."""
        words = sys.argv[1:] if args is None else list(args)
        if words and words[0] in self.verbs:
            options = argparse.Namespace() if namespace is None else namespace
            options.verb = words[0]
            return self.verbs[words[0]].parse_args(words[1:], options)
        if self.verbs and words and not words[0].startswith("-"):
            self.error(f"there is no verb {words[0]!r}{_nearest(words[0], self.verbs)}")
        self.given = {}
        options, unknown = self.parse_known_args(self._positionals_last(words), namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return options

    def _get_value(self, action: argparse.Action, arg_string: str) -> object:
        """Return the value of a word; errors of this package are wrong usage, with their texts.

        They would end the program with status 1, or, as ValueErrors, lose their texts.
        """
        read: Callable[[str], object] = self._registry_get("type", action.type, action.type)
        try:
            return read(arg_string)
        except CassandraRosError as exc:
            raise argparse.ArgumentError(action, str(exc)) from exc
        except (argparse.ArgumentTypeError, TypeError, ValueError):
            return super()._get_value(action, arg_string)  # it says what is wrong

    def _positionals_last(self, words: Sequence[str]) -> list[str]:
        """Return the words in the order that argparse needs: options with values, --, all others.

        A word before -- that begins like an option, but is not an option, ends the program.
        """
        end = words.index("--") if "--" in words else len(words)
        finder = _OptionFinder(self._actions)
        marked = list(map(_Word, words[:end]))
        try:
            _, unclaimed = finder.parse_known_args(marked)
        except argparse.ArgumentTypeError:  # this parser reports it, with its usage
            return list(words)
        unclaimed_ids = set(map(id, unclaimed))
        positionals = [word for word in marked if id(word) in unclaimed_ids]
        for word in positionals:
            if _LIKE_OPTION.match(word):
                self._report_unknown(word)
        ordered: list[str] = [word for word in marked if id(word) not in unclaimed_ids]
        last = [*positionals, *words[end + 1 :]]
        if last:
            ordered += ["--", *last]
        return list(map(str, ordered))

    def _report_unknown(self, word: str) -> NoReturn:
        names = [name for action in self._actions for name in action.option_strings]
        hint = _nearest(word.split("=")[0], names)
        if not hint:
            hint = f"; what begins with - and is not an option goes after --, as in: -- {word}"
        self.error(f"unrecognized arguments: {word}{hint}")

    def refuse_options(self, options: argparse.Namespace, dests: Sequence[str], text: str) -> None:
        """End the program if the command line gave one of some options or words.

        Args:
            options: The parsed options.
            dests: Names in ``options`` of those that are refused.
            text: What is wrong with it; {} stands for the option as it was typed.

        An option that was given with its default value counts as not given.
        """
        for action in self._actions:
            value = getattr(options, action.dest, None)
            if action.dest in dests and value not in (action.default, []):
                name = action.option_strings[-1] if action.option_strings else action.metavar
                self.error(text.format(self.given.get(action.dest) or name))

    def error(self, message: str) -> NoReturn:
        """Print the usage and the error, and end the program with status 2."""
        self.print_usage(sys.stderr)
        program = self.prog.split()[0]
        option = re.fullmatch(r"argument (?:.*/)?(--[\w-]+): expected one argument", message)
        if option:
            message += f"; one that begins with - is given as {option[1]}=-…"
        self.exit(2, error_line(program, f"{message} (see {self.prog} --help)") + "\n")


_LIKE_OPTION = re.compile(r"-(?!\.?[0-9])\S+$")
"""A word that is an option or a misspelt one: not -, a negative number, or a text with blanks."""


def _nearest(word: str, names: Iterable[str]) -> str:
    near = difflib.get_close_matches(word, names, n=1)
    return f": did you mean {near[0]}?" if near else ""


class _Word(str):
    """A word of a command line. Words of the same text are different objects: ids tell them apart.

    argparse hands the words that it does not know back as the same objects.
    """


class _Skip(argparse.Action):
    """Takes the values of an option, and does nothing."""

    def __call__(self, *_: object) -> None:
        pass


class _OptionFinder(argparse.ArgumentParser):
    """Finds the options of a command line and their values; all else is unknown to it."""

    def __init__(self, actions: Sequence[argparse.Action]) -> None:
        super().__init__(add_help=False)
        for action in actions:
            if action.option_strings:
                self.add_argument(*action.option_strings, action=_Skip, nargs=action.nargs)

    def error(self, message: str) -> NoReturn:
        """Raise ArgumentTypeError."""
        raise argparse.ArgumentTypeError(message)


class _StoreOnce(argparse.Action):
    """Stores a value. A second one, which would replace the first, is refused."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option_string: str | None = None,
    ) -> None:
        if option_string is not None and isinstance(parser, Parser):
            _refuse_second(parser, self, option_string)
        setattr(namespace, self.dest, values)


class _StoreConstOnce(argparse.Action):
    """Stores a constant. It may be given again, but not with another option for the same."""

    def __init__(self, **options: Any) -> None:
        super().__init__(nargs=0, **options)

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option_string: str | None = None,
    ) -> None:
        if isinstance(parser, Parser) and parser.given.get(self.dest) not in self.option_strings:
            _refuse_second(parser, self, str(option_string))
        setattr(namespace, self.dest, self.const)


def _refuse_second(parser: Parser, action: argparse.Action, option: str) -> None:
    """Note that an option is given; end the program if the same was given before.

    Args:
        parser: The parser, which has what was given.
        action: The option.
        option: The option as it was typed.
    """
    first = parser.given.get(action.dest)
    if first in action.option_strings:
        parser.error(f"{option} is given twice: give it once")
    if first is not None:
        parser.error(f"{first} and {option} say the same: give one of them")
    parser.given[action.dest] = option


def add_option(
    container: argparse._ActionsContainer, name: str, declared: Option, default: object
) -> None:
    """Add a declared option, or the words of the command line that are its values.

    Args:
        container: The parser, or a group of it.
        name: Name of the value in the parsed options.
        default: Its value if the option is missing; decides its kind, see ``Option``.
    """
    help_text = declared.help.replace("%", "%%")
    help_text = Rare(help_text) if declared.rare else help_text
    several = isinstance(default, (list, dict))
    if not declared.names:
        container.add_argument(name, metavar=declared.metavar, nargs="*", help=help_text)
    elif isinstance(default, bool):
        action = "store_false" if default else "store_true"
        container.add_argument(*declared.names, dest=name, action=action, help=help_text)
    else:
        container.add_argument(
            *declared.names,
            dest=name,
            action="extend" if declared.many else "append" if several else "store",
            nargs="+" if declared.many else None,
            metavar=declared.metavar,
            type=declared.read,
            default=[] if several else default,
            choices=declared.choices or None,
            help=help_text,
        )


def add_options(parser: argparse.ArgumentParser, kind: type[object]) -> None:
    """Add the options that the fields of a dataclass declare, each group under its title."""
    groups: dict[OptionGroup, argparse._ActionsContainer] = {FIRST_GROUP: parser}
    for name, (declared, default) in declared_options(kind).items():
        group = declared.group
        if group not in groups:
            groups[group] = parser.add_argument_group(group.title, group.text or None)
        add_option(groups[group], name, declared, default)


class _HelpAll(argparse.Action):
    """Print the help text with all options."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(parser.format_full_help() if isinstance(parser, Parser) else "", end="")
        parser.exit()


class _Version(argparse.Action):
    """Print the version of the package and of the schema; the file is read only when asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(f"{parser.prog} {version()} (reads and writes keyspaces of schema {SCHEMA_VERSION})")
        parser.exit()


def program_parser(program: str, text: str | None, more: str = "") -> Parser:
    """Return a parser whose description is a docstring.

    Args:
        text: The docstring; its lines are kept.
        more: Lines about further exit statuses.
    """
    description, closing = inspect.cleandoc(text or ""), _epilog(program, more)
    parser = Parser(prog=program, description=description, epilog=closing)
    _add_help_all(parser)
    parser.add_argument(
        "--version", action=_Version, nargs=0, help="show the version and the schema, and exit"
    )
    return parser


def _listed(group: VerbGroup[object]) -> str:
    """Return the part of a help text about a group: a line for each verb, and the example."""
    width = max(shutil.get_terminal_size().columns - 2, 2 * _VERB_WIDTH)  # as argparse fills
    lines = [f"{group.title}:"]
    for name, verb in group.verbs.items():
        first = f"  {name:<{_VERB_WIDTH}}"
        summary = (inspect.getdoc(verb) or "").splitlines()[0]
        blank = " " * len(first)
        lines += textwrap.wrap(summary, width, initial_indent=first, subsequent_indent=blank)
    return "\n".join([*lines, f"  as in: {group.example}"])


def _add_help_all(parser: Parser) -> None:
    text = "show this help message with all options, and exit"
    parser.add_argument("--help-all", action=_HelpAll, nargs=0, help=text)


def verbs_parser(
    program: str,
    text: str | None,
    groups: Sequence[VerbGroup[object]],
    add_arguments: Callable[[str, argparse.ArgumentParser], None],
    more: str = "",
) -> Parser:
    """Return the parser of a program with verbs; their docstrings are their help texts.

    The parsed options have ``verb``, its name, and ``parser``, the parser of the verb.

    Args:
        program: Name of the program.
        text: Its docstring.
        groups: The verbs.
        add_arguments: Adds the arguments of the verb of a name to its parser.
        more: Lines about further exit statuses.
    """
    parser = program_parser(program, text, more)
    parser.description = "\n\n".join([parser.description or "", *map(_listed, groups)])
    help_text = "one of the verbs above"
    verb_parsers = parser.add_subparsers(
        prog=program, dest="verb", metavar="VERB", required=True, help=help_text
    )
    verbs = {name: verb for group in groups for name, verb in group.verbs.items()}
    for name, verb in verbs.items():
        verb_parser = verb_parsers.add_parser(
            name, description=inspect.getdoc(verb), epilog=_epilog(program, more)
        )
        _add_help_all(verb_parser)
        verb_parser.set_defaults(parser=verb_parser)
        parser.verbs[name] = verb_parser
        add_arguments(name, verb_parser)
    return parser


def version() -> str:
    """Return the version that package.xml states; 'unknown' if there is no such file."""
    file = shipped_file("package.xml")
    text = file.read_text("utf-8") if file.is_file() else ""
    match = re.search(r"<version>([^<]+)</version>", text)
    return match[1] if match else "unknown"
