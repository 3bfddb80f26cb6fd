# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The layers: imports point one way, and what is foreign has one door."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "cassandra_ros"

# Known to all; they know only each other.
GROUND = {
    "errors",
    "keys",
    "metadata",
    "arguments",
    "printable",
    "installation",
    "read",
    "own_files",
    "option",
    "quantities",
    "shared_options",
    "yaml_text",
}

# The rooms, lowest first; a room imports no room that comes after it.
ROOMS = (
    *("messages", "store", "query", "places", "topics", "client", "stores", "files", "recording"),
    *("playing", "local_server", "viewing", "nodes", "cli"),
)

# Room, or folder in it that has an order of its own -> the ones that it may use.
STORE = {"store/connection", "store/tables", "store/blocks", "store/rows"}
MESSAGES = {"messages", "messages/formats"}
TOPICS = {
    *("topics", "places", "places/transforms", "query", "query/arrays"),
    *STORE,
    *MESSAGES,
}
KEPT = {*TOPICS, "topics/overview", "topics/upkeep"}
CLIENT = {*KEPT, "client", "client/sql"}
BELOW = {
    "errors": set(),
    "keys": {"errors"},
    "metadata": {"errors", "keys"},
    "arguments": {"errors", "keys", "metadata"},
    "printable": set(),
    "read": {"keys"},
    "installation": {"errors"},
    "own_files": set(),
    "option": set(),
    "quantities": {"errors"},
    "shared_options": {"arguments", "metadata", "option", "quantities"},
    "yaml_text": {"errors"},
    "messages": set(),
    "messages/formats": {"messages"},
    "store/connection": set(),
    "store/tables": {"store/connection"},
    "store/blocks": {"store/tables", "store/connection"},
    "store/rows": STORE,
    "query": {"messages"},
    "query/arrays": {"query", "messages"},
    "places/transforms": {"query", "messages"},
    "places": {"places/transforms", "query", "query/arrays", "store/tables", "messages"},
    "topics": TOPICS,
    "topics/overview": TOPICS,
    "topics/upkeep": {*TOPICS, "topics/overview"},
    "client/sql": TOPICS,
    "client": {*KEPT, "client/sql"},
    "client/spark": {*TOPICS, "client"},
    "stores/copying": {*KEPT, "client"},
    "stores/fleet": {*TOPICS, "client"},
    "files/bag": {*TOPICS, "topics/overview", "client", "stores/fleet"},
    "files/spool": {"files/bag", "store/tables", "messages"},
    "recording": {"files/spool", "stores/copying", *TOPICS},
    "playing": {*TOPICS, "topics/overview", "stores/fleet"},
    "playing/history": {"recording", *TOPICS},
    "local_server": set(),
    "viewing/mapping": {*TOPICS, "topics/overview", "client"},
    "viewing/drawing": {"viewing/mapping", "topics/overview", "client", *TOPICS},
    "viewing": {
        *("viewing/drawing", "viewing/mapping", "files/bag", "stores/fleet"),
        *CLIENT,
    },
    "nodes": {
        *("recording", "playing", "playing/history", "stores/copying", "stores/fleet", "client"),
        *("topics/overview", "client/sql"),
        *TOPICS,
    },
    "cli": {
        *("viewing", "viewing/drawing", "viewing/mapping", "nodes", "recording", "playing"),
        *("files/bag", "files/spool", "local_server", "stores/copying", "stores/fleet"),
        *CLIENT,
    },
}

# Foreign module -> the layers, or files, that may import it. Longest name first.
DOORS = {
    "cassandra_ros.msg": {"nodes", "cli"},
    "cassandra_ros.srv": {"nodes", "cli"},
    "rospy": {"nodes"},
    "rostopic": {"nodes"},
    "rosgraph": {"messages/ros_master.py"},
    "cassandra": {"store"},
    "genpy": {"messages"},
    "genmsg": {"messages"},
    "roslib": {"messages"},
    "rosbag": {"files"},
    "lz4": {"files"},
    "mcap": {"files"},
    "isal": {"store/tables/checksum.py"},
    "tf2_py": {"places"},
    "geometry_msgs": {"places"},
    "lark": {"query"},
    "pyspark": {"client/spark"},
    "argparse": {"cli"},
    "aiohttp": {"viewing"},
    "matplotlib": {"viewing/drawing"},
    "PIL": {"viewing/drawing"},
}


@functools.lru_cache(maxsize=None)
def modules():
    return sorted(PACKAGE.rglob("*.py"))


@functools.lru_cache(maxsize=None)
def tree_of(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def name_of(path):
    return path.relative_to(PACKAGE).as_posix()


def room_of(name):
    """The part of the package with an order of its own in which a file lies, by its name."""
    first, *rest = name.replace(".py", "").split("/")
    inner = f"{first}/{rest[0]}" if rest else first
    return inner if inner in BELOW else first


def layer_of(path):
    return room_of(name_of(path))


def imports(path):
    """Full names of all that a file imports, inside functions too."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name_of(path)}: relative import"
            if node.module == "cassandra_ros":
                yield from (f"cassandra_ros.{alias.name}" for alias in node.names)
            else:
                yield node.module


def test_every_folder_has_its_place_among_the_layers():
    layers = {layer_of(path) for path in modules()} - {"__init__"}
    assert layers - set(ROOMS) == set(BELOW) - set(ROOMS)
    assert {path.parent.name for path in PACKAGE.glob("*/__init__.py")} == set(ROOMS)
    for room, used in BELOW.items():
        if room not in GROUND:
            first = ROOMS.index(room.split("/")[0])
            assert all(ROOMS.index(other.split("/")[0]) <= first for other in used), room


@pytest.mark.suite("all", "it parses all sources")
def test_imports_point_downwards():
    for path in modules():
        layer = layer_of(path)
        if path.name == "__init__.py" and layer not in BELOW or layer == "__init__":
            continue  # the package's own only names what is public
        allowed = BELOW[layer] | GROUND | {layer} if layer not in GROUND else BELOW[layer] | {layer}
        for imported in imports(path):
            if not imported.startswith("cassandra_ros."):
                continue
            used = room_of(imported.split(".", 1)[1].replace(".", "/"))
            if used in ("msg", "srv"):
                continue
            assert used in allowed, f"{name_of(path)} imports {imported}, which lies above {layer}"


@pytest.mark.suite("all", "it parses all sources")
def test_foreign_modules_come_in_by_their_door():
    for path in modules():
        for imported in imports(path):
            for module, doors in DOORS.items():
                if imported == module or imported.startswith(module + "."):
                    places = {layer_of(path), layer_of(path).split("/")[0], name_of(path)}
                    assert places & doors, f"{name_of(path)} imports {imported}: only in {doors}"


@pytest.mark.suite("all", "it parses all sources")
def test_only_command_lines_print():
    for path in modules():
        if layer_of(path) == "cli":
            continue
        calls = [
            node.lineno
            for node in ast.walk(tree_of(path))
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print"
        ]
        assert not calls, f"{name_of(path)} prints in lines {calls}"


@pytest.mark.suite("all", "it parses all sources")
def test_text_from_outside_is_never_code():
    for path in modules():
        for imported in imports(path):
            assert imported.split(".")[0] not in ("pickle", "marshal", "shelve", "dill"), path
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.Call):
                called = getattr(node.func, "id", "")
                assert called not in ("eval", "exec", "compile", "__import__"), path
                dotted = ast.unparse(node.func)
                assert dotted not in ("yaml.load", "os.system"), f"{name_of(path)}: {dotted}"


@pytest.mark.suite("all", "it parses all sources")
def test_every_module_says_what_it_is():
    for path in modules():
        text = path.read_text(encoding="utf-8")
        first, second = text.splitlines()[:2]
        assert first == "# SPDX-FileCopyrightText: 2026 cassandra_ros authors", path
        assert second == "# SPDX-License-Identifier: BSD-3-Clause", path
        assert ast.get_docstring(tree_of(path)), f"{name_of(path)} has no docstring"


def test_each_room_says_what_it_imports():
    """The sentence in the room's __init__.py agrees with BELOW, as far as rooms go."""
    used = {
        room: {
            other.split("/")[0]
            for inner, others in BELOW.items()
            if inner.split("/")[0] == room
            for other in others
        }
        - {room}
        for room in ROOMS
    }
    for room in ROOMS:
        prose = " ".join(ast.get_docstring(tree_of(PACKAGE / room / "__init__.py")).split())
        sentence = re.findall(r"This room imports ([^.;]*)", prose)
        assert len(sentence) == 1, room
        told = set(re.findall(r"(?:^|[ (])(\w+)/", sentence[0])) & set(ROOMS)
        for other in re.findall(r"what (\w+)/ imports", sentence[0]):
            told |= used[other]
        if sentence[0].startswith("all others"):
            told = set(ROOMS) - {room}
        assert told == used[room], f"{room}: {sentence[0]}"


# In the prose of messages/tree: functions.
FUNCTIONS = {"read", "build"}


def test_the_prose_of_a_folder_names_what_is_there():
    formats = {path.stem for path in (PACKAGE / "messages/formats").glob("*.py")}
    for init in (path for path in modules() if path.name == "__init__.py"):
        prose = ast.get_docstring(tree_of(init))
        there = {path.stem for path in init.parent.rglob("*")}
        for name in re.findall(r"``([a-z_0-9]+)/?``", prose):
            assert name in there | formats | FUNCTIONS, f"{name_of(init)}: {name}"
        for name in re.findall(r"\b\w+(?:/\w+)+\.py\b", prose):
            assert (PACKAGE / name).is_file(), f"{name_of(init)}: {name}"


def test_no_module_is_called_after_nothing():
    vague = {"utils", "util", "common", "helpers", "helper", "misc", "msg", "srv"}
    for path in PACKAGE.rglob("*"):
        assert path.stem not in vague, name_of(path)


# Module -> why it may stand in several rooms.
SAME_KIND = {
    "__init__.py": "each room has one",
    "player.py": "the program in cli/, and the class in nodes/ that it starts",
    "recorder.py": "the program in cli/, and the class in nodes/ that it starts",
    "replicator.py": "the program in cli/, and the class in stores/copying/ that it starts",
}


def test_no_file_name_stands_in_two_rooms():
    rooms = {}
    for path in modules():
        rooms.setdefault(path.name, []).append(name_of(path))
    several = {name: paths for name, paths in rooms.items() if len(paths) > 1}
    unknown = {name: paths for name, paths in several.items() if name not in SAME_KIND}
    assert not unknown, f"rename what is not the same kind of thing: {unknown}"
    assert set(several) == set(SAME_KIND), "the list names what stands in one room alone"


# Public in all but their name: the API of named tuples, and types of the standard library.
PUBLIC = {"_replace", "_asdict", "_make", "_fields", "_repr_html_"}
STANDARD = {"argparse._ActionsContainer", "argparse._ArgumentGroup", "hashlib._Hash", "os._exit"}
STANDARD |= {"signal._HANDLER"}


def is_private(name):
    return name.startswith("_") and not name.startswith("__") and name not in PUBLIC


def foreign_names(tree):
    """Names that a file imports from other packages than ours."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and not node.module.startswith("cassandra_ros"):
            yield from (alias.asname or alias.name for alias in node.names)


def own_names(tree):
    """Names that a file defines: functions, classes, variables, attributes of self."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            yield node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            if ast.unparse(node.value) in ("self", "cls"):
                yield node.attr


def inherited_names(tree):
    """Private names that classes with a foreign base use of themselves, or define."""
    foreign = set(foreign_names(tree))
    for cls in ast.walk(tree):
        if isinstance(cls, ast.ClassDef) and foreign & {ast.unparse(base) for base in cls.bases}:
            for node in ast.walk(cls):
                if isinstance(node, ast.Attribute) and ast.unparse(node.value) in ("self", "cls"):
                    yield node.attr


def private_uses(path):
    """Private names of other packages that a file uses."""
    tree = tree_of(path)
    used = {name for name in foreign_names(tree) if is_private(name)}
    used.update(inherited_names(tree))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) not in ("self", "cls"):
            if ast.unparse(node) not in STANDARD:
                used.add(node.attr)
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "getattr":
            used.add(getattr(node.args[1], "value", ""))
    return {name for name in used if is_private(str(name))} - set(own_names(tree))


def listed_private_names():
    """(file, name) of the table in doc/internals.md."""
    text = (ROOT / "doc" / "internals.md").read_text(encoding="utf-8")
    table = text.split("## Private names")[1].split("\n## ")[0]
    for line in table.splitlines():
        cells = line.split("|")
        if len(cells) == 6 and "`" in cells[1]:
            for file in re.findall(r"`([\w/]+\.py)`", cells[1]):
                yield from ((file, name) for name in re.findall(r"`(\w+)`", cells[2]))


@pytest.mark.suite("all", "it parses all sources")
def test_private_names_of_other_packages_are_listed():
    listed = set(listed_private_names())
    ours = {("messages/classes.py", "_definition"), ("messages/definition.py", "_definition")}
    ours.add(("messages/classes.py", "_generated_for"))
    for path in modules():
        for name in private_uses(path):
            assert (name_of(path), name) in listed | ours, f"list {name} in doc/internals.md"
    for file, name in listed:
        text = (PACKAGE / file).read_text(encoding="utf-8")
        assert re.search(rf"\b{name}\b", text), f"{file} uses {name} no more"
