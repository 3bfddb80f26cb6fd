# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Print the ROS parameters of a recording as YAML, or set them on the running master.

  cassandra_bag params corridor > params.yaml
  cassandra_bag params corridor --namespace /move_base --load
  cassandra_bag params corridor --graph

They are the parameters that the parameter server had when the recording began, in the form that
rosparam load reads. --load sets each of them on the running parameter server; other parameters do
not change. Parameters of the master itself are left out: /rosdistro, /rosversion, /run_id and
/roslaunch. If several runs have the name, the last one is used.
"""

from __future__ import annotations

import argparse
from datetime import datetime
from typing import TYPE_CHECKING, Iterator, Mapping

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.errors import InvalidOption, MessageNotFound
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.store.tables.context_blob import Graph, NodeGraph, RunContext

MASTERS_OWN = ("/rosdistro", "/rosversion", "/run_id", "/roslaunch")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the run, the parameters, and the store."""
    add = parser.add_argument
    add("name", metavar="RUN", help="name of a run, or its writer id")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--load", action="store_true", help="set them on the running master")
    what.add_argument("--graph", action="store_true", help="print the graph of ROS nodes instead")
    add_json_option(parser)
    add("--namespace", metavar="NS", default="/", help="only parameters below NS (default: all)")
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print the parameters or the graph, or set the parameters."""
    with open_store(options) as ros_cas:
        context = ros_cas.runContext(options.name)
    if context is None:
        raise MessageNotFound(
            f"run {options.name!r} has no parameters: only runs that were recorded live have them"
        )
    show = print_json if options.json else _print_yaml
    if options.graph:
        show(_graph(context.graph))
    elif options.load:
        _load(context, options)
    else:
        show(_readable(_below(context.params, options.namespace)))
    return 0


def _below(params: Mapping[str, object], namespace: str) -> object:
    value: object = params
    for name in filter(None, namespace.split("/")):
        if not isinstance(value, Mapping) or name not in value:
            raise InvalidOption(f"the run has no parameter {namespace!r:.80}")
        value = value[name]
    return value


def _load(context: RunContext, options: argparse.Namespace) -> None:
    from cassandra_ros.messages.ros_master import set_parameters

    namespace = options.namespace
    prefix = "/" + "/".join(filter(None, namespace.split("/")))
    leaves = dict(_leaves(_below(context.params, namespace), prefix.rstrip("/")))
    masters_own = [name for name in leaves if _is_masters(name)]
    empty = [name for name, value in leaves.items() if value is None and name not in masters_own]
    count = set_parameters(
        (name, value) for name, value in leaves.items() if name not in {*masters_own, *empty}
    )
    if options.json:
        print_json({"set": count, "masters_own": masters_own, "without_value": empty})
        return
    print(f"{count} parameters set")
    if masters_own:
        print(f"left out, they are the running master's own: {shown(', '.join(masters_own), None)}")
    if empty:
        print(f"left out, they have no value: {shown(', '.join(empty), None)}")


def _is_masters(name: str) -> bool:
    return any(name == prefix or name.startswith(prefix + "/") for prefix in MASTERS_OWN)


def _leaves(value: object, name: str) -> Iterator[tuple[str, object]]:
    """Yield single parameters. Setting a whole mapping would delete other parameters in it."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _leaves(inner, f"{name}/{key}")
    else:
        yield name, value


def _readable(value: object) -> object:
    """Return a value of XML-RPC in the types of YAML."""
    import xmlrpc.client

    if isinstance(value, Mapping):
        return {name: _readable(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return [_readable(inner) for inner in value]
    if isinstance(value, xmlrpc.client.Binary):
        return value.data
    if isinstance(value, xmlrpc.client.DateTime):
        try:
            return datetime.strptime(str(value), "%Y%m%dT%H:%M:%S")
        except ValueError:
            return str(value)
    return value


def _graph(graph: NodeGraph) -> dict[str, object]:
    def of(node: str, users: Graph) -> list[str]:
        return sorted(name for name, nodes in users.items() if node in nodes)

    def typed(node: str, users: Graph) -> dict[str, str]:
        return {topic: graph.types.get(topic, "*") for topic in of(node, users)}

    return {
        node: {
            "publishes": typed(node, graph.publishers),
            "subscribes": typed(node, graph.subscribers),
            "services": of(node, graph.services),
        }
        for node in graph.nodes
    }


def _print_yaml(value: object) -> None:
    import yaml

    print(yaml.safe_dump(value, allow_unicode=True, default_flow_style=False), end="")
