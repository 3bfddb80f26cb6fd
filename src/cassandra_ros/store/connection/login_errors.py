# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Reason for which a connection was refused: wrong password, certificates, TLS on one side only."""

from __future__ import annotations

import socket
import ssl
import struct
from typing import Mapping

from cassandra import AuthenticationFailed

from cassandra_ros.errors import CertificateRefused, ConnectionFailed, LoginFailed, TlsMismatch
from cassandra_ros.store.connection.login import Login

PROBE_SEC = 2.0
"""Maximum time to wait for each step of a connection that finds out the reason, s."""
_OPTIONS = struct.pack(">BBhBi", 4, 0, 0, 5, 0)
"""The OPTIONS request of the CQL protocol, which needs no login."""
_UNTRUSTED = "certificate verify failed"


def explain_refusal(
    errors: Mapping[object, BaseException], login: Login, by_tls: bool, where: str
) -> ConnectionFailed | None:
    """Return one clear error for the driver's errors of all hosts; None if no case here fits.

    It connects to the hosts, to see whether they speak TLS.

    Args:
        by_tls: Whether the driver connected with TLS.
    """
    texts = " ".join(str(error) for error in errors.values())
    if any(isinstance(error, AuthenticationFailed) for error in errors.values()):
        return _explain_login(login, where)
    if _UNTRUSTED in texts:
        return _explain_certificate(texts, login, where)
    if by_tls and any(_wants_ours(host, login.port) for host in login.hosts):
        return CertificateRefused(
            f"the Cassandra at {where} asks for a certificate of ours, and "
            "does not take the one that was given, or was given none; name "
            f"one that it trusts as usercert and userkey under [ssl] in {_rc(login)}"
        )
    speaks_otherwise = _speaks_plainly if by_tls else _speaks_tls
    if not any(speaks_otherwise(host, login.port) for host in login.hosts):
        return None
    if by_tls:
        return TlsMismatch(
            f"the Cassandra at {where} does not speak TLS, and {_rc(login)} asks for it; remove "
            "'ssl = true' under [connection] there, or name the port that speaks TLS"
        )
    return TlsMismatch(
        f"the Cassandra at {where} speaks TLS, and it was spoken to without; write 'ssl = true' "
        f"under [connection] and 'certfile = FILE' under [ssl] in {_rc(login)}"
    )


def _explain_login(login: Login, where: str) -> LoginFailed:
    credentials_file = login.files[1] or "~/.cassandra/credentials"
    if login.username is None:
        unused = f" ({login.ignored} is not used: others can read it)" if login.ignored else ""
        return LoginFailed(
            f"the Cassandra at {where} asks for a login and none was given{unused}; write username "
            f"and password under [PlainTextAuthProvider] in {credentials_file} (chmod 600)"
        )
    return LoginFailed(
        f"the Cassandra at {where} refuses the user name {login.username!r} with this password; "
        f"correct them in {credentials_file}, or in the cqlshrc where they stand"
    )


def _explain_certificate(texts: str, login: Login, where: str) -> CertificateRefused:
    trusted = login.tls.certfile if login.tls else "the ssl_context"
    if "expired" in texts or "not yet valid" in texts:
        when = "has expired" if "expired" in texts else "is not valid yet"
        return CertificateRefused(
            f"the certificate of the Cassandra at {where} {when}; have a new one made there, or "
            "set the clock of this machine right"
        )
    if "mismatch" in texts:
        return CertificateRefused(
            f"the certificate of the Cassandra at {where} is of another host; connect by a name "
            "that stands in it"
        )
    return CertificateRefused(
        f"the certificate of the Cassandra at {where} is not one of those that {trusted} trusts: "
        "it is another server, or has a new certificate; get that and name it as certfile "
        f"under [ssl] in {_rc(login)}, or in SSL_CERTFILE"
    )


def _rc(login: Login) -> str:
    return login.files[0] or "~/.cassandra/cqlshrc"


def _speaks_tls(host: str, port: int) -> bool:
    return _greet(host, port)[0]


def _wants_ours(host: str, port: int) -> bool:
    """Return whether a server refuses a connection that has no client certificate."""
    return _greet(host, port, listening=True)[1]


def _greet(host: str, port: int, *, listening: bool = False) -> tuple[bool, bool]:
    """Start a TLS handshake without a certificate.

    Args:
        listening: Wait after the handshake for a refusal. A server that does not refuse sends
            nothing, so then only the second result counts.

    Returns:
        Whether the server speaks TLS, and whether it asks for a client certificate.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE  # nothing is sent after the handshake
    try:
        with socket.create_connection((host, port), timeout=PROBE_SEC) as plain:
            with context.wrap_socket(plain) as greeted:
                if listening:  # since TLS 1.3 a server refuses after the handshake
                    greeted.recv(1)
    except ssl.SSLError as exc:
        text = str(exc).lower()
        # An alert is an answer of TLS. The error of a server without TLS is another one.
        return "alert" in text, "certificate" in text or "handshake_failure" in text
    except OSError:
        return False, False
    return True, False


def _speaks_plainly(host: str, port: int) -> bool:
    """Return whether a server answers CQL without TLS."""
    try:
        with socket.create_connection((host, port), timeout=PROBE_SEC) as plain:
            plain.sendall(_OPTIONS)
            return plain.recv(1)[:1] >= b"\x80"  # an answer's first byte
    except OSError:
        return False
