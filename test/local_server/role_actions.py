# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What users of a keyspace may want to do: each verb, each service, each request to the viewer."""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import re

from local_server.users import KEYSPACE, make_user, user_of
from mapping.room import T0, Drive
from nodes.children import start_client, start_node
from nodes.raw_publisher import RawPublisher, header_of, message
from sensor_msgs.msg import Image
from std_msgs.msg import String
from viewers import running_viewer

from cassandra_ros import RosCassandra
from cassandra_ros.cli import cassandra_bag
from cassandra_ros.errors import CassandraRosError
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.spool.segment_writer import SegmentWriter
from cassandra_ros.files.spool.spool_folder import SpoolFolder
from cassandra_ros.files.spool.spool_label import RunEnd, SpoolLabel
from cassandra_ros.messages.connection_header import api_connection, live_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.recording.topic_settings import RecordingSettings, settings_as_json
from cassandra_ros.store.tables.context_blob import NodeGraph, RunContext

SEC = 10**9
OTHER = "others"
"""A keyspace on which the roles have no rights."""
_DENIED = re.compile(
    r"user (?P<user>\S+) lacks the right (?P<right>[A-Z]+) on (?P<place>.+?); have an owner or "
    r"administrator run: (?P<remedy>GRANT (?P=right) ON (?P<on>.+?) TO \"?(?P=user)\"?) \("
)
_numbers = itertools.count(1)


class Refused(Exception):
    """What a program said that did not do what it was asked."""


def lacking(text, user):
    """Return the GRANT that an error asks for; fail unless it is AccessDenied, with its remedy."""
    found = _DENIED.search(" ".join(text.split()))
    assert found is not None, f"the error does not say which right {user} lacks: {text}"
    assert found["user"] == user, text
    return found


def cell_of(refusal, user):
    """Return a cell of the table: yes, or the right that the user lacks."""
    if refusal is None:
        return "yes"
    found = lacking(refusal, user)
    on = found["on"].replace('"', "")
    place = "" if on == f"KEYSPACE {KEYSPACE}" else f" on {on}"
    return f"`{found['right']}`{place}"


class Fleet:
    """A keyspace with some of everything, made by the administrator.

    Args:
        cqlshrc: File with the login of the administrator.
        users: Credentials file of each role's user.
        folder: Folder for files.
    """

    def __init__(self, cqlshrc, users, folder):
        self.cqlshrc, self.users, self.folder = cqlshrc, dict(users), folder
        self.admin = RosCassandra(cqlshrc=cqlshrc, keyspace=KEYSPACE)
        self.bag = self.write_bag("/of_bag")
        assert cassandra_bag.main(["import", "-q", str(self.bag), *self.login(None)]) == 0
        (run,) = self.admin.runs()
        context = RunContext({"robot": "husky"}, NodeGraph({}, {}, {}, {}))
        self.admin.catalog.keyspace.registry.put_context(run.writer, run.node, context)
        self.run = run.name
        self.topic("/a")

    def login(self, role):
        """Return the options with which the user of a role logs in; None = the administrator."""
        mine = ["--credentials", str(self.users[role])] if role else []
        return ["--cqlshrc", self.cqlshrc, *mine, "--keyspace", KEYSPACE]

    def make_other(self):
        """Make a keyspace on which the roles have no rights."""
        with RosCassandra(cqlshrc=self.cqlshrc, keyspace=OTHER) as store:
            self.topic("/foreign", store)

    def add_reader(self):
        """Make another user of the role viewer; return what it is called among the users."""
        self.users["reader"] = make_user(self.admin, "reader", "viewer", self.folder)
        return "reader"

    def topic(self, name=None, store=None):
        """Make a topic of three messages; return its name."""
        name = name or f"/t{next(_numbers)}"
        topic = (store or self.admin).addTopic(name)
        for n in range(3):
            topic.addData(String(str(n)), key=T0 + n * SEC)
        return name

    def add_drive(self):
        """Store a robot's scans, transforms and poses, and a picture."""
        Drive().store(self.admin, {"/tf", "/tf_static", "/scan", "/odom"})
        grey = Image(height=4, width=4, encoding="mono8", step=4, data=bytes(range(16)))
        self.admin.addTopic("/image").addData(grey, key=T0)

    def write_bag(self, topic):
        """Write a bag of ten messages; return its path."""
        path = self.folder / f"{topic.strip('/')}.bag"
        with BagWriter(path) as writer:
            number = writer.connection(api_connection(topic, definition_of(String), ""))
            for n in range(10):
                writer.write(number, T0 + n * SEC, message(String(str(n))))
        return path

    def copied_to(self):
        """Let the administrator copy /a; return the place, and the options of its own login."""
        place = f"{self.admin.cassandra.hosts[0]}:{self.admin.cassandra.port}/home"
        words = [place, "--to-cqlshrc", self.cqlshrc]
        assert cassandra_bag.main(["copy", "-q", "/a", "--to", *words, *self.login(None)]) == 0
        return words

    def spool(self):
        """Leave a run in a spool; return the folder."""
        number = next(_numbers)
        folder = self.folder / f"spool{number}"
        run = SpoolFolder(folder).begin(number)
        settings = settings_as_json(RecordingSettings())
        host = self.admin.cassandra
        address = f"{','.join(host.hosts)}:{host.port}"
        label = SpoolLabel(
            number, number, KEYSPACE, address, T0, name=f"left{number}", settings=settings
        )
        segment = SegmentWriter(run.new_file(), label)
        connection = live_connection(f"/spooled{number}", header_of(String))
        segment.append([(connection, T0 + n, n, message(String(str(n)))) for n in range(3)])
        segment.finish(RunEnd(T0 + SEC, {f"/spooled{number}": 3}, {}))
        segment.close()
        run.release()
        return folder


class User:
    """The user of a role, who does something to a fleet.

    Args:
        fleet: The keyspace.
        role: One of ROLES.
        roscore: Returns the master, for nodes.
    """

    def __init__(self, fleet, role, roscore):
        self.fleet, self.role, self._roscore = fleet, role, roscore
        self.name = user_of(role)
        self._open = contextlib.ExitStack()

    def attempt(self, work):
        """Do something; return what was said against it, None = it was done."""
        try:
            work(self)
        except (Refused, CassandraRosError) as exc:
            return str(exc)
        return None

    def verb(self, *words):
        """Run cassandra_bag as this user; return what it prints."""
        out, err = io.StringIO(), io.StringIO()
        login = self.fleet.login(self.role)
        if "--keyspace" in words:
            place = login.index("--keyspace")
            del login[place : place + 2]
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                status = cassandra_bag.main([words[0], *login, *map(str, words[1:])])
            except SystemExit as exc:
                raise AssertionError(f"{words}: {err.getvalue()}") from exc
        if status:
            raise Refused(err.getvalue() or out.getvalue())
        return out.getvalue()

    def topic(self):
        """Name of a topic that the administrator has made for this."""
        return self.fleet.topic()

    def event(self):
        """An event that the administrator has added for this."""
        return self.fleet.admin.addEvent(f"e{next(_numbers)}", 9.5)

    def left_topic(self):
        """Name of a topic that the administrator has made for this, and does not write to now."""
        with RosCassandra(cqlshrc=self.fleet.cqlshrc, keyspace=KEYSPACE) as store:
            return self.fleet.topic(store=store)

    def own_topic(self):
        """Name of a topic that this user has made."""
        with self.open() as store:
            return self.fleet.topic(store=store)

    def file(self, ending):
        """Path of a new file."""
        return self.fleet.folder / f"out{next(_numbers)}.{ending}"

    def open(self):
        """Return the keyspace, opened by this user."""
        credentials = str(self.fleet.users[self.role])
        return RosCassandra(cqlshrc=self.fleet.cqlshrc, credentials=credentials, keyspace=KEYSPACE)

    # ------------------------------------------------------------ programs that stay

    @functools.cached_property
    def roscore(self):
        return self._roscore()

    @functools.cached_property
    def client(self):
        return self._open.enter_context(start_client(self.roscore))

    @functools.cached_property
    def _query_server(self):
        name = f"asked_by_{self.role}"
        words = ["--allow-writes", f"__name:={name}", *self.fleet.login(self.role)]
        child = self._open.enter_context(start_node(self.roscore, "query_server", *words))
        child.await_line("serving keyspace")
        self._open.callback(child.end)
        return name

    @functools.cached_property
    def _viewer(self):
        store = self._open.enter_context(self.open())
        return self._open.enter_context(running_viewer(store, allow_writes=True))

    def service(self, name, /, **request):
        """Call a service of a query_server that logs in as this user."""
        return self._called(f"/{self._query_server}/{name}", request)

    def _called(self, service, request):
        answer = self.client.call(service, **request)
        if not answer.get("success"):
            raise Refused(answer.get("message") or str(answer))
        return answer

    def request(self, path, **parameters):
        """Ask a viewer that logs in as this user."""
        method = "POST" if path == "/api/events/add" else "GET"
        reply = self._viewer.ask(path, parameters, method)
        if reply.status >= 400:
            assert reply.status == 403, reply.text
            raise Refused(reply.json()["text"])

    def record(self, *words, services=()):
        """Run a recorder as this user; messages that it hears have to be stored.

        Args:
            words: Further options of the recorder.
            services: Names of services of it with their requests, which are called in this order.
        """
        topic = f"/heard{next(_numbers)}"
        name = f"recorder_of_{self.role}{next(_numbers)}"
        spool = ["--spool-dir", self.fleet.folder / f"spool_of_{name}"]
        words = [topic, *spool, *words, f"__name:={name}", *self.fleet.login(self.role)]
        with RawPublisher(self.roscore.uri, topic, header_of(String), f"/{name}_hears") as talker:
            with start_node(self.roscore, "recorder", *words) as child:
                try:
                    child.await_line("recording 1 topic")
                    talker.await_subscribers().publish(message(String("heard")))
                    for service, request in services:
                        self._called(f"/{name}/{service}", request)
                except AssertionError:
                    if child.process.poll() is None:
                        raise
                status = child.end()
                if status:
                    raise Refused(child.output)

    def play(self):
        """Play a topic as this user."""
        words = ["/a", "--immediate", *self.fleet.login(self.role), f"__name:=plays_{self.role}"]
        with start_node(self.roscore, "player", *words) as child:
            if child.wait():
                raise Refused(child.output)

    def close(self):
        """End what was started."""
        self._open.close()


VERBS = {
    "list": lambda user: user.verb("list"),
    "info": lambda user: user.verb("info"),
    "info --all": lambda user: user.verb("info", "--all"),
    "runs": lambda user: user.verb("runs"),
    "runs --params": lambda user: user.verb("runs", "--params", user.fleet.run),
    "runs set --label": lambda user: user.verb("runs", "set", user.fleet.run, "--label", "a=b"),
    "runs set --node-id": lambda user: user.verb(
        "runs", "set", user.fleet.run, "--node-id", user.role
    ),
    "import, into a stored topic": lambda user: user.verb("import", "-q", user.fleet.bag),
    "import, of a new topic": lambda user: user.verb(
        "import", "-q", user.fleet.write_bag(f"/new{next(_numbers)}")
    ),
    "export": lambda user: user.verb("export", "-q", user.file("bag"), "--topics", "/a"),
    "export --parquet": lambda user: user.verb(
        "export", "-q", user.file("lake"), "--parquet", "--topics", "/a"
    ),
    "verify": lambda user: user.verb("verify", user.fleet.bag),
    "verify --with": lambda user: user.verb(
        "verify", "--topics", "/a", "--with", *user.fleet.copied_to()
    ),
    "check": lambda user: user.verb("check", "/a"),
    "check --repair": lambda user: user.verb("check", "/a", "--repair"),
    "query SELECT": lambda user: user.verb("query", "select data from a"),
    "query DELETE": lambda user: change(user, f"delete from {user.topic()} where data = '1'"),
    "query TRUNCATE": lambda user: change(user, f"truncate {user.topic()}"),
    "query CREATE INDEX": lambda user: change(user, f"create index on {user.topic()} (data)"),
    "sql": lambda user: user.verb("sql", "select count(data) from a"),
    "plot": lambda user: user.verb("plot", "-o", user.file("png"), "select range_max from scan"),
    "thumbs": lambda user: user.verb("thumbs", "/image", "-o", user.file("png")),
    "cat": lambda user: user.verb("cat", "/a"),
    "index": lambda user: user.verb("index", "-q", user.topic(), "data"),
    "index --list": lambda user: user.verb("index", "/a", "--list"),
    "index --remove": lambda user: remove_index(user),
    "index --places": lambda user: user.verb("index", "-q", "--places"),
    "convert, of a topic of one's own": lambda user: user.verb(
        "convert", "-q", user.own_topic(), "--format", "binary"
    ),
    "convert, of another's topic": lambda user: user.verb(
        "convert", "-q", user.left_topic(), "--format", "binary"
    ),
    "copy": lambda user: user.verb("copy", "-q", user.topic(), "--to", *user.fleet.copied_to()),
    "copy --status": lambda user: user.fleet.copied_to() and user.verb("copy", "--status", "/a"),
    "spool list": lambda user: spool(user, "list"),
    "spool drain": lambda user: spool(user, "drain"),
    "spool export": lambda user: spool(user, "export"),
    "spool drop": lambda user: spool(user, "drop", "-y"),
    "map": lambda user: user.verb("map", "-q", "/scan", "-o", user.file("png")),
    "map --store": lambda user: user.verb("map", "-q", "/scan", "--store", "/maps"),
    "rename": lambda user: user.verb("rename", "-q", user.topic(), f"/renamed{next(_numbers)}"),
    "meta": lambda user: user.verb("meta", "/a"),
    "meta KEY=VALUE": lambda user: user.verb("meta", user.topic(), "place=roof"),
    "event add": lambda user: user.verb("event", "add", "bump", "-q", "--start", "9.5"),
    "event list": lambda user: user.verb("event", "list"),
    "event end": lambda user: user.verb("event", "end", user.event().key, "-q", "--end", "10.5"),
    "event delete": lambda user: user.verb("event", "delete", user.event().key, "-qy"),
    "delete, of messages": lambda user: user.verb(
        "delete", "-qy", user.topic(), "--end", str(T0 // SEC)
    ),
    "delete, of a topic of one's own": lambda user: user.verb("delete", "-qy", user.own_topic()),
    "delete, of another's topic": lambda user: user.verb("delete", "-qy", user.left_topic()),
    "delete --dry-run": lambda user: user.verb("delete", "--dry-run", user.topic()),
    "delete --messages, of a topic of one's own": lambda user: user.verb(
        "delete", "--messages", "-qy", user.own_topic()
    ),
    "delete --messages, of another's topic": lambda user: user.verb(
        "delete", "--messages", "-qy", user.left_topic()
    ),
    "retention": lambda user: user.verb("retention", "-qy", user.topic(), "--max-age", "1d"),
    "retention --dry-run": lambda user: user.verb(
        "retention", "--dry-run", "/a", "--max-age", "1d"
    ),
    "size": lambda user: user.verb("size"),
    "size FILE.bag": lambda user: user.verb("size", user.fleet.bag),
    "roles": lambda user: user.verb("roles"),
    "roles --apply": lambda user: user.verb("roles", "--apply"),
    "import, into a new keyspace": lambda user: user.verb(
        "import", "-q", user.fleet.bag, "--keyspace", f"new{next(_numbers)}"
    ),
    "list, of another keyspace": lambda user: user.verb("list", "--keyspace", OTHER),
}
"""Actions of cassandra_bag, named by the verb and what it is to do."""

SERVICES = {
    "getData": lambda user: user.service("getData", topic="/a", key=T0),
    "range": lambda user: user.service("range", topic="/a"),
    "executeCQL SELECT": lambda user: user.service("executeCQL", statement="select data from a"),
    "executeCQL CREATE INDEX": lambda user: user.service(
        "executeCQL", statement=f"create index on {user.topic()} (data)"
    ),
    "explainCQL": lambda user: user.service("explainCQL", statement="select data from a"),
    "sql": lambda user: user.service("sql", statement="select count(data) from a"),
    "info": lambda user: user.service("info"),
    "mark": lambda user: user.service("mark", name="bump"),
    "addData, to a stored topic": lambda user: user.service(
        "addData", topic="/a", yaml="data: x", key=T0 + 60 * SEC
    ),
    "addData, to a new topic": lambda user: user.service(
        "addData", topic=f"/added{next(_numbers)}", type="std_msgs/String", yaml="data: x"
    ),
    "removeData": lambda user: user.service("removeData", topic=user.topic(), key=T0),
    "lookupTransform": lambda user: user.service(
        "lookupTransform", target_frame="map", source_frame="base", time=T0 + 3 * SEC
    ),
}
"""Services of a query_server with --allow-writes that logs in as the user."""

RECORDER = {
    "start": lambda user: user.record(services=[("stop", {}), ("start", {})]),
    "stop": lambda user: user.record(services=[("stop", {})]),
    "pause": lambda user: user.record(services=[("pause", {})]),
    "resume": lambda user: user.record(services=[("pause", {}), ("resume", {})]),
    "status": lambda user: user.record(services=[("status", {})]),
    "snapshot": lambda user: user.record("--snapshot", "30s", services=[("snapshot", {})]),
    "mark": lambda user: user.record(services=[("mark", {"name": "bump"})]),
}
"""Services of a recorder that logs in as the user, which has to store what it hears."""

PLAYER = {"player": lambda user: user.play()}

REQUESTS = {
    "/api/keyspace": {},
    "/api/notes": {"time": T0},
    "/api/topics": {},
    "/api/runs": {},
    "/api/marks": {},
    "/api/events": {},
    "/api/events/add": {"name": "bump", "start": "9.5", "end": "9.6"},
    "/api/timeline": {},
    "/api/query": {"q": "select data from a"},
    "/api/explain": {"q": "select data from a"},
    "/api/complete": {"q": "select "},
    "/api/plot": {"q": "select range_max from scan"},
    "/api/studio": {},
    "/api/connections": {},
    "/api/messages": {"topics": "/a"},
    "/api/latest": {"topics": "/a"},
    "/window.bag": {"topics": "/a"},
    "/window.mcap": {"topics": "/a"},
    "/api/message": {"topic": "/a", "key": T0},
    "/api/image": {"topic": "/image", "key": T0},
    "/api/near": {"x": 0, "y": 0, "radius": 5},
    "/api/places": {},
    "/api/map": {"topic": "/scan"},
    "/api/openapi.json": {},
}
"""Requests to a viewer that logs in as the user, by path, with their parameters."""


def viewer_actions():
    """The requests to the viewer as actions, and one for another keyspace."""

    def of(path, parameters):
        return lambda user: user.request(path, **parameters)

    found = {path: of(path, parameters) for path, parameters in REQUESTS.items()}
    found["/api/topics?keyspace=…, of another keyspace"] = of("/api/topics", {"keyspace": OTHER})
    return found


def actions():
    """All actions: by program, by name, a function that does it as a user."""
    return {
        "cassandra_bag": VERBS,
        "query_server": SERVICES,
        "recorder": RECORDER,
        "player": PLAYER,
        "viewer": viewer_actions(),
    }


def change(user, statement):
    """Run a statement that changes something stored."""
    user.verb("query", "--allow-writes", statement)


def remove_index(user):
    """Remove an index that the administrator has made."""
    name = user.topic()
    user.fleet.admin.getTopic(name).createIndex("data")
    user.verb("index", "-q", name, "data", "--remove")


def spool(user, what, *words):
    """Do something with a spool in which a run was left; drained is what is gone from there."""
    folder = user.fleet.spool()
    (run,) = folder.iterdir()
    if what == "export":
        words = [run.name, user.file("mcap")]
    user.verb("spool", what, *words, "--spool-dir", folder)
