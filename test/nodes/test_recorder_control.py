# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A recorder that is controlled while it runs, and the effect of its options on messages."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import subprocess
import sys
import threading
import xmlrpc.client

import pytest
from nodes.children import PROGRAMS, Child, await_true, services_of, start_client, told
from nodes.raw_publisher import RawPublisher, header_of, message
from rosgraph_msgs.msg import Log
from std_msgs.msg import Int32, String

from cassandra_ros.cli.parameters import parameter_words
from cassandra_ros.cli.recorder import make_parser, read_options
from cassandra_ros.nodes.recorder_services import OTHER_SERVICES, TOPIC_SERVICES
from cassandra_ros.store.tables.registry import LossKind


def text(n):
    return message(String(str(n)))


@pytest.fixture(scope="module")
def client(roscore):
    with start_client(roscore) as client:
        yield client


def publisher(roscore, topic, msg_class=String, name="/raw", **fields):
    return RawPublisher(roscore.uri, topic, header_of(msg_class, name, **fields), name)


def topic_in(status, name):
    (found,) = [topic for topic in status["topics"] if topic["topic"] == name]
    return found


def await_received(client, name, count):
    def received():
        topics = client.call("/recorder/status")["topics"]
        return sum(t["received"] for t in topics if t["topic"] == name) >= count

    await_true(received)


def data_of(rosCas, topic, run=None):
    return [row.message().data for row in rosCas.getTopic(topic).rows(run=run)]


@pytest.mark.suite("test", "the services of the recorder")
def test_start_stop_pause_resume(roscore, recorder, rosCas, client):
    child = recorder("/a", "/b", "-O", "one", "--label", "site=lab", "--node-id", "husky")
    with publisher(roscore, "/a", name="/pa") as a, publisher(roscore, "/b", name="/pb") as b:
        a.await_subscribers().publish(text(1))
        b.await_subscribers().publish(text(1))
        await_received(client, "/a", 1)
        await_received(client, "/b", 1)
        assert client.call("/recorder/pause", topics=["/a"])["success"]
        a.publish(text(2))
        await_received(client, "/a", 2)
        status = client.call("/recorder/status")
        assert (status["state"], status["run"]) == ("recording", "one")
        paused = topic_in(status, "/a")
        assert (paused["paused"], paused["is_paused"]) == (1, True)
        assert client.call("/recorder/resume")["success"]
        a.publish(text(3))
        await_received(client, "/a", 3)
        # One topic is left; the other goes on.
        assert client.call("/recorder/stop", topics=["/b"])["success"]
        await_true(lambda: not topic_in(client.call("/recorder/status"), "/b")["subscribed"])
        # The whole run ends, and the node stays; the next one is not paused.
        assert client.call("/recorder/pause")["success"]
        answer = client.call("/recorder/stop")
        assert (answer["success"], answer["run"]) == (True, "")
        assert client.call("/recorder/status")["state"] == "stopped"
        answer = client.call("/recorder/start", name="two", labels=["site=field"])
        assert (answer["success"], answer["run"]) == (True, "two")
        b.await_subscribers(2).publish(text(9))
        await_received(client, "/b", 2)
    assert child.end() == 0, child.output
    assert data_of(rosCas, "/a", "one") == ["1", "3"]
    assert data_of(rosCas, "/b", "two") == ["9"]
    runs = {run.name: run for run in rosCas.runs()}
    assert (runs["one"].labels, runs["one"].node) == ({"site": "lab"}, "husky")
    assert runs["two"].labels == {"site": "field"}
    assert all(run.ended for run in runs.values())
    assert "paused" in child.output


def test_wrong_requests_are_answered(recorder, client):
    recorder("/a", "/b")
    for verb, request, said in (
        ("start", {}, "recording already: run "),
        ("start", {"topics": ["/has space"]}, "not a name of a ROS topic"),
        ("start", {"labels": ["lab"]}, "is not a label"),
        ("stop", {"topics": ["/bb"]}, "topic /bb is not recorded; did you mean /b?"),
        ("pause", {"topics": ["/c"]}, "not recorded"),
        ("resume", {"topics": ["/c"]}, "not recorded"),
        ("snapshot", {}, "--snapshot 30s"),
    ):
        answer = client.call(f"/recorder/{verb}", **request)
        assert not answer["success"]
        assert said in answer["message"]


@pytest.mark.suite("test", "the services of the recorder")
def test_a_snapshot_before_and_after(roscore, recorder, rosCas, client):
    child = recorder("/a", "--snapshot", "5000s", "--name", "drive")
    with publisher(roscore, "/a") as a:
        a.await_subscribers().publish(*map(text, range(50)))
        await_received(client, "/a", 50)
        assert rosCas.getAllTopics() == []
        status = client.call("/recorder/status")
        assert (status["state"], status["held_messages"]) == ("snapshot", 50)
        answer = client.call("/recorder/snapshot", name="crash", labels=["why=bump"])
        assert (answer["success"], answer["run"], answer["messages"]) == (True, "crash", 50)
        assert data_of(rosCas, "/a", "crash") == [str(n) for n in range(50)]
        answer = client.call("/recorder/snapshot", name="more", after=600.0)
        a.publish(text(50))
        await_received(client, "/a", 51)
        assert not client.call("/recorder/snapshot", after=-1.0)["success"]
    assert child.end() == 0, child.output
    assert data_of(rosCas, "/a", "more") == [str(n) for n in range(51)]
    # No snapshot has to be requested.
    with publisher(roscore, "/a") as a:
        child = recorder("/a", "-s", "1MB")
        a.await_subscribers().publish(text(1))
        await_received(client, "/a", 1)
        assert child.end() == 0, child.output
    assert rosCas.getTopic("/a").countTopicData() == 50 + 51


@pytest.mark.suite("all", "it waits for seconds")
def test_all_leaves_out_what_the_recorder_says_itself(roscore, recorder, rosCas):
    child = recorder("-a", "-O", "all")
    log = Log(name="/other", msg="hello", level=Log.INFO)
    own = Log(name="/recorder", msg="mine", level=Log.INFO)
    with publisher(roscore, "/rosout", Log, name="/other") as one, publisher(
        roscore, "/broken", name="/b", message_definition="no definition"
    ) as broken:
        broken.await_subscribers().publish(text(1))
        child.await_line("kept as binary")  # said on /rosout, too
        # By the recorder and by rosout, which sends to /rosout_agg what it hears.
        one.await_subscribers(2).publish(message(log), message(own))
        await_true(
            lambda: (
                rosCas.getAllTopics("/rosout_agg")
                and [row.message().msg for row in rosCas.getTopic("/rosout_agg").rows()]
            )
        )
    assert child.end() == 0, child.output
    said = [row.message() for row in rosCas.getTopic("/rosout").rows()]
    # Messages of another node are recorded whatever their Log.name; /rosout_agg has only names.
    assert [m.msg for m in said] == ["hello", "mine"]
    assert {row.connection.callerid for row in rosCas.getTopic("/rosout").rows()} == {"/other"}
    names = {row.message().name for row in rosCas.getTopic("/rosout_agg").rows()}
    assert names == {"/other"}
    assert not rosCas.getAllTopics("/diagnostics")


@pytest.mark.suite("test", "options of the recorder")
def test_node_where_rate_and_context(roscore, recorder, rosCas, client):
    """The subscriptions of a node; a condition; the parameters and the node graph of the run."""
    master = xmlrpc.client.ServerProxy(roscore.uri)
    master.setParam("/test", "/robot/name", "husky")
    # A node that exists for the master alone.
    master.registerSubscriber("/listener", "/heard", "std_msgs/Int32", "http://127.0.0.1:1/")
    child = recorder("--node", "/listener", "--where", "/heard: data > 5", "-O", "ctx")
    with publisher(roscore, "/heard", Int32) as one:
        one.await_subscribers().publish(*[message(Int32(n)) for n in range(10)])
        await_received(client, "/heard", 10)
        master.registerSubscriber("/listener", "/late", "std_msgs/Int32", "http://127.0.0.1:1/")
        child.await_line("recording /late, too")
        await_true(lambda: rosCas.runContext("ctx"))  # the end of a run waits 3 s for it
    child.end()
    assert data_of(rosCas, "/heard") == [6, 7, 8, 9]
    assert "left out" in child.output
    context = rosCas.runContext("ctx")
    assert context.params["robot"] == {"name": "husky"}
    assert "/listener" in context.graph.nodes
    for topic in ("/heard", "/late"):
        master.unregisterSubscriber("/listener", topic, "http://127.0.0.1:1/")
    master.deleteParam("/test", "/robot")


@pytest.mark.suite("test", "--split, --publish and --repeat-latched")
def test_splits_and_begin_write(roscore, recorder, rosCas, client):
    arguments = ("--split", "--size", "1", "--repeat-latched", "-p", "-O", "r", "--tcpnodelay")
    with publisher(roscore, "/map", name="/map", latching="1") as latched:
        child = recorder("/map", "/a", *arguments)
        announced = recorder("/begin_write", "__name:=other")
        latched.await_subscribers().publish(text("map"))
        await_received(client, "/map", 1)  # before the first run ends
        with publisher(roscore, "/a", name="/a") as a:
            a.await_subscribers()
            for n in range(3):
                a.publish(message(String(str(n) * (1 << 20))))
                child.await_line(f"run r_{n + 1}")
        await_true(
            lambda: rosCas.getAllTopics("/begin_write") and "r_3" in data_of(rosCas, "/begin_write")
        )
        assert child.end() == 0, child.output
        announced.end()
    for n in range(3):
        assert data_of(rosCas, "/map", f"r_{n}") == ["map"]
        assert [data[0] for data in data_of(rosCas, "/a", f"r_{n}")] == [str(n)]
    names = data_of(rosCas, "/begin_write")
    assert names[-3:] == ["r_1", "r_2", "r_3"]


@pytest.mark.suite("test", "two publishers and a recorder")
def test_dry_run(roscore, recorder, rosCas, tmp_path):
    config = tmp_path / "settings.yaml"
    config.write_text("topics: [{pattern: /cam.*, format: binary, ttl: 1h, rate_limit: 5}]")
    with publisher(roscore, "/camera"), publisher(roscore, "/else", name="/e"):
        child = recorder(
            "-e", "/camera|/else", "--dry-run", "--config", config, "-O", "x", ready=""
        )
        assert child.wait() == 0, child.output
    assert told(child)[0] == "run x"
    (camera,) = [line.split() for line in child.lines if line.startswith("/camera ")]
    assert camera[1:6] == ["std_msgs/String", "binary", "3600", "s", "new"]
    assert "at most 5 Hz" in child.output
    assert rosCas.getAllTopics() == []
    assert rosCas.runs() == []


@pytest.mark.suite("all", "make test asks others of its kind")
def test_dry_run_names_a_field_that_a_type_lacks(roscore, recorder, rosCas):
    with publisher(roscore, "/text"):
        child = recorder("/text", "--dry-run", "--where", "/text: date = 'x'", ready="")
        assert child.wait() == 1, child.output
    assert "did you mean data?" in child.output
    assert any(line.startswith("/text ") for line in child.lines)


@pytest.mark.suite("test", "the parameters of the recorder")
def test_parameters_mirror_options(roscore, recorder, rosCas):
    master = xmlrpc.client.ServerProxy(roscore.uri)
    given = {"topics": ["/a"], "name": "by_param", "labels": ["x=1", "y=2"], "limit": 1}
    given.update(diagnostics=False, places=False, rate_limit="/a:1000", node_id="")
    master.setParam("/test", "/recorder", given)
    try:
        child = recorder()
        with publisher(roscore, "/a") as a:
            a.await_subscribers().publish(text(1))
            assert child.wait() == 0, child.output
        (run,) = rosCas.runs()
        assert (run.name, run.labels) == ("by_param", {"x": "1", "y": "2"})
    finally:
        master.deleteParam("/test", "/recorder")


@pytest.mark.suite("test", "a promise of SECURITY.md")
def test_no_services(roscore, recorder, rosCas):
    child = recorder("/a", "--no-services", "__name:=silent")
    assert any("/silent offers no services" in line for line in child.lines)
    with publisher(roscore, "/a") as a:
        a.await_subscribers().publish(text(1))
        await_true(lambda: rosCas.existTopic("/a") and data_of(rosCas, "/a") == ["1"])
        assert services_of(roscore, "/silent") == set()
        with recorder("/a", "__name:=open"):
            offered = {*TOPIC_SERVICES, *OTHER_SERVICES}
            assert services_of(roscore, "/open") == {f"/open/{name}" for name in offered}
    assert child.end() == 0, child.output


def test_parameters_as_words(capsys):
    parser = make_parser()

    def words(parameters, *given, without=()):
        parser.parse_args(given)
        return parameter_words(parser, parameters, without)

    assert words({"topics": "/a /b", "split": True, "all": False}) == ["/a", "/b", "--split"]
    assert words({"topics": "-a", "diagnostics": False}) == ["--all", "--no-diagnostics"]
    assert words({"topics": "-a", "diagnostics": True, "places": False}) == ["--all", "--no-places"]
    # Topics of the command line take the place of those of the parameters.
    parameters = {"topics": ["/a"], "all": True, "ttl": 5}
    assert words(parameters, "/c", without=("topics", "all")) == ["--ttl=5"]
    # Nodes in a namespace of the node's name.
    assert words({"ttl": 5, "camera": {"rate": 30}}) == ["--ttl=5"]
    assert words({"topics": "-a", "no_services": True}) == ["--all", "--no-services"]
    assert words({"topics": "-a", "no_services": False}) == ["--all"]
    assert words({"format": "", "labels": ["a=1", "b=2"]}) == ["--label=a=1", "--label=b=2"]
    for wrong in ({"topcis": "/a"}, {"split": "maybe"}, {"dry_run": True}):
        with pytest.raises(SystemExit):
            words(wrong)
        assert f"parameter ~{next(iter(wrong))}" in capsys.readouterr().err


LISTENER = """
import sys, rospy
from diagnostic_msgs.msg import DiagnosticArray
rospy.init_node("listener", disable_signals=True)
seen = rospy.wait_for_message("/diagnostics", DiagnosticArray)
while not any(status.message == "messages are being lost" for status in seen.status):
    for status in seen.status:
        values = {pair.key: pair.value for pair in status.values}
        print(status.name, status.message, values.get("received"), flush=True)
    seen = rospy.wait_for_message("/diagnostics", DiagnosticArray)
print("lost", flush=True)
"""


def test_diagnostics(roscore, recorder):
    recorder("/a", "-O", "d", "-b", "1", "--max-size", "1G")
    with publisher(roscore, "/a") as a, Child([sys.executable, "-c", LISTENER], roscore.env) as ear:
        a.await_subscribers().publish(text(1))
        ear.await_line("recorder: store recording run d")
        ear.await_line("recorder: maximum size 0% of the maximum size is not copied")
        ear.await_line("recorder: /a recording 1")


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_status_line_only_on_a_terminal(roscore, cassandra, keyspace, rosCas):
    ours, theirs = pty.openpty()
    where = ("--host", cassandra.host, "--port", str(cassandra.port), "--keyspace", keyspace)
    process = subprocess.Popen(
        [str(PROGRAMS / "recorder"), "/a", "--name", "line", *where],
        env=roscore.env,
        stdin=subprocess.DEVNULL,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
    )
    os.close(theirs)
    terminal = read_to_end(ours)
    try:
        # Its first lines say that it waits for the store.
        await_true(lambda: b"recording line, 1 topic, 0 msg/s" in terminal)
        process.terminate()
        assert process.wait(180) == 1, bytes(terminal)
        await_true(lambda: b"no message came on /a" in terminal)
    finally:
        process.kill()
        process.wait(180)


def read_to_end(descriptor):
    """Return bytes to which a thread adds what is read, until the other end is closed."""
    said = bytearray()

    def read():
        with contextlib.suppress(OSError), os.fdopen(descriptor, "rb", buffering=0) as file:
            while data := file.read(4096):
                said.extend(data)

    threading.Thread(target=read, daemon=True).start()
    return said


EMBEDDED = """
import sys, rospy
from cassandra_ros import CassandraRosError, Recorder, RecorderOptions, RosCassandra
rospy.init_node("mine", disable_signals=True)
with RosCassandra({host!r}, {port}, keyspace={keyspace!r}) as rosCas:
    with Recorder(rosCas, RecorderOptions(["/a"], output_name="own")) as recorder:
        print("stands", recorder.status().run, flush=True)
        while recorder.status().topics[0].received < 3:
            rospy.sleep(0.05)
        recorder.pause()
        recorder.resume()
        reports = recorder.stop()
        print("stopped", reports[0].stored, recorder.status().state, flush=True)
        recorder.start(name="second")
    print("closed", recorder.run == "", rospy.is_shutdown(), flush=True)
    for refused in (recorder, Recorder(rosCas, ["/has space"])):
        try:
            refused.start()
        except CassandraRosError as exc:
            print("not begun:", exc, [run.state for run in rosCas.runs()], flush=True)
"""


def test_a_recorder_in_a_process_of_ones_own(roscore, cassandra, keyspace, rosCas):
    code = EMBEDDED.format(host=cassandra.host, port=cassandra.port, keyspace=keyspace)
    with publisher(roscore, "/a") as a, Child([sys.executable, "-c", code], roscore.env) as child:
        child.await_line("stands own")
        a.await_subscribers().publish(*map(text, range(3)))
        assert child.wait() == 0, child.output
    assert "stopped 3 stopped" in child.output
    assert "closed True False" in child.output, child.output
    refused = [line for line in child.lines if "not begun:" in line]
    assert [line.split()[-2:] for line in refused] == [["['ended',", "'ended']"]] * 2
    assert data_of(rosCas, "/a", "own") == ["0", "1", "2"]


@pytest.mark.suite("all", "it waits for seconds of recording")
def test_losses_of_a_killed_recorder_are_told(roscore, recorder, rosCas):
    """They are stored while it records, before anything is closed."""
    child = recorder("/a", "-b", "1", "--no-spool")
    with publisher(roscore, "/a") as a:
        a.await_subscribers()
        big = message(String("x" * 900_000))
        await_true(lambda: a.publish(*[big] * 20) or rosCas.losses())
        child.process.kill()
        child.wait()
    (loss, *_) = rosCas.losses()
    assert (loss.topic, loss.kind) == ("/a", LossKind.BUFFER_FULL)
    assert loss.count > 0
    assert loss.first_ns <= loss.last_ns


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("/a", "--udp"), "no UDP transport"),
        (("/a", "--split"), "--split needs --size or --duration"),
        (("/a", "--max-splits", "3"), "--max-splits needs --split"),
        (("/a", "--snapshot", "soon"), "30s or 200MB"),
        (("/a", "--snapshot", "3s", "--split", "--size", "1"), "leave out --split"),
        (("/a", "--snapshot", "3s", "--no-services"), "leave out --no-services"),
        (("/a", "--label", "lab"), "KEY=VALUE"),
        (("/a", "--where", "/a data > 5"), "not of the form"),
        (("/a", "--where", "/a: data >"), "\n"),
        (("/a", "--rate-limit", "fast"), "not a rate"),
        (("/a", "--config", "/no/such.yaml"), "No such file"),
        (("/a", "-L", "1X"), "is not a size"),
        (("/a", "--journal", "--no-spool"), "leave out --no-spool"),
    ],
)
def test_wrong_usage(capsys, arguments, word):
    parser = make_parser()
    with pytest.raises(SystemExit) as caught:
        read_options(parser, parser.parse_args(arguments))
    assert caught.value.code == 2
    assert word in capsys.readouterr().err


def test_options_of_the_spool(tmp_path):
    def plan(*words):
        parser = make_parser()
        return read_options(parser, parser.parse_args(["/a", *words])).spool_plan

    assert plan("--no-spool") is None
    default = plan()
    assert (default.journal, default.drops_newest) == (False, False)
    given = plan("--journal", "--spool-drop", "newest", "--spool-dir", str(tmp_path))
    assert (given.journal, given.drops_newest) == (True, True)
    assert given.folder.path == tmp_path


def test_every_option_of_rosbag_record_is_known():
    """Each option of its help is accepted, or refused with a reason."""
    done = subprocess.run(["rosbag", "record", "-h"], capture_output=True, text=True, check=True)
    words = {word.strip(",=") for word in done.stdout.replace("=", " ").split()}
    theirs = {word for word in words if word.startswith("--")}
    ours = {name for action in make_parser()._actions for name in action.option_strings}
    assert theirs
    assert theirs <= ours


@pytest.mark.suite("all", "it kills or cuts something, and waits")
def test_a_terminal_that_is_gone_does_not_end_the_recording(roscore, cassandra, keyspace, rosCas):
    """As after ``recorder -a | head``, or when ssh has lost its connection; then SIGHUP comes."""
    where = ("--host", cassandra.host, "--port", cassandra.port, "--keyspace", keyspace)
    reads, writes = os.pipe()
    command = [str(word) for word in (PROGRAMS / "recorder", "-e", "/gone/.*", *where)]
    process = subprocess.Popen(command, env=roscore.env, stdout=writes, stderr=writes)
    os.close(writes)
    try:
        with os.fdopen(reads) as output:
            assert any("services under" in line for line in output)
        for name in ("/gone/a", "/gone/b"):
            with publisher(roscore, name, name=name) as source:
                source.await_subscribers().publish(text(1), text(2))
                await_true(
                    lambda topic=name: (
                        rosCas.existTopic(topic) and rosCas.getTopic(topic).countTopicData() == 2
                    )
                )
        process.send_signal(signal.SIGHUP)
        process.wait(180)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
    (run,) = rosCas.runs()
    assert (run.state, run.stored) == ("ended", {"/gone/a": 2, "/gone/b": 2})
