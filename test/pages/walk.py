# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Types in what a page says, as its reader would, and compares what comes with what it shows.

Blocks are taken in their order. In a block ``sh`` each line is a command; in one without a language
a command follows ``$``, and below it stands what it prints; where no line has a ``$`` all of it is
what the last command printed. Blocks ``python`` are typed into one Python. ``…`` is any text.

Comments say what prose says to a reader:

* ``<!-- terminal 2 -->``: where the next blocks are typed.
* ``<!-- until: TEXT -->``: the next command stays, and is ready when it prints this.
* ``<!-- stays -->``: the next command stays, and need not be waited for.
* ``<!-- Ctrl-C -->``, ``<!-- ends -->``: the last command is ended, or ends by itself.
"""

from __future__ import annotations

import doctest
import os
import re
import signal
import subprocess
import threading
import time

from conftest import ROOT

from cassandra_ros import RosCassandra

LIMIT_SEC = 600
_PIECES = re.compile(
    r"^```(?P<language>[^\n]*)\n(?P<block>.*?)^```$|^<!-- (?P<comment>[^\n]*) -->$", re.M | re.S
)
_FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
_SECONDS = re.compile(r"\b\d+(\.\d+)? s\b")
_WAITS = re.compile(r"^.*( … \d+ s|waiting for the ROS master at .*)\n", re.M)
"""What programs say on a busy machine alone: each 10 s, or where a master answers late."""


def pieces(text):
    """Yield the blocks and comments of a page: (kind, text)."""
    for found in _PIECES.finditer(text):
        if found["comment"] is not None:
            yield "comment", found["comment"]
        else:
            yield found["language"], found["block"]


def commands(language, block):
    """Yield the commands of a block, each with what it is to print; None = that is not shown."""
    if language == "sh":
        for line in block.replace("\\\n", " ").splitlines():
            if line.strip() and not line.startswith("#"):
                yield line, None
        return
    for part in re.split(r"^\$ ", block, flags=re.M)[1:]:
        command, _, output = part.partition("\n")
        yield command, output


def check(wanted, printed):
    """Fail where a page shows something else than what was printed, but for durations and waits."""
    printed = _WAITS.sub("", printed)
    wanted, printed = (_SECONDS.sub("0 s", text) for text in (wanted, printed))
    wanted = wanted.replace("…", "...")
    if not doctest.OutputChecker().check_output(wanted, printed, _FLAGS):
        raise AssertionError(f"the page shows:\n{wanted}\nbut there was printed:\n{printed}")


class Terminal:
    """A shell that lives as long as the walk."""

    def __init__(self, env):
        self._output = b""
        self._from = 0
        self._number = 0
        self.process = subprocess.Popen(
            ["bash", "--norc"],
            cwd=ROOT,
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C goes to all processes of one terminal
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        # The shell outlives a Ctrl-C, its commands do not. Only this walk's roscore has its port.
        self._send('trap : INT; roscore() { command roscore -p "${ROS_MASTER_URI##*:}" "$@"; }')

    def _read(self):
        while True:
            piece = os.read(self.process.stdout.fileno(), 1 << 16)
            if not piece:
                return
            self._output += piece

    def _send(self, text):
        self.process.stdin.write(text.encode() + b"\n")
        self.process.stdin.flush()

    @property
    def printed(self):
        """What the last command has printed so far."""
        return self._output[self._from :].decode(errors="replace")

    def type(self, command):
        """Start a command."""
        self._from = len(self._output)
        self._number += 1
        # Who reads standard input would take the next command.
        self._send(f'{{ {command}\n}} </dev/null; echo "<end {self._number} $?>"')

    def until(self, text):
        """Wait for a text of the last command."""
        self._await(re.escape(text))

    def finish(self):
        """Wait for the end of the last command; return what it printed, and its status."""
        found = self._await(rf"<end {self._number} (\d+)>\n")
        return found.string[: found.start()], int(found[1])

    def interrupt(self):
        """Press Ctrl-C, and wait for the end."""
        os.killpg(self.process.pid, signal.SIGINT)
        return self.finish()

    def _await(self, pattern):
        deadline = time.monotonic() + LIMIT_SEC
        while time.monotonic() < deadline:
            found = re.search(pattern, self.printed)
            if found:
                return found
            time.sleep(0.02)
        raise AssertionError(f"{pattern!r} never came:\n{self.printed}")

    def close(self):
        """End the shell and what still runs in it."""
        os.killpg(self.process.pid, signal.SIGINT)
        self.process.stdin.close()
        try:
            self.process.wait(60)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        self._reader.join(60)
        self.process.stdout.close()


class Walk:
    """A reader of one page, with his terminals and his Python."""

    def __init__(self, env):
        self._env = env
        self._terminals = {}
        self._names = {"__name__": "__main__"}
        self._python = doctest.DocTestRunner(optionflags=_FLAGS, verbose=False)
        self.typed = []

    def terminal(self, name):
        if name not in self._terminals:
            self._terminals[name] = Terminal(self._env)
        return self._terminals[name]

    def follow(self, text):
        """Do all that a page says."""
        terminal, printed, until = self.terminal("1"), "", None
        for kind, content in pieces(text):
            if kind == "comment":
                if content.startswith("terminal "):
                    terminal = self.terminal(content.split()[1])
                elif content.startswith("until: "):
                    until = content[len("until: ") :]
                elif content == "stays":
                    until = ""
                elif content == "Ctrl-C":
                    printed, _ = terminal.interrupt()
                elif content == "ends":
                    printed, _ = terminal.finish()
            elif kind == "python":
                self._type_python(content)
            elif kind == "sh" or re.search(r"^\$ ", content, re.M):
                for command, wanted in commands(kind, content):
                    printed = self._type(terminal, command, wanted, until)
                until = None
            else:
                check(content, printed)

    def _type(self, terminal, command, wanted, until):
        self.typed.append(command)
        terminal.type(command)
        if until is not None:
            terminal.until(until)
            return ""
        printed, status = terminal.finish()
        # What is shown may be an error; what is only said to be done must succeed.
        if wanted is None:
            assert status == 0, f"$ {command}\n{printed}"
        else:
            check(wanted, printed)
        return printed

    def _type_python(self, block):
        block = block.replace("…", "...")
        examples = doctest.DocTestParser().get_examples(block)
        test = doctest.DocTest(examples, self._names, "page", None, 0, block)
        said = []
        self._python.run(test, out=said.append, clear_globs=False)
        self._names.update(test.globs)
        assert not said, "".join(said)

    def close(self):
        for terminal in self._terminals.values():
            terminal.close()
        for value in self._names.values():
            if isinstance(value, RosCassandra):
                value.close()
