# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""List recordings and imports, or print the ROS parameters of one, or set them on the master.

  cassandra_bag runs
  cassandra_bag runs --params corridor > params.yaml
  cassandra_bag runs --params corridor --namespace /move_base --load
  cassandra_bag runs --params corridor --graph

The column run shows the value for --run: a name, which several runs may have, or the writer id of a
run without name. The column id always shows the writer id. Start and end are the times of recording
or import, in UTC. A run that has not ended, and has given no sign of life for a minute, is shown as
interrupted; its stored messages are counted.

--params prints the parameters that the parameter server had when a recording began, as YAML, in the
form that rosparam load reads. --load sets each of them on the running parameter server; other
parameters do not change. Parameters of the master itself are left out: /rosdistro, /rosversion,
/run_id and /roslaunch. If several runs have the name, the last one is used.
"""

from __future__ import annotations

import argparse
from datetime import datetime
from typing import TYPE_CHECKING, Iterator, Mapping

from cassandra_ros.cli.json_answer import add_json_option, print_json
from cassandra_ros.cli.options import add_store_options, open_store
from cassandra_ros.cli.terminal_text import format_table
from cassandra_ros.errors import InvalidOption, MessageNotFound
from cassandra_ros.printable import shown

if TYPE_CHECKING:
    from cassandra_ros.store.tables.context_blob import Graph, NodeGraph, RunContext
    from cassandra_ros.store.tables.registry import Run

_HEADER = ("run", "id", "robot", "kind", "start", "end", "state", "messages", "lost", "labels")
MASTERS_OWN = ("/rosdistro", "/rosversion", "/run_id", "/roslaunch")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the run whose parameters are asked for, the form of the answer, and the store."""
    add = parser.add_argument
    text = "print the ROS parameters of this run, a name or a writer id (default: list the runs)"
    add("--params", dest="name", metavar="RUN", help=text)
    what = parser.add_mutually_exclusive_group()
    text = "with --params: set them on the running master"
    what.add_argument("--load", action="store_true", help=text)
    text = "with --params: print the graph of ROS nodes instead"
    what.add_argument("--graph", action="store_true", help=text)
    text = "with --params: only parameters below NS (default: all)"
    add("--namespace", metavar="NS", default="/", help=text)
    add_json_option(parser)
    add_store_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print a line for each run, the oldest first, or do what --params says."""
    if options.name is not None:
        return _tell_params(options)
    if options.load or options.graph or options.namespace != "/":
        options.parser.error("--load, --graph and --namespace go with --params RUN")
    with open_store(options) as ros_cas:
        runs = sorted(ros_cas.runs(), key=lambda run: str(run.started))
    if options.json:
        # Without the labels that an import adds for its own use.
        print_json([{**vars(run), "labels": run.public_labels} for run in runs])
    elif runs:
        print(format_table(_HEADER, [_row(run) for run in runs], right=("messages", "lost")))
    else:
        print(f"keyspace {options.keyspace} holds no run")
    return 0


def _row(run: Run) -> tuple[str, ...]:
    return (
        shown(run.name) or str(run.writer),
        str(run.writer),
        shown(run.node) or "-",
        run.kind,
        time_of(run.started),
        time_of(run.ended),
        run.state,
        str(sum(run.stored.values())),
        str(sum(run.lost.values())),
        _labels(run.public_labels) or "-",
    )


def _labels(labels: Mapping[str, str]) -> str:
    # A label may have no value.
    named = sorted(labels.items())
    return shown(", ".join(f"{k}={v}" if v else k for k, v in named))


def time_of(when: datetime | None) -> str:
    """Return a time of a run as text, in UTC; '-' for None."""
    return "-" if when is None else f"{when:%Y-%m-%dT%H:%M:%SZ}"


def _tell_params(options: argparse.Namespace) -> int:
    """Print the parameters or the graph of a run, or set the parameters."""
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
    masters = [name for name in leaves if _is_masters(name)]
    empty = [name for name, value in leaves.items() if value is None and name not in masters]
    count = set_parameters(
        (name, value) for name, value in leaves.items() if name not in {*masters, *empty}
    )
    if options.json:
        print_json({"set": count, "masters_own": masters, "without_value": empty})
        return
    print(f"{count} parameters set")
    if masters:
        print(f"left out, they are the running master's own: {shown(', '.join(masters), None)}")
    if empty:
        print(f"left out, they have no value: {shown(', '.join(empty), None)}")


def _is_masters(name: str) -> bool:
    return any(name == above or name.startswith(f"{above}/") for above in MASTERS_OWN)


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
    def names_of(node: str, edges: Graph) -> list[str]:
        return sorted(name for name, nodes in edges.items() if node in nodes)

    def types_of(node: str, edges: Graph) -> dict[str, str]:
        return {topic: graph.types.get(topic, "*") for topic in names_of(node, edges)}

    return {
        node: {
            "publishes": types_of(node, graph.publishers),
            "subscribes": types_of(node, graph.subscribers),
            "services": names_of(node, graph.services),
        }
        for node in graph.nodes
    }


def _print_yaml(answer: object) -> None:
    import yaml

    print(yaml.safe_dump(answer, allow_unicode=True, default_flow_style=False), end="")
