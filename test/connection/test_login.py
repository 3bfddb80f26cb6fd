# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What cqlsh's two files say, who goes before whom, and servers with a wrong certificate."""

from __future__ import annotations

import contextlib
import socket
import ssl
import threading

import pytest
from cassandra import AuthenticationFailed, Unauthorized
from cassandra.cluster import NoHostAvailable

from cassandra_ros import Cassandra
from cassandra_ros.errors import AccessDenied, CertificateRefused, InvalidOption, LoginFailed
from cassandra_ros.store.connection import cassandra as connection
from cassandra_ros.store.connection import login as login_module
from cassandra_ros.store.connection import login_errors
from cassandra_ros.store.connection.driver_errors import is_busy, is_passing, translate
from cassandra_ros.store.connection.login import read_login

PLAIN = "[auth_provider]\nmodule = cassandra.auth\nclassname = PlainTextAuthProvider\n"


@pytest.fixture
def home(tmp_path, monkeypatch):
    """Writes the two files of a home of this test."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("CASSANDRA_ROS_HOST", "CASSANDRA_ROS_PORT", "CASSANDRA_ROS_CQLSHRC"):
        monkeypatch.delenv(name, raising=False)
    for name in ("SSL_CERTFILE", "SSL_VALIDATE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(login_module, "_warned", set())
    folder = tmp_path / ".cassandra"
    folder.mkdir()

    def write(cqlshrc="", credentials="", mode=0o600):
        (folder / "cqlshrc").write_text(cqlshrc)
        (folder / "cqlshrc").chmod(mode)
        (folder / "credentials").write_text(credentials)
        (folder / "credentials").chmod(mode)
        return folder

    return write


def user(**options):
    found = read_login(**options)
    return found.username, found.password


def test_without_files_all_is_as_usual(home):
    found = read_login()
    assert (found.hosts, found.port, found.username, found.tls) == (["127.0.0.1"], 9042, None, None)


def test_who_goes_before_whom(home, tmp_path):
    """As in cqlsh: the more of these say something, the further down the one that counts."""
    home(PLAIN + "username = a\npassword = 1\n")
    assert user() == ("a", "1")
    home(PLAIN + "username = a\n", "[PlainTextAuthProvider]\nusername = b\npassword = %2%%\n")
    assert user() == ("b", "%2%%")
    old = "[authentication]\nusername = c\npassword = 3\n"
    home(old, "[PlainTextAuthProvider]\nusername = b\npassword = 2\n")
    assert user() == ("c", "3")
    home(old, "[plain_text_auth]\nusername = d\npassword = 4\n")
    assert user() == ("d", "4")
    assert user(username="e") == ("e", "4")
    assert user(username="e", password="5") == ("e", "5")  # noqa: S106 - none of anybody's
    mine = tmp_path / "mine"
    mine.write_text("[plain_text_auth]\nusername = f\npassword = 6\n")
    mine.chmod(0o600)
    assert user(credentials=str(mine)) == ("f", "6")
    home("[authentication]\ncredentials = ~/mine\n")
    assert user() == ("f", "6")
    assert "password" not in repr(read_login())


def test_what_others_can_read_is_not_used(home, caplog):
    folder = home("", "[plain_text_auth]\nusername = d\npassword = 4\n", mode=0o644)
    for _ in range(2):
        assert user() == (None, None)
    (record,) = caplog.records  # once
    assert f"chmod 600 {folder}/credentials" in record.getMessage()
    caplog.clear()
    home("[authentication]\nusername = c\npassword = 3\n", mode=0o640)
    assert user() == ("c", "3")
    (record,) = caplog.records
    assert "cqlshrc holds a password and others can read it" in record.getMessage()
    for mode in (0o640, 0o604):  # the group, and everybody else
        home("", "[plain_text_auth]\nusername = d\npassword = 4\n", mode=mode)
        assert user() == (None, None)


@pytest.mark.parametrize(
    "text",
    [
        "[auth_provider]\nmodule = os\nclassname = system\n",
        "[auth_provider]\nmodule = cassandra.auth\nclassname = SaslAuthProvider\n",
        "[auth_provider]\nmodule = cassandra.auth\n",
        "[auth_provider]\nclassname = PlainTextAuthProvider\n",
    ],
)
def test_a_provider_that_is_not_on_the_list_is_refused(home, text):
    home(text)
    with pytest.raises(InvalidOption, match="is not supported: use module = cassandra.auth"):
        read_login()


def test_tls_is_read_as_cqlsh_reads_it(home, monkeypatch, make_certificate):
    files = "[ssl]\ncertfile = ~/a\nuserkey = ~/k\nusercert = ~/u\n[certfiles]\nOther = ~/b\n"
    folder = home(files)
    assert read_login().tls is None  # the section alone asks for nothing
    home(f"[connection]\nssl = true\n{files}")
    tls, above = read_login().tls, str(folder.parent)
    assert (tls.certfile, tls.validate) == (f"{above}/a", True)
    assert tls.certfiles == {"other": f"{above}/b"}
    assert (tls.userkey, tls.usercert) == (f"{above}/k", f"{above}/u")
    with pytest.raises(InvalidOption, match=f"certfile {above}/b: cannot be read"):
        tls.context("other")
    monkeypatch.setenv("SSL_CERTFILE", str(make_certificate("any")))
    assert read_login().tls.certfiles == {}
    home("[connection]\nssl = true\n")
    assert read_login().tls.context("x").verify_mode == ssl.CERT_REQUIRED
    monkeypatch.setenv("SSL_VALIDATE", "False")
    assert read_login().tls.context("x").verify_mode == ssl.CERT_NONE
    monkeypatch.delenv("SSL_CERTFILE")
    assert read_login().tls.context("x").verify_mode == ssl.CERT_NONE
    monkeypatch.delenv("SSL_VALIDATE")
    with pytest.raises(InvalidOption, match="names no certificate to trust for x"):
        read_login().tls.context("x")


def test_files_that_are_none(home, tmp_path, monkeypatch):
    home("[connection]\nssl = perhaps\n")
    with pytest.raises(InvalidOption, match="neither true nor false"):
        read_login()
    home("[connection]\nport = many\n")
    with pytest.raises(InvalidOption, match=r"'many' \(.*cqlshrc\) is not a port"):
        read_login()
    home("", "username = d\npassword = secret\n")
    with pytest.raises(InvalidOption, match="credentials .* line 1 does not belong") as caught:
        read_login()
    assert "secret" not in str(caught.value)
    home()
    for option in ("cqlshrc", "credentials"):
        with pytest.raises(InvalidOption, match=f"{option}: there is no file {tmp_path}/no"):
            read_login(**{option: f"{tmp_path}/no"})
    monkeypatch.setenv("CASSANDRA_ROS_CQLSHRC", "~/no")
    with pytest.raises(InvalidOption, match="cqlshrc: there is no file"):
        read_login()


@contextlib.contextmanager
def server(certificate, trusted=None):
    """A port that speaks TLS, and nothing else, with a certificate."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    if trusted:
        context.load_verify_locations(trusted)
        context.verify_mode = ssl.CERT_REQUIRED
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve():
            with contextlib.suppress(OSError):
                while True:
                    plain = listener.accept()[0]
                    with contextlib.suppress(OSError):
                        context.wrap_socket(plain, server_side=True).recv(9)
                    plain.close()

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield listener.getsockname()[1]
        listener.shutdown(socket.SHUT_RDWR)
    thread.join(180)


def refusal(port):
    with pytest.raises(CertificateRefused) as caught:
        Cassandra("127.0.0.1", port)
    assert caught.value.refused
    return str(caught.value)


def test_certificates_that_are_refused(home, make_certificate, monkeypatch):
    # Who answers is waited for, on a busy machine too.
    monkeypatch.setattr(connection, "CONNECT_TIMEOUT_SEC", 180.0)
    monkeypatch.setattr(login_errors, "PROBE_SEC", 180.0)
    expired, valid = make_certificate("expired", days=0), make_certificate("valid")
    trusting = "[connection]\nssl = true\n[ssl]\ncertfile = {}\n"
    home(trusting.format(expired))
    with server(expired) as port:
        assert "has expired; have a new one made" in refusal(port)
    with server(valid) as port:
        assert f"not one of those that {expired} trusts" in refusal(port)
    home(trusting.format(valid))
    with server(valid, trusted=valid) as port:
        assert "asks for a certificate of ours" in refusal(port)


@pytest.mark.parametrize(
    ("right", "place", "resource"),
    [
        ("MODIFY", "table ros.t", 'KEYSPACE "ros"'),
        ("CREATE", "all keyspaces", "ALL KEYSPACES"),
        ("CREATE", "all tables in ros", 'KEYSPACE "ros"'),
        ("SELECT", "keyspace ros", 'KEYSPACE "ros"'),
        ("CREATE", "all roles", "ALL ROLES"),
    ],
)
def test_a_right_that_is_missing_is_named(right, place, resource):
    text = f"User ann lee has no {right} permission on <{place}> or any of its parents"
    if place == "all roles":
        text = "User ann lee does not have sufficient privileges to perform the requested operation"
    told = Unauthorized(f'Error from server: code=2100 [Unauthorized] message="{text}"')
    denied = translate(told, "writing")
    assert isinstance(denied, AccessDenied)
    assert denied.right == right
    grant = f'GRANT {right} ON {resource} TO "ann lee"'
    for part in ("writing: user ann lee lacks the right", place, "cassandra_bag roles", grant):
        assert part in str(denied)
    other = translate(Unauthorized("You have not logged in"), "writing")
    assert (type(other), other.right) == (AccessDenied, "")
    assert isinstance(translate(AuthenticationFailed("x"), "writing"), LoginFailed)


def test_hosts_in_the_place_of_errors_are_not_asked_for_any():
    """The driver's first session has a list of hosts there if no host accepted it."""
    error = NoHostAvailable("Unable to connect to any servers", ["127.0.0.1"])
    assert is_passing(error) and not is_busy(error)
    assert "Unable to connect" in str(translate(error, "connecting"))
