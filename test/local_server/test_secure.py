# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One server that asks for a password and speaks TLS, and all that logs in there."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import ssl
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from conftest import ROOT
from local_server.users import KEYSPACE, Stranger
from nodes.children import Child, await_true, start_client, start_node
from nodes.raw_publisher import RawPublisher, header_of, message
from std_msgs.msg import String

from cassandra_ros import RosCassandra
from cassandra_ros.cli import cassandra_bag, local_cassandra
from cassandra_ros.errors import (
    AccessDenied,
    CertificateRefused,
    LoginFailed,
    ServerError,
    TlsMismatch,
)
from cassandra_ros.files.bag.bag_writer import BagWriter
from cassandra_ros.files.bag.importer import import_bag
from cassandra_ros.local_server import LocalCluster, free_port, server_security
from cassandra_ros.local_server.cql import CqlRefused, CqlSession
from cassandra_ros.local_server.server_security import Security, write_private
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of

pytestmark = pytest.mark.suite("all", "it starts a Cassandra")


@pytest.fixture(scope="module", autouse=True)
def first_message(cqlshrc, users):
    with RosCassandra(cqlshrc=cqlshrc, keyspace=KEYSPACE) as ours:
        ours.addTopic("/a").addData(String("first"), key=1)


def await_answer(cluster):
    """Wait until the server answers: a busy one may take longer than status waits."""
    await_true(lambda: [status.answers for status in cluster.status()] == [True])


def test_what_it_writes_is_its_owners_alone(cluster, capsys):
    folder = cluster.security.folder
    assert folder.stat().st_mode & 0o777 == 0o700
    private = [*folder.iterdir(), cluster.nodes[0].config]
    assert {path.stat().st_mode & 0o777 for path in private} == {0o600}
    # The data are protected, too: a user who could read the files would need no login.
    assert cluster.nodes[0].directory.stat().st_mode & 0o777 == 0o700
    await_answer(cluster)
    words = ["status", "--wait", "180", "--dir", str(cluster.directory)]
    assert local_cassandra.main(words) == 0
    assert f"export CASSANDRA_ROS_CQLSHRC={cluster.security.cqlshrc}" in capsys.readouterr().out
    # Nothing of the passwords is in what every user of the machine can see.
    shown = Path(f"/proc/{cluster.status()[0].pid}/cmdline").read_text()
    secrets = re.findall(r"password = (\S+)", (folder / "credentials").read_text())
    assert len(secrets) == 1 and secrets[0] not in shown


def lets_in(cluster, *login):
    place = cluster.settings.host, cluster.settings.port
    try:
        CqlSession(*place, cluster.security.context(), login).close()
    except CqlRefused:
        return False
    return True


def test_the_public_password_never_opens_it(started):
    _, stranger = started
    assert stranger.refusals
    assert not stranger.let_in


@pytest.mark.suite("all", "it starts a Cassandra")
def test_a_server_without_a_login_gets_one(tmp_path):
    """Cassandra has made its superuser with the public password before."""
    plain = LocalCluster(tmp_path / "one", port=free_port(), heap="256M")
    try:
        plain.start(die_with_us=True)
        with RosCassandra("127.0.0.1", plain.settings.port, keyspace="ros") as store:
            store.addTopic("/a").addData(String("kept"), key=1)
        plain.stop()
        secure = LocalCluster(tmp_path / "one", secure=True)
        with Stranger(secure) as stranger:
            secure.start(die_with_us=True)
            await_true(lambda: stranger.refusals > 20)
        assert not stranger.let_in
        with RosCassandra(cqlshrc=str(secure.security.cqlshrc), keyspace="ros") as store:
            assert store.getTopic("/a").getData(1).data == "kept"
    finally:
        plain.stop()


def test_nodes_without_the_key_are_refused(cluster):
    """Nodes greet each other with this number; a server without TLS waits for more."""
    place = cluster.settings.host, cluster.settings.storage_port
    with socket.create_connection(place, timeout=180) as plain:
        plain.sendall(bytes.fromhex("ca552dfa00000000"))
        answer = plain.recv(100)
        assert answer[:1] in (b"", b"\x15")  # closed, or an alert of TLS
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.load_verify_locations(cluster.security.certificate)
    with socket.create_connection(place, timeout=180) as plain, pytest.raises(ssl.SSLError):
        with context.wrap_socket(plain) as tls:
            tls.sendall(bytes.fromhex("ca552dfa00000000"))
            tls.recv(100)


def test_it_answers_when_its_user_is_made(cluster, monkeypatch, capsys):
    """Programs of a launch file wait for this: a moment before they would be refused, and end."""
    kept = cluster.security.folder / "secrets.json"
    text = kept.read_text()
    try:
        kept.write_text(text.replace(json.loads(text)["user"], "not yet made"))
        assert [status.answers for status in cluster.status()] == [False]
        kept.unlink()
        assert [status.answers for status in cluster.status()] == [False]
        # Others in its place would open neither the data nor the key.
        with pytest.raises(ServerError, match=r"secrets\.json is gone.*local_cassandra clear"):
            cluster.security.make_files("java")
        assert not kept.exists()
        assert local_cassandra.main(["status", "--dir", str(cluster.directory)]) == 3
        assert "secrets.json is gone" in capsys.readouterr().out
    finally:
        write_private(kept, text)
    await_answer(cluster)
    made = []
    monkeypatch.setattr(Security, "ensure_users", lambda self: made.append(self))
    assert not cluster.start()  # one that was cut short may have left it without
    assert len(made) == 1


def test_a_password_that_was_changed_is_not_set_back(cluster, monkeypatch):
    security, place = cluster.security, (cluster.settings.host, cluster.settings.port)
    monkeypatch.setattr(server_security, "_ROLES_SEC", 0.5)
    user, ours = security.login()

    def change(password):
        def changed():
            try:
                session.run(f"ALTER ROLE {user} WITH PASSWORD = '{password}'")
            except CqlRefused as exc:  # Cassandra allows it once in 5 s
                assert "can only be changed every" in str(exc)
                return False
            return True

        with CqlSession(*place, security.context(), security.root_login()) as session:
            await_true(changed)

    change("another")
    try:
        with pytest.raises(ServerError, match="were its passwords changed"):
            security.ensure_users()
        assert lets_in(cluster, user, "another")
    finally:
        change(ours)
    monkeypatch.setattr(server_security, "_ROLES_SEC", 180.0)
    security.ensure_users()


def test_a_refused_login_gives_the_reason(
    cluster, cqlshrc, tmp_path, monkeypatch, cassandra, make_certificate, capsys
):
    foreign = make_certificate("foreign")
    with RosCassandra(cqlshrc=cqlshrc) as store:
        assert store.cassandra.port == cluster.settings.port
    assert not lets_in(cluster, "cassandra", "cassandra")
    for user, password in (("cassandra", "cassandra"), ("nobody", "x"), ("ros", "")):
        with pytest.raises(LoginFailed, match=f"refuses the user name '{user}'") as caught:
            RosCassandra(cqlshrc=cqlshrc, username=user, password=password)
        assert "local_cassandra start" not in str(caught.value)
    nobody = tmp_path / "credentials"
    nobody.touch(mode=0o600)
    with pytest.raises(LoginFailed, match="asks for a login and none was given; write username"):
        RosCassandra(cqlshrc=cqlshrc, credentials=str(nobody))
    nobody.chmod(0o644)
    with pytest.raises(LoginFailed, match=r"none was given \(.* is not used: others can read it"):
        RosCassandra(cqlshrc=cqlshrc, credentials=str(nobody))
    monkeypatch.setenv("HOME", str(tmp_path))
    with pytest.raises(TlsMismatch, match="speaks TLS, and it was spoken to without; write 'ssl"):
        RosCassandra("127.0.0.1", cluster.settings.port)
    with pytest.raises(TlsMismatch, match="does not speak TLS, and .*cqlshrc asks for it"):
        RosCassandra(cassandra.host, cassandra.port, cqlshrc=cqlshrc)
    assert cassandra_bag.main(["list", "--port", str(cluster.settings.port)]) != 0
    assert f"; or give --cqlshrc {cqlshrc} " in capsys.readouterr().err
    monkeypatch.setenv("SSL_CERTFILE", str(foreign))
    with pytest.raises(CertificateRefused, match=f"not one of those that {foreign} trusts"):
        RosCassandra(cqlshrc=cqlshrc)
    monkeypatch.setenv("SSL_VALIDATE", "false")
    RosCassandra(cqlshrc=cqlshrc).close()


def test_a_certificate_for_each_host(cluster, cqlshrc, tmp_path, make_certificate):
    foreign = make_certificate("foreign")
    text = Path(cqlshrc).read_text()
    ours = f"certfile = {cluster.security.certificate}"
    changed = text.replace(ours, f"certfile = {foreign}")
    mine = tmp_path / "cqlshrc"
    mine.write_text(f"{changed}[certfiles]\n127.0.0.1 = {cluster.security.certificate}\n")
    RosCassandra(cqlshrc=str(mine)).close()
    mine.write_text(f"{changed}[certfiles]\nlocalhost = {cluster.security.certificate}\n")
    RosCassandra("localhost", cqlshrc=str(mine)).close()
    mine.write_text(f"{text}[certfiles]\n127.0.0.1 = {foreign}\n")
    with pytest.raises(CertificateRefused):
        RosCassandra(cqlshrc=str(mine))


def test_a_viewer_reads_and_nothing_else(enter):
    with enter("viewer") as store:
        topic = store.getTopic("/a")
        assert topic.getData(1).data == "first"
        assert store.executeCQL("select data from a where data = 'first'")
        assert [info.topic for info in store.info()] == ["/a"]
        uses = (
            ("MODIFY", lambda: topic.addData(String("x"), key=9)),
            ("MODIFY", lambda: topic.removeData(1)),
            ("MODIFY", lambda: topic.createIndex("data")),
            ("MODIFY", lambda: store.removeTopic("/a")),
            ("CREATE", lambda: store.connectToKeyspace("another")),
        )
        for right, use in uses:
            with pytest.raises(AccessDenied, match=f"viewer_1 lacks the right {right} on") as told:
                use()
            assert told.value.right == right
    with enter("owner") as ours:
        assert ours.getTopic("/a").countTopicData() == 1


def test_a_recorder_writes_but_drops_nothing(enter, tmp_path):
    with enter("recorder") as store:
        topic = store.addTopic("/b")
        topic.addData(String("x"), key=1)
        topic.createIndex("data")
        assert store.executeCQL("select data from b where data = 'x'") == [("x",)]
        assert store.executeCQL("delete from b where KEY = 1") == [(1,)]
        with pytest.raises(AccessDenied, match="lacks the right DROP on table") as told:
            store.removeTopic("/a")
        assert told.value.right == "DROP"
        with BagWriter(tmp_path / "a.bag") as writer:
            number = writer.connection(api_connection("/c", definition_of(String), ""))
            for n in range(20):
                writer.write(number, n * 10**9, message(String(str(n))))
        import_bag(store, tmp_path / "a.bag")
        assert store.getTopic("/c").countTopicData() == 20
    with enter("owner") as store:
        store.removeTopic("/b")
        assert not store.existTopic("/b")


def test_a_recorder_converts_what_others_made_but_leaves_its_tables(cqlshrc, enter):
    with RosCassandra(cqlshrc=cqlshrc, keyspace=KEYSPACE) as ours:
        ours.addTopic("/ours").addData(String("kept"), key=1)
    with enter("recorder") as store:
        with pytest.raises(AccessDenied, match="topic /ours is converted, but its earlier") as told:
            store.convertTopic("/ours", "binary")
        assert told.value.right == "DROP"
    with enter("owner") as store:
        topic = store.getTopic("/ours")
        assert (topic.getData(1).data, topic.tables[-1].metadata.format) == ("kept", "binary")
        tables = topic.tables[-1].metadata.replaces
        listing = store.catalog.keyspace.schema.listing(fresh=True)
        assert set(tables) <= set(listing.every)
        store.convertTopic("/ours", "binary")
        listing = store.catalog.keyspace.schema.listing(fresh=True)
        assert not set(tables) & set(listing.every)


def test_the_nodes_work_with_the_rights_of_their_role(roscore, cqlshrc, users, enter):
    def arguments(role):
        files = ("--cqlshrc", cqlshrc, "--credentials", str(users[role]))
        return (*files, "--keyspace", KEYSPACE)

    with start_node(roscore, "recorder", *arguments("recorder"), "/heard") as recorder:
        recorder.await_line("recording 1 topic")
        header = header_of(String, "/talker")
        with RawPublisher(roscore.uri, "/heard", header, "/talker") as publisher, enter(
            "viewer"
        ) as store:
            publisher.await_subscribers().publish(*(message(String(c)) for c in "abc"))
            await_true(
                lambda: (
                    store.existTopic("/heard") and store.getTopic("/heard").countTopicData() == 3
                )
            )
        assert recorder.end(signal.SIGINT) == 0, recorder.output
    with start_node(roscore, "query_server", *arguments("viewer"), "--allow-writes") as server:
        server.await_line("serving keyspace")
        with start_client(roscore) as client:

            def ask(statement):
                return client.call("/cassandra_ros/executeCQL", statement=statement)

            assert len(ask("select data from heard")["rows"]) == 3
            refused = ask("create index on heard (data)")
            assert not refused["success"] and "lacks the right MODIFY" in refused["message"]
        assert server.end(signal.SIGINT) == 0, server.output


def test_a_viewer_asks_users_of_this_machine_for_a_token(cqlshrc, ros_env):
    words = [sys.executable, ROOT / "scripts/viewer", "--port", "0", "--keyspace", KEYSPACE]
    with Child([*words, "--cqlshrc", cqlshrc], ros_env) as viewer:
        line = viewer.await_line("http://127.0.0.1:")
        address, token = re.search(r"(http://\S+/)\?token=(\S+)", line).groups()
        with pytest.raises(urllib.error.HTTPError, match="401"):
            urllib.request.urlopen(f"{address}api/keyspace", timeout=180)  # noqa: S310 (our own)
        asked = f"{address}api/keyspace?token={token}"
        with urllib.request.urlopen(asked, timeout=180) as answer:  # noqa: S310 (our own)
            assert KEYSPACE.encode() in answer.read()
        assert viewer.end() == 0, viewer.output
    with Child([*words, "--cqlshrc", cqlshrc, "--no-token"], ros_env) as viewer:
        assert "token" not in viewer.await_line("http://127.0.0.1:")
        assert viewer.end() == 0, viewer.output


def test_programs_find_their_login_by_the_environment(cqlshrc, users, tmp_path, ros_env):
    env = {**ros_env, "CASSANDRA_ROS_CQLSHRC": cqlshrc, "CASSANDRA_ROS_KEYSPACE": KEYSPACE}
    listing = [sys.executable, str(ROOT / "scripts/cassandra_bag"), "list"]

    def run(*options):
        command = [*listing, *map(str, options)]
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=300)
        return done.returncode, done.stdout, done.stderr

    status, text, err = run()
    assert (status, err, "/a" in text) == (0, "", True)
    stranger = tmp_path / "stranger"
    stranger.write_text("[PlainTextAuthProvider]\nusername = ann\npassword = secret\n")
    stranger.chmod(0o600)
    status, text, err = run("--credentials", stranger)
    assert (status, text, err.count("\n")) == (1, "", 1)
    assert "refuses the user name 'ann'" in err and "secret" not in err


@pytest.mark.suite("campaign", "it takes minutes; what it shows, the other tests here ask")
def test_the_demo_over_tls_with_a_login(ros_env, tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples/demo.py"), "--secure", "--out", str(tmp_path)],
        env={**os.environ, **ros_env},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=900,
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert "Nothing is left running." in done.stdout


@pytest.mark.suite("all", "it starts a Cassandra")
def test_two_secure_nodes_and_a_later_start(tmp_path):
    options = {"port": free_port(), "nodes": 2, "heap": "512M"}
    cluster = LocalCluster(tmp_path / "two", secure=True, **options)
    try:
        cluster.start(die_with_us=True)
        with RosCassandra(cqlshrc=str(cluster.security.cqlshrc), keyspace="ros") as store:
            store.addTopic("/a").addData(String("kept"), key=1)
        cluster.stop()
        again = LocalCluster(tmp_path / "two")  # it remembers
        again.start(die_with_us=True)
        with RosCassandra(cqlshrc=str(again.security.cqlshrc), keyspace="ros") as store:
            assert store.getTopic("/a").getData(1).data == "kept"
    finally:
        cluster.stop()
    cluster.clear()
    assert not cluster.security.folder.exists()
