# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The columns that a statement may read, found by names alone.

A column is read if any name in the statement may mean it, whatever table is meant. So names are
resolved only by DuckDB, and no answer depends on what is found here.
"""

from __future__ import annotations

from typing import Any, Iterator

from cassandra_ros.installation import optional_module
from cassandra_ros.query.arrays.arrow_types import Wanted, wanted_columns


def needed_columns(tree: Any) -> Wanted | None:
    """Return the columns that a statement may read; None = all.

    KEY is always among them, because a table has at least one column.
    """
    exp = optional_module("sqlglot.expressions", "sql")
    if _reads_all(exp, tree):
        return None
    chains = list(_chains(exp, tree))
    tables = {table.alias_or_name.lower() for table in tree.find_all(exp.Table)}
    aliases = {alias.name.lower() for alias in tree.find_all(exp.TableAlias)}
    if any(len(chain) == 1 and chain[0].lower() in tables | aliases for chain in chains):
        return None  # the whole row as a struct
    # `a.b.c` means field c of column b of table a, or field b.c of column a.
    return wanted_columns([("KEY",), *(c[n:] for c in chains for n in range(len(c)))])


def names_column(tree: Any, name: str) -> bool:
    """Return whether a statement may mean a column by a name in lower case."""
    chains = _chains(optional_module("sqlglot.expressions", "sql"), tree)
    return any(chain_name.lower() == name for chain in chains for chain_name in chain)


def _reads_all(exp: Any, tree: Any) -> bool:
    if tree.find(exp.Columns, exp.Pivot, exp.PositionalColumn) is not None:
        return True
    if any(a.columns and isinstance(a.parent, exp.Table) for a in tree.find_all(exp.TableAlias)):
        return True  # names for the columns in their order
    if any(join.method == "NATURAL" for join in tree.find_all(exp.Join)):
        return True
    if any(kind.args.get("values") for kind in tree.find_all(exp.DataType)):
        return True  # an element of a column whose name is that of a type, as in time[1]
    if tree.find(exp.List) is not None:
        return True
    return any(not isinstance(star.parent, exp.Count) for star in tree.find_all(exp.Star))


def _chains(exp: Any, tree: Any) -> Iterator[tuple[str, ...]]:
    """Yield the dotted names in a statement, and each other name alone."""
    for column in tree.find_all(exp.Column):
        chain, node = [column_name.name for column_name in column.parts], column
        while isinstance(node.parent, exp.Dot) and node.parent.this is node:
            node = node.parent
            chain.append(node.expression.name)
        yield tuple(chain)
    for name in tree.find_all(exp.Identifier):
        if not isinstance(name.parent, (exp.Column, exp.Dot, exp.Table, exp.TableAlias, exp.Alias)):
            yield (name.name,)
