# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The command lines: parsers, what they print, exit status.

One verb, one file, two halves: `add_arguments(parser)` and `run(options)`; the module's docstring
is the verb's help text. `script` runs what the files in scripts/ name.
"""
