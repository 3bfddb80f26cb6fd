# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A local Cassandra that asks for a password and speaks TLS: its certificate, users and files.

All lies in the folder `login` of the cluster's directory, for its owner alone: the key of the
server, the certificate that clients trust, and the two files by which programs log in.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import ssl
import struct
import subprocess
import time
from pathlib import Path

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server.cluster_settings import LOGIN_DIRECTORY, Settings
from cassandra_ros.local_server.cql import CqlSession

USER = "ros"
"""Who programs log in as: may do all in all keyspaces, and make roles."""
SUPERUSER = "cassandra"
"""Cassandra's own; its password is known to the world until it is changed."""
_VALID_DAYS = 3650
_KEYTOOL_SEC = 60.0
_ROLES_SEC = 60.0
_PAUSE_SEC = 0.2
_SECRETS = "secrets.json"
_ALIAS = "cassandra"
# Short-lived programs: the second compiler would take longer than they do.
_QUICK = ["-J-XX:TieredStopAtLevel=1", "-J-Xshare:auto"]


class Security:
    """The files of a cluster that is started with --secure.

    Args:
        directory: The cluster's own.
        settings: Where it listens.
    """

    def __init__(self, directory: Path, settings: Settings) -> None:
        self.folder = directory / LOGIN_DIRECTORY
        self._settings = settings

    @property
    def cqlshrc(self) -> Path:
        """What programs, and cqlsh, read: where it is and what they trust."""
        return self.folder / "cqlshrc"

    @property
    def certificate(self) -> Path:
        """The server's certificate, PEM."""
        return self.folder / "server.pem"

    def make_files(self, java: str) -> None:
        """Make what is missing, and write the address as it is now.

        Raises:
            ServerError: The folder cannot be written, keytool makes no certificate, or the
                passwords that were chosen before are lost.
        """
        try:
            self.folder.mkdir(mode=0o700, exist_ok=True)
            self.folder.chmod(0o700)
            if loss := self.loss():
                raise ServerError(loss)  # others would open nothing
            if not (self.folder / _SECRETS).exists():
                chosen = {name: secrets.token_urlsafe(24) for name in ("keystore", "user", "root")}
                write_private(self.folder / _SECRETS, json.dumps(chosen))
            if not self.certificate.exists():
                self._make_certificate(java)
            self._write_login("credentials", USER, self._secret("user"))
            self._write_login("superuser_credentials", SUPERUSER, self._secret("root"))
            write_private(self.cqlshrc, self._cqlshrc())
        except OSError as exc:
            raise ServerError(f"{self.folder} cannot be written: {exc}") from exc

    def loss(self) -> str:
        """Say that the passwords that were chosen are lost, and what to do; '' = they are not."""
        kept = self.folder / _SECRETS
        if kept.exists() or not (self._keystore.exists() or self.certificate.exists()):
            return ""
        return (
            f"{kept} is gone, and with it the passwords of the local Cassandra: its data can be "
            "opened with those alone. Put the file back from a backup, or delete the data: "
            "local_cassandra clear"
        )

    def yaml(self) -> dict[str, object]:
        """Return what a node's cassandra.yaml says of logging in."""
        return {
            "authenticator": "PasswordAuthenticator",
            # A password that was changed, the superuser's known one above all, is refused at once.
            "credentials_validity": "0ms",
            "authorizer": "CassandraAuthorizer",
            "role_manager": "CassandraRoleManager",
            "client_encryption_options": {
                "enabled": True,
                "optional": False,
                "require_client_auth": False,
                "store_type": "PKCS12",
                "keystore": str(self._keystore),
                "keystore_password": self._secret("keystore"),
            },
        }

    def context(self) -> ssl.SSLContext:
        """Return what our own questions are encrypted with; it trusts this server alone."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname = False
        context.load_verify_locations(self.certificate)
        return context

    def login(self) -> tuple[str, str]:
        """Return user name and password of the programs."""
        return USER, self._secret("user")

    def lets_in(self, address: str) -> bool:
        """Tell whether a node takes the login of the programs; not where its files are missing."""
        try:
            self._session(*self.login(), address).close()
        except (OSError, struct.error, ServerError):
            return False
        return True

    def ensure_users(self) -> None:
        """Give the default superuser a password of its own, and make the user of the programs.

        Raises:
            ServerError: Nobody can log in: the passwords were changed by somebody else.
        """
        if self.lets_in(self._settings.host):
            return
        deadline = time.monotonic() + _ROLES_SEC
        while True:  # the server makes its first role a moment after it answers
            for password in (self._secret("root"), SUPERUSER):
                try:
                    with self._session(SUPERUSER, password) as session:
                        return self._make_users(session)
                except (OSError, struct.error) as exc:
                    refusal = exc
            if time.monotonic() > deadline:
                raise ServerError(
                    f"nobody can log in to the local Cassandra with what is kept in {self.folder} "
                    f"({refusal}): were its passwords changed? Put them back, or clear its data"
                )
            time.sleep(_PAUSE_SEC)

    def _make_users(self, session: CqlSession) -> None:
        nodes = self._settings.nodes
        if nodes > 1:  # or nobody could log in while one of them is away
            session.run(
                "ALTER KEYSPACE system_auth WITH replication = "
                f"{{'class': 'NetworkTopologyStrategy', 'datacenter1': {nodes}}}"
            )
        # Roles take no bound values; the passwords are ours, without quotes.
        root, user = self._secret("root"), self._secret("user")
        session.run(f"ALTER ROLE {SUPERUSER} WITH PASSWORD = '{root}'")
        session.run(f"CREATE ROLE IF NOT EXISTS {USER}")
        for everything in ("ALL KEYSPACES", "ALL ROLES"):
            session.run(f"GRANT ALL PERMISSIONS ON {everything} TO {USER}")
        for right in ("SELECT", "AUTHORIZE"):  # "all" leaves out the server's own
            session.run(f"GRANT {right} ON KEYSPACE system_views TO {USER}")
        # At last: who can log in has all rights.
        session.run(f"ALTER ROLE {USER} WITH PASSWORD = '{user}' AND LOGIN = true")

    def _session(self, user: str, password: str, address: str = "") -> CqlSession:
        settings, login = self._settings, (user, password)
        return CqlSession(address or settings.host, settings.port, self.context(), login)

    @property
    def _keystore(self) -> Path:
        return self.folder / "keystore.p12"

    def _secret(self, name: str) -> str:
        try:
            return str(json.loads((self.folder / _SECRETS).read_text(encoding="ascii"))[name])
        except (OSError, ValueError, KeyError) as exc:
            raise ServerError(
                f"the passwords of the local Cassandra in {self.folder / _SECRETS} cannot be "
                f"read: {exc}"
            ) from exc

    def _write_login(self, name: str, user: str, password: str) -> None:
        text = f"[PlainTextAuthProvider]\nusername = {user}\npassword = {password}\n"
        write_private(self.folder / name, text)

    def _cqlshrc(self) -> str:
        return (
            "; Written at every start of the local Cassandra; changes here are lost.\n"
            f"[authentication]\ncredentials = {self.folder / 'credentials'}\n"
            "[auth_provider]\nmodule = cassandra.auth\nclassname = PlainTextAuthProvider\n"
            f"[connection]\nhostname = {self._settings.host}\nport = {self._settings.port}\n"
            f"ssl = true\n[ssl]\ncertfile = {self.certificate}\nvalidate = true\n"
        )

    def _make_certificate(self, java: str) -> None:
        """Make a key and a certificate of it, with the keytool that comes with Java."""
        numbers = range(1, self._settings.nodes + 1)
        names = [f"ip:{self._settings.address(number)}" for number in numbers]
        self._keystore.unlink(missing_ok=True)
        key = ["-genkeypair", "-keyalg", "EC", "-groupname", "secp256r1"]
        key += ["-dname", f"CN={self._settings.cluster_name}", "-validity", str(_VALID_DAYS)]
        self._keytool(java, *key, "-ext", f"san={','.join([*names, 'dns:localhost'])}")
        self._keystore.chmod(0o600)
        draft = self.folder / "server.draft"
        self._keytool(java, "-exportcert", "-rfc", "-file", str(draft))
        draft.chmod(0o600)
        os.replace(draft, self.certificate)

    def _keytool(self, java: str, *words: str) -> None:
        beside = Path(java).with_name("keytool")
        tool = str(beside) if beside.exists() else shutil.which("keytool")
        if not tool:
            raise ServerError(f"keytool, which comes with Java, is not beside {java}")
        store = ["-alias", _ALIAS, "-keystore", str(self._keystore), "-storetype", "PKCS12"]
        # By the environment: other users see arguments.
        password = {"KEYSTORE_PASSWORD": self._secret("keystore")}
        try:
            done = subprocess.run(
                [tool, *_QUICK, *words, *store, "-storepass:env", "KEYSTORE_PASSWORD"],
                env={**os.environ, **password, "LC_ALL": "C.UTF-8"},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                timeout=_KEYTOOL_SEC,
                check=False,
            )
        except subprocess.TimeoutExpired as exc:
            raise ServerError(f"keytool did not end within {_KEYTOOL_SEC:.0f} s") from exc
        if done.returncode:
            raise ServerError(f"no certificate could be made: {done.stdout.strip()[-500:]}")


def write_private(path: Path, text: str) -> None:
    """Write a file, whole or not at all, that nobody else can read at any moment."""
    draft = path.with_name(path.name + ".draft")
    draft.unlink(missing_ok=True)
    number = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with open(number, "w", encoding="utf-8") as file:
        file.write(text)
    os.replace(draft, path)
