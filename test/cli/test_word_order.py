# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The words of a command line: options that are given twice, and words in any order."""

from __future__ import annotations

import argparse

import pytest

from cassandra_ros.cli import (
    cassandra_bag,
    local_cassandra,
    player,
    query_server,
    recorder,
    replicator,
    viewer,
)
from cassandra_ros.cli.completion import PrintCompletion
from cassandra_ros.cli.parameters import parameter_words

PROGRAMS = {
    module.__name__.rpartition(".")[2]: module
    for module in (
        cassandra_bag,
        local_cassandra,
        player,
        query_server,
        recorder,
        replicator,
        viewer,
    )
}
VALUES = ("5", "/a", "a=b", "/a: x = 1", "/a:5", "/a:=/b", "ONE", "packed", "first", "oldest")
VALUES += ("5s", "none", "csv", "100x100", "1G", "")
"""Each option that takes one value accepts one of these."""
LISTS = {
    "--allow-origin",
    "--exclude",
    "--keep",
    "--label",
    "--map",
    "--pause-topics",
    "--rate-limit",
    "--rates",
    "--remove-label",
    "--regex",
    "--remove",
    "--store",
    "--topics",
    "--value",
    "--where",
}
"""The options that may be given several times; map --store, meta and index --remove are others."""


def verbs():
    """Yield a line's first words, the parser of these, and the program's."""
    for name, module in PROGRAMS.items():
        program = module.make_parser()
        yield (name,), program, program
        for action in program._actions:
            if isinstance(action, argparse._SubParsersAction):
                for verb, parser in action.choices.items():
                    yield (name, verb), parser, program


def refused(program, line, capsys):
    """Return the last line on standard error, if the program ends with status 2, else ''."""
    try:
        program.parse_args(line)
    except SystemExit as exc:
        assert exc.code == 2
        return capsys.readouterr().err.splitlines()[-1]
    return ""


@pytest.mark.parametrize(
    "words, parser, program", [*verbs()], ids=lambda w: " ".join(w) if isinstance(w, tuple) else ""
)
def test_an_option_given_twice_is_a_list_or_is_refused(words, parser, program, capsys):
    for action in parser._actions:
        if not action.option_strings or action.nargs == 0:
            continue
        option = action.option_strings[-1]
        if isinstance(action, PrintCompletion):  # the first one ends the program
            continue
        if isinstance(action, (argparse._AppendAction, argparse._ExtendAction)):
            assert option in LISTS
            continue
        count = action.nargs if isinstance(action.nargs, int) else 1
        lines = [[option, *[value] * count] * 2 for value in VALUES]
        errors = [refused(program, [*words[1:], *line], capsys) for line in lines]
        assert any(f"{option} is given twice: give it once" in each for each in errors), option


@pytest.mark.parametrize(
    ("line", "once", "dest"),
    [
        ("player -x A -x B", "player -x A -x B", "exclude"),
        ("recorder -a -x A -x B", "recorder -x A -a -x B", "exclude"),
        ("player --topics A --topics B", "player --topics A B", "more"),
        ("player --pause-topics A --pause-topics B", "player --pause-topics A B", "pause_topics"),
        ("cassandra_bag import f --topics A --topics B", "cassandra_bag import f --topics A B", ""),
        ("cassandra_bag export f --topics A --topics B", "cassandra_bag export f --topics A B", ""),
        ("cassandra_bag verify f --topics A --topics B", "cassandra_bag verify f --topics A B", ""),
        ("cassandra_bag size --topics A --topics B", "cassandra_bag size --topics A B", ""),
        (
            "cassandra_bag size --rates A:1 --rates B:2",
            "cassandra_bag size --rates A:1 B:2",
            "rates",
        ),
        ("cassandra_bag list -e A -e B", "cassandra_bag list -e A --regex B", "regex"),
    ],
)
def test_a_list_in_one_option_or_in_several_is_the_same(line, once, dest):
    def read(text):
        program, *words = text.split()
        found = PROGRAMS[program].make_parser().parse_args(words)
        return getattr(found, dest or "topics")

    assert read(line) == read(once)
    assert len(read(line)) == 2


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("query q --json --output csv", "--json and --output say the same: give one of them"),
        ("query q --output csv --json", "--output and --json say the same: give one of them"),
        ("event add e --start 1 --label a=1 --label a=2", "--label: 'a' is given twice"),
        ("event add e --start 1 --value a=1 --value a=2", "--value: 'a' is given twice"),
        ("verify f.bag --content --map /a:=/b --map /a:=/c", "--map: '/a' is given twice"),
        ("meta /a site=1 site=2", "'site' is given twice"),
        ("meta /a site=1 --remove site", "'site' is given twice"),
        ("size --rates /a:1 --rates /a:2", "--rates: '/a' is given twice"),
        ("cat --where /a:x=1 --where /a:y=1", "'/a' is given twice: join them with AND or OR"),
    ],
)
def test_two_values_for_one_name_are_refused(rosCas, call, line, text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rosCas.addTopic("/a", msg_type="std_msgs/String")
    status, _, err = call(*line.split())
    assert (status, text in err) == (2, True), err


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--label", "a=1", "--label", "a=2"), "--label: 'a' is given twice"),
        (("--rate-limit", "5", "--rate-limit", "6"), "--rate-limit: '.*' is given twice"),
        (("--where", "/a: x = 1", "--where", "/a: x = 2"), "join the conditions with AND or OR"),
    ],
)
def test_two_settings_of_one_pattern_are_refused_by_the_recorder(words, text, capsys):
    parser = recorder.make_parser()
    with pytest.raises(SystemExit) as ended:
        recorder.read_options(parser, parser.parse_args(["-a", *words]))
    assert ended.value.code == 2
    assert text in capsys.readouterr().err


def test_parameters_of_a_node_are_no_second_value():
    parser = recorder.make_parser()
    parameters = {"keyspace": "a", "ttl": "1h", "exclude": ["/c", "/d"], "label": "x=1"}
    line = ["/t", "--keyspace", "b", "-x", "/e"]
    parser.parse_args(line)
    words = parameter_words(parser, parameters)
    options = parser.parse_args([*words, *line])
    assert (options.keyspace, options.ttl, options.labels) == ("b", 3600, [("x", "1")])
    assert options.exclude == ["/c", "/d", "/e"]
    chosen = recorder.read_options(parser, options)
    assert [topic for topic in ("/a", "/c", "/d", "/e") if chosen.excludes(topic)] == [
        *("/c", "/d", "/e")
    ]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (["spool", "drain", "-y", "RUN"], {"action": "drain", "runs": ["RUN"], "yes": True}),
        (["spool", "-y", "drain", "A", "-q", "B"], {"action": "drain", "runs": ["A", "B"]}),
        (["event", "delete", "--dry-run", "NAME"], {"event": "NAME", "dry_run": True}),
        (["event", "--json", "delete", "--", "-x"], {"event": "-x", "json": True}),
        (["event", "delete", "--dry-run", "--", "-x"], {"event": "-x", "dry_run": True}),
        (["event", "add", "--start", "5", "--", "-x"], {"event": "-x", "start": "5"}),
        (["event", "add", "-y", "--start", "-5", "5"], {"event": "5", "start": "-5"}),
        (["cat", "/a", "-n", "5", "/b", "--event=-x"], {"topics": ["/a", "/b"], "event": "-x"}),
        (["query", "--json", "q", "-0.5", "-f", "x"], {"params": ["-0.5", "x"], "force": True}),
        (["query", "q", "--", "--json", "-x"], {"params": ["--json", "-x"], "output": None}),
        (["query", "-l", "5", "5"], {"statement": "5", "limit": 5, "params": []}),
        (["plot", "a", "-o", "x.png", "b"], {"statements": ["a", "b"], "output": "x.png"}),
        (["index", "/a", "-q", "x"], {"topics": ["/a"], "field": "x", "quiet": True}),
        (["meta", "/a", "--remove", "x", "a=b"], {"keys": [("a", "b")], "remove": ["x"]}),
        (["runs", "--json", "--"], {"json": True}),
        (["list", "--", "-x"], {"patterns": ["-x"]}),
        (["export", "--topics", "/a", "-o", "f", "--topics", "/b"], {"topics": ["/a", "/b"]}),
        (["delete", "/a", "-yq", "/b"], {"topics": ["/a", "/b"], "yes": True, "quiet": True}),
        (["delete", "/a", "--dry", "/b"], {"topics": ["/a", "/b"], "dry_run": True}),
    ],
    ids=" ".join,
)
def test_words_may_come_in_any_order(line, expected):
    options = vars(cassandra_bag.make_parser().parse_args(line))
    assert {name: options[name] for name in expected} == expected
    assert all(type(word) is str for word in options.get("topics") or ())


def test_words_of_the_programs_may_come_in_any_order():
    options = recorder.make_parser().parse_args(["/a", "-x", "/c", "/b", "-q", "/d"])
    assert (options.topics, options.exclude, options.quiet) == (["/a", "/b", "/d"], ["/c"], True)
    options = player.make_parser().parse_args(["-r", "2", "/a", "-l", "/b"])
    assert (options.topics, options.rate, options.loop) == (["/a", "/b"], 2.0, True)
    options = local_cassandra.make_parser().parse_args(["replace", "--dir", "d", "2"])
    assert (options.number, options.dir) == (2, "d")


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (
            "event delete -x",
            "-x; what begins with - and is not an option goes after --, as in: -- -x",
        ),
        ("event delete --dryrun x", "unrecognized arguments: --dryrun: did you mean --dry-run?"),
        ("export a.bag --evnt=x", "unrecognized arguments: --evnt=x: did you mean --event?"),
        ("cat --event -x", "--event: expected one argument; one that begins with - is given as "),
        ("rename /a /b /c", "unrecognized arguments: /c"),
        ("runs", ""),
    ],
)
def test_what_is_not_understood_names_the_remedy(line, text, capsys):
    verb = line.split()[0]
    err = refused(cassandra_bag.make_parser(), line.split(), capsys)
    assert text in err
    assert not err or err.endswith(f" (see cassandra_bag {verb} --help)")
