# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""List recordings and imports, rename them, or print the ROS parameters of one.

  cassandra_bag runs
  cassandra_bag runs set monday.bag --name corridor --node-id husky --label site=lab
  cassandra_bag runs set ~/bags/ --node-id husky
  cassandra_bag runs --params corridor > params.yaml
  cassandra_bag runs --params corridor --namespace /move_base --load
  cassandra_bag runs --params corridor --graph

The column run shows the value for --run: a name, which several runs may have, or the writer id of a
run without name. The column id always shows the writer id. First and last are the times of its
first and last message, in UTC: when the drive was; --json also has the times of recording or
import. A run that has not ended, and has given no sign of life for a minute, is shown as
interrupted; its stored messages are counted.

'runs set RUN' gives a run that has ended another name, robot or labels. RUN is a name, a writer
id, or the path of an imported bag or of a folder of such bags; it may mean several runs. For
another robot the topics of the run are copied within the store, while other programs go on reading
them: it takes as long as converting them, and as much disk space. If it was killed, the same
command goes on.

--params prints the parameters that the parameter server had when a recording began, as YAML, in the
form that rosparam load reads. --load sets each of them on the running parameter server; other
parameters do not change. Parameters of the master itself are left out: /rosdistro, /rosversion,
/run_id and /roslaunch. If several runs have the name, the last one is used.
"""

from __future__ import annotations

import argparse
from datetime import datetime
from typing import TYPE_CHECKING, Iterator, Mapping, Sequence

from cassandra_ros.cli.json_answer import add_json_option, print_json, tell
from cassandra_ros.cli.options import add_store_options, open_store, read_pairs
from cassandra_ros.cli.safe_interrupt import SafeInterrupt
from cassandra_ros.cli.terminal_text import MessageBar, format_table, format_time
from cassandra_ros.errors import InvalidOption, MessageNotFound
from cassandra_ros.printable import shown
from cassandra_ros.recording.option_values import read_label

if TYPE_CHECKING:
    from cassandra_ros.store.tables.context_blob import Graph, NodeGraph, RunContext
    from cassandra_ros.store.tables.registry import Run

_HEADER = ("run", "id", "robot", "kind", "first", "last", "state", "messages", "lost", "labels")
_OF_SET = ("new_name", "node_id", "label", "remove_label", "quiet")
"""Options that go with set only, by their ``dest``."""
_OF_PARAMS = ("name", "load", "graph", "namespace")
"""Options that do not go with set, by their ``dest``."""
MASTERS_OWN = ("/rosdistro", "/rosversion", "/run_id", "/roslaunch")
"""Parameters, and namespaces, that describe the running master itself."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the run whose parameters are asked for, the form of the answer, and the store."""
    add = parser.add_argument
    text = "change runs (default: list all runs)"
    add("action", metavar="set", nargs="?", choices=("set",), help=text)
    text = "with set: the run to change (default: none)"
    add("run", metavar="RUN", nargs="?", help=text)
    add("--name", dest="new_name", metavar="NAME", help="with set: the new name (default: the old)")
    text = "with set: the robot that was recorded (default: the old)"
    add("--node-id", metavar="N", help=text)
    text = "with set: add a label, or replace its text; may be repeated"
    add("--label", metavar="K=V", type=read_label, action="append", default=[], help=text)
    text = "with set: remove this label; may be repeated"
    add("--remove-label", metavar="K", action="append", default=[], help=text)
    add("-q", "--quiet", action="store_true", help="with set: print errors only")
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
    if options.action is not None:
        return _set(options)
    options.parser.refuse_options(options, _OF_SET, "{} goes with 'runs set RUN'")
    if options.name is not None:
        return _tell_params(options)
    if options.load or options.graph or options.namespace != "/":
        options.parser.error("--load, --graph and --namespace go with --params RUN")
    with open_store(options) as ros_cas:
        runs = sorted(ros_cas.runs(times=True), key=lambda run: str(run.started))
    none = f"keyspace {options.keyspace} holds no run"
    tell(options, _facts(runs), _table(runs) if runs else none)
    return 0


def _set(options: argparse.Namespace) -> int:
    """Give runs another name, robot or labels, and print them."""
    labels: dict[str, str | None] = dict(read_pairs(options, "--label", options.label))
    labels.update(dict.fromkeys(options.remove_label))
    is_empty = options.new_name is None and options.node_id is None and not labels
    if options.run is None or is_empty:
        options.parser.error("say what is to be set: runs set RUN --name, --node-id or --label")
    options.parser.refuse_options(options, _OF_PARAMS, "{} does not go with set")
    run, options.run = options.run, None  # open_store would say that a name means several runs
    with open_store(options) as ros_cas, MessageBar("moving messages") as bar, SafeInterrupt(
        ros_cas.cassandra.outage
    ) as stop:

        def progress(topic: str, done: int, total: int) -> None:
            bar.reach(done, total)
            stop.check()

        runs = ros_cas.upkeep.setRuns(
            run, name=options.new_name, nodeID=options.node_id, labels=labels, progress=progress
        )
    tell(options, _facts(runs), _table(runs))
    return 0


def _facts(runs: Sequence[Run]) -> list[dict[str, object]]:
    # Without the labels that an import adds for its own use.
    return [{**vars(run), "labels": run.public_labels} for run in runs]


def _table(runs: Sequence[Run]) -> str:
    return format_table(_HEADER, [_row(run) for run in runs], right=("messages", "lost"))


def _row(run: Run) -> tuple[str, ...]:
    return (
        shown(run.name) or str(run.writer),
        str(run.writer),
        shown(run.node) or "-",
        run.kind,
        format_time(run.first_ns),
        format_time(run.last_ns),
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
    """Return a time of the registry, which is in UTC, as text; '-' for None."""
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
    """Return the parameters in a namespace, or one parameter; InvalidOption: it is missing."""
    value: object = params
    for name in filter(None, namespace.split("/")):
        if not isinstance(value, Mapping) or name not in value:
            raise InvalidOption(f"the run has no parameter {namespace!r:.80}")
        value = value[name]
    return value


def _load(context: RunContext, options: argparse.Namespace) -> None:
    """Set the parameters on the running master, but none of its own and none without a value."""
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
    """Yield name and value of each single parameter of a value with this name.

    Setting a whole mapping would delete other parameters in it.
    """
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
    """Return for each ROS node what it publishes, subscribes to and offers.

    The edges of the graph go from the name of a topic or a service to its nodes.
    """

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
