# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
from __future__ import annotations

import http.server
import socket
import threading
from xmlrpc.server import SimpleXMLRPCServer

import pytest
import rosgraph
from conftest import NO_MASTER

from cassandra_ros.errors import ConnectionFailed
from cassandra_ros.messages import ros_master
from cassandra_ros.messages.ros_master import set_parameters, topic_type


@pytest.fixture
def master(monkeypatch):
    """A server that answers as a ROS master does; its answer can be set."""
    server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True)
    answers = [[1, "", [["/chatter", "std_msgs/String"], ["/any", "*"]]]]
    server.register_function(lambda caller: answers[-1], "getTopicTypes")
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{server.server_address[1]}")
    yield answers
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def patient(monkeypatch):
    """A master that answers is waited for, on a busy machine too."""
    monkeypatch.setattr(ros_master, "TIMEOUT_SEC", 60.0)


def test_type_that_the_master_knows(master, patient):
    assert topic_type("/chatter") == "std_msgs/String"
    assert topic_type("chatter") == "std_msgs/String"
    assert topic_type("/other") is None
    assert topic_type("/any") is None


@pytest.mark.parametrize("answer", [[-1, "no", []], [0, "", 5], "text", None, [1, "", [["/x"]]], 5])
def test_nonsense_leaves_the_type_open(master, answer):
    master.append(answer)
    assert topic_type("/chatter") is None


def test_another_server_at_its_address_leaves_the_type_open(monkeypatch):
    class Page(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(200)
            self.send_header("Content-Type", "text/xml")
            self.end_headers()
            self.wfile.write(b"welcome")

        def log_message(self, *arguments):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Page) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{server.server_port}")
        assert topic_type("/chatter") is None
        with pytest.raises(ConnectionFailed, match="no ROS master at http"):
            set_parameters([("/a", 1)])
        server.shutdown()
        thread.join()


def test_no_master_leaves_the_type_open(monkeypatch):
    with socket.socket() as free:  # held, so that nobody else listens there meanwhile
        free.bind(("127.0.0.1", 0))
        uri = f"http://127.0.0.1:{free.getsockname()[1]}"
        monkeypatch.setenv("ROS_MASTER_URI", uri)
        assert topic_type("/chatter") is None
        monkeypatch.setenv("ROS_MASTER_URI", "nonsense")
        assert topic_type("/chatter") is None
        # Without the variable it asks ROS's default address: a master of this machine may be there.
        monkeypatch.setattr(rosgraph.rosenv, "DEFAULT_MASTER_URI", uri)
        monkeypatch.delenv("ROS_MASTER_URI")
        assert topic_type("/chatter") is None


def test_a_master_that_is_silent_is_left_after_a_second(monkeypatch):
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        uri = f"http://127.0.0.1:{silent.getsockname()[1]}"
        monkeypatch.setenv("ROS_MASTER_URI", uri)
        answers = []
        asking = threading.Thread(
            target=lambda: answers.append(topic_type("/chatter")), daemon=True
        )
        asking.start()
        asking.join(180)
        assert answers == [None]


def test_a_real_master(roscore, monkeypatch, patient):
    monkeypatch.setenv("ROS_MASTER_URI", roscore.uri)
    assert topic_type("/rosout_agg") == "rosgraph_msgs/Log"


def test_no_test_asks_a_master_that_runs_on_this_machine(ros_env):
    assert rosgraph.get_master_uri() == ros_env["ROS_MASTER_URI"] == NO_MASTER
    assert topic_type("/chatter") is None
