# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The shell code by which bash and zsh complete what is typed; `candidates` answers them."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

# argcomplete writes the candidates to file descriptor 8, separated by vertical tabs. A candidate
# ends with a space if the word is complete.
_ASK = """\
_cassandra_ros_ask() {
    local IFS=$'\\013'
    COMPREPLY=( $(COMP_LINE="$COMP_LINE" COMP_POINT="$COMP_POINT" COMP_TYPE="$COMP_TYPE" \\
        _ARGCOMPLETE_COMP_WORDBREAKS="$COMP_WORDBREAKS" _ARGCOMPLETE_SHELL=bash \\
        _ARGCOMPLETE="$1" "$2" 8>&1 >/dev/null 2>/dev/null 9>&2) )
}
_cassandra_ros_bag() {
    _cassandra_ros_ask 1 PROGRAM
}
complete -o nospace -o default -F _cassandra_ros_bag cassandra_bag
"""
_ROSRUN = """\
_cassandra_ros_rosrun() {
    local name=${COMP_WORDS[2]}
    if [[ ${COMP_WORDS[1]} == cassandra_ros && $COMP_CWORD -ge 3 && -x FOLDER/$name ]]; then
        compopt -o nospace
        _cassandra_ros_ask 3 FOLDER/"$name"
    elif declare -F _roscomplete_exe >/dev/null; then
        _roscomplete_exe "$@"
    fi
}
declare -F _completion_loader >/dev/null && _completion_loader rosrun
complete -o default -F _cassandra_ros_rosrun rosrun
"""
_OTHER = "recorder"
"""Another program of the package: the folder that has it is the one in which rosrun looks."""
_SHELLS = {"bash": _ASK + _ROSRUN, "zsh": "autoload -U +X bashcompinit && bashcompinit\n" + _ASK}


class PrintCompletion(argparse.Action):
    """Print the code for a shell, which runs this very program for the candidates, and exit."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option_string: str | None = None,
    ) -> None:
        """Print it; argparse calls this."""
        program = Path(sys.argv[0]).absolute()
        text = _SHELLS[str(values)].replace("PROGRAM", shlex.quote(str(program)))
        # The others lie beside it, or, where catkin puts them, in the folder in which rosrun looks.
        beside = (program.parent / _OTHER).exists()
        folder = program.parent if beside else program.parent.parent / "lib/cassandra_ros"
        print(text.replace("FOLDER", shlex.quote(str(folder))), end="")
        parser.exit()


def add_completion_option(parser: argparse.ArgumentParser) -> None:
    """Add --completion."""
    parser.add_argument(
        "--completion",
        action=PrintCompletion,
        choices=sorted(_SHELLS),
        help="print code with which the Tab key completes words in your shell, and exit; it needs "
        "the Python package argcomplete. Topics, fields, runs and robots come from the store that "
        "the options typed so far, the environment and the cqlshrc name; for import and verify, "
        "topics come from the files (default: do not print it)",
    )
