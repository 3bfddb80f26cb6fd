# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Print shell code with which bash or zsh complete verbs, options, topics, fields, runs and robots.

  eval "$(rosrun cassandra_ros cassandra_bag completion bash)"     # a line for ~/.bashrc
  eval "$(rosrun cassandra_ros cassandra_bag completion zsh)"      # ~/.zshrc, after compinit

Put the line after the one that sources the workspace. You can then type cassandra_bag without
rosrun, and the Tab key completes it. Topics, fields, runs and robots come from the store that the
options typed so far, the environment and the cqlshrc name; for import and verify, topics come from
the files. In bash this also works for all programs of the package after rosrun. It needs the Python
package argcomplete, of requirements/runtime.txt.
"""

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
command -v cassandra_bag >/dev/null || cassandra_bag() {
    PROGRAM "$@"
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
_SHELLS = {"bash": _ASK + _ROSRUN, "zsh": "autoload -U +X bashcompinit && bashcompinit\n" + _ASK}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the shell."""
    parser.add_argument("shell", choices=sorted(_SHELLS), help="your shell")


def run(options: argparse.Namespace) -> int:
    """Print the shell code, which runs this very program for the candidates."""
    program = Path(sys.argv[0]).absolute()
    text = _SHELLS[options.shell].replace("PROGRAM", shlex.quote(str(program)))
    print(text.replace("FOLDER", shlex.quote(str(program.parent))), end="")
    return 0
