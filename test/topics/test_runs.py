# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Runs: which there are, how they began, what they lost; and every read of one of them alone."""

from __future__ import annotations

import xmlrpc.client

import pytest

from cassandra_ros.errors import InvalidName, InvalidOption, RunNotFound
from cassandra_ros.store.registry import Loss, LossKind, Run
from cassandra_ros.store.run_context import NodeGraph, RunContext, decode_context, encode_context

PARAMS = {
    "use_sim_time": True,
    "gains": {"p": 1.5, "i": 0, "d": -0.0, "table": [1, 2.0, "three", [], {}, None]},
    "robot_description": "<robot name='ä ☃ \ud83e'/>",
    "odd": {"$binary": "no", "nan": float("inf"), "": ""},
    "when": xmlrpc.client.DateTime("20260102T03:04:05"),
    "bytes": xmlrpc.client.Binary(b"\x00\xff"),
    "big": -(2**31),
}
GRAPH = NodeGraph({"/scan": ["/laser"]}, {"/scan": ["/rec", "/map"]}, {}, {"/scan": "a/B"})


def test_a_context_comes_back_as_it_was(connect, keyspace):
    with connect(keyspace=keyspace) as store:
        store.parts.side_tables.make()
        registry = store.parts.registry
        for writer, name in ((7, "corridor"), (8, "yard")):
            registry.put_run(Run("r", writer, "recording", name=name), started=True)
        registry.put_context(7, "r", RunContext(PARAMS, GRAPH))
        for run in ("corridor", 7, "7"):
            found = store.runContext(run)
            assert (found.params, found.graph) == (PARAMS, GRAPH)
            assert type(found.params["bytes"]) is xmlrpc.client.Binary
            assert type(found.params["big"]) is type(found.params["gains"]["i"]) is int
        assert found.graph.nodes == ["/laser", "/map", "/rec"]
        assert store.runContext("yard") is None
        with pytest.raises(RunNotFound, match="did you mean corridor"):
            store.runContext("coridor")
        for bad in (None, True, 1.5, b"x", 0, 2**31):
            with pytest.raises((InvalidName, RunNotFound)):
                store.runContext(bad)


@pytest.mark.parametrize("bad", [{"a": {1: 2}}, {"a": object()}, {"a": {2}}])
def test_what_no_parameter_server_holds_is_refused(bad):
    with pytest.raises(InvalidOption, match="/a is a"):
        encode_context(RunContext(bad))


def test_parameters_are_nested_as_deep_as_can_be_read_back():
    deep: object = 1
    for _ in range(150):
        deep = [deep]
    context = RunContext({"a": deep})
    assert decode_context(encode_context(context)) == context
    for _ in range(100):
        deep = [deep]
    with pytest.raises(InvalidOption, match="nested deeper"):
        encode_context(RunContext({"a": deep}))


def test_losses_are_kept_beside_the_data(connect, keyspace):
    kinds = list(LossKind)
    with connect(keyspace=keyspace) as store:
        store.parts.side_tables.make()
        registry = store.parts.registry
        assert store.losses() == []
        registry.put_run(Run("r", 7, "recording", name="one"))
        first = Loss("/scan", "r", 7, kinds[0], 10, 20, 3)
        more = [Loss("/scan", "", 8, kind, 30, 40, 0) for kind in kinds]
        for loss in [first, first, *more, Loss("tf", "r", 8, kinds[1], 5, 90, 1)]:
            registry.put_loss(loss)
        assert len(store.losses()) == len(kinds) + 2
        registry.put_loss(Loss("/scan", "r", 7, kinds[0], 10, 25, 9))
        assert store.losses(run="one") == [Loss("/scan", "r", 7, kinds[0], 10, 25, 9)]
        assert {loss.kind for loss in store.losses("scan", nodeID="")} == set(kinds)
        assert [loss.topic for loss in store.losses(key=41)] == ["tf"]
        assert [loss.topic for loss in store.losses(["/tf", "nowhere"], to_key=5)] == ["tf"]
        assert store.losses(key=91) == store.losses(to_key=4) == []
