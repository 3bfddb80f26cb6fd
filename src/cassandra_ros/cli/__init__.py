# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The command lines: parsers, what they print, exit status.

A verb of `cassandra_bag` is a file with two halves, `add_arguments(parser)` and `run(options)`; one
of `local_cassandra` is a function there. Its docstring is the verb's help text. `script` runs what
the files in scripts/ name.
"""
