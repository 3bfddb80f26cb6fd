# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The command line programs: parsers, output, exit status.

A verb of `cassandra_bag` is a module with two functions, `add_arguments(parser)` and
`run(options)`; a verb of `local_cassandra` is a function. Its docstring is the help text of the
verb. The module `script` runs the programs of scripts/.

In: arguments, a terminal. Out: lines, exit status 0, 1 (it failed) or 2 (wrong usage).
This room imports all others. argparse comes in here, and nothing else prints.
"""
