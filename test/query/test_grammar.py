# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""query/tree/grammar.py: the kept tables are those of the grammar, and others are not used."""

from __future__ import annotations

import json

import pytest
from lark import Lark, UnexpectedInput

from cassandra_ros.query.tree import grammar as module

TEXTS = [
    "SELECT * FROM /a",
    "SELECT KEY, linear.x AS speed FROM /a WHERE linear.x > ? AND NOT b IN (1, 2) LIMIT 5",
    "select max(x), count(*) from \"/a b\" where name LIKE 'x%' or t is null group by NODE",
    "DELETE FROM /a WHERE KEY < now() - 7d",
    "CREATE INDEX ON /a (b.c)",
    "SELECT KEY FROM /a WHERE any(ranges) < 0.5 ORDER BY KEY DESC",
    "SELECT FROM /a",
    "SELECT * FROM /a WHERE x >",
    "UPDATE /a SET x = 1",
    "SELECT 'open FROM /a",
]


def answer(parser, text):
    try:
        return parser.parse(text, start="statement")
    except UnexpectedInput as exc:
        expected = getattr(exc, "accepts", None) or getattr(exc, "allowed", None)
        return type(exc), exc.pos_in_stream, sorted(expected or ())


def test_the_kept_tables_are_those_of_the_grammar():
    kept = json.loads(module._TABLES.read_text("ascii"))
    assert kept["origin"] == module._origin(), (
        "the grammar or lark has changed: make setup GRAMMAR=1"
    )
    computed = module._compute_parser()
    for text in TEXTS:
        assert answer(module.grammar(), text) == answer(computed, text)


@pytest.fixture()
def elsewhere(tmp_path, monkeypatch):
    """A file of its own for the tables, with the way in which the parser was made."""
    made = []
    monkeypatch.setattr(module, "_TABLES", tmp_path / "tables.json")
    kept, computed = Lark.load, module._compute_parser
    monkeypatch.setattr(Lark, "load", lambda f: made.append("kept") or kept(f))
    monkeypatch.setattr(module, "_compute_parser", lambda: made.append("computed") or computed())
    module.grammar.cache_clear()
    yield made
    module.grammar.cache_clear()


def test_written_tables_are_used(elsewhere):
    module.write_tables()
    del elsewhere[:]
    assert answer(module.grammar(), TEXTS[1]) == answer(module._compute_parser(), TEXTS[1])
    assert elsewhere[0] == "kept"


@pytest.mark.parametrize("text", [None, '{"origin": "lark 0.1 of another grammar"}'])
def test_without_tables_of_this_grammar_they_are_computed(elsewhere, text):
    if text is not None:
        module._TABLES.write_text(text)
    assert module.grammar().parse(TEXTS[0], start="statement")
    assert elsewhere == ["computed"]
