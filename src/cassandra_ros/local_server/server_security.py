# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A local Cassandra that requires a login and uses TLS: its certificate, users and login files.

All files are in the folder `login` of the cluster's directory, readable by its owner only: the
server's key, the certificate that clients trust, and the two files with which programs log in.
"""

from __future__ import annotations

import json
import os
import secrets
import shutil
import ssl
import struct
import tempfile
import time
from pathlib import Path
from typing import Sequence

from cassandra_ros.errors import ServerError
from cassandra_ros.local_server.cluster_settings import LOGIN_DIRECTORY, ClusterSettings
from cassandra_ros.local_server.cql import CqlSession, may_log_in
from cassandra_ros.local_server.jars import module_options, server_file
from cassandra_ros.local_server.processes import run_to_end
from cassandra_ros.own_files import whole_file

USER = "ros"
"""User of the programs. It has all rights in all keyspaces, and may make roles."""
SUPERUSER = "cassandra"
"""Cassandra's default superuser. Its default password is public, so it never gets that one."""
_VALID_DAYS = 3650
_KEYTOOL_SEC = 60.0
_ROLES_SEC = 60.0
_PAUSE_SEC = 0.2
_SECRETS = "secrets.json"
_ALIAS = "cassandra"
# For short-lived programs: the optimizing compiler would take longer than the program itself.
_QUICK = ["-J-XX:TieredStopAtLevel=1", "-J-Xshare:auto"]
_ROLES_TABLE = Path("data/system_auth/roles-5bc52802de2535edaeab188eecebb090")
"""Folder of the table of roles in a node's directory. Its id is the same in every Cassandra."""
_SUPERUSER_MARK = "superuser"
"""Name of an empty file in a node's directory: the node has the password."""
_ROLES_GENERATION = 1_000_000
"""Number of the written file of the table, above those of a node that ran without a login."""
_SUPERUSER_TIMEOUT_SEC = 120.0
_SUPERUSER_FAILURE = "the password of Cassandra's superuser could not be set"


class Security:
    """The login files and users of a cluster that is started with --secure.

    Args:
        directory: Directory of the cluster.
        settings: Settings of the cluster.
    """

    def __init__(self, directory: Path, settings: ClusterSettings) -> None:
        self.folder = directory / LOGIN_DIRECTORY
        self._settings = settings

    @property
    def cqlshrc(self) -> Path:
        """Path of the cqlshrc for programs and cqlsh: address and trusted certificate."""
        return self.folder / "cqlshrc"

    @property
    def certificate(self) -> Path:
        """Path of the server's certificate, PEM."""
        return self.folder / "server.pem"

    def make_files(self, java: str) -> None:
        """Make the files that are missing, and write the current address. ``java``: path of Java.

        Raises:
            ServerError: The folder cannot be written, keytool fails to make a certificate, or the
                file with the earlier passwords is lost.
        """
        try:
            self.folder.mkdir(mode=0o700, exist_ok=True)
            self.folder.chmod(0o700)
            if loss := self.loss():
                raise ServerError(loss)  # new passwords would not work
            if not (self.folder / _SECRETS).exists():
                passwords = {
                    name: secrets.token_urlsafe(24) for name in ("keystore", "user", "root")
                }
                write_private(self.folder / _SECRETS, json.dumps(passwords))
            if not self.certificate.exists():
                self._make_certificate(java)
            self._write_login("credentials", USER, self._secret("user"))
            self._write_login("superuser_credentials", SUPERUSER, self._secret("root"))
            write_private(self.cqlshrc, self._cqlshrc())
        except OSError as exc:
            raise ServerError(f"{self.folder} cannot be written: {exc}") from exc

    def loss(self) -> str:
        """Return a text with a remedy if the file with the passwords is lost; else ''."""
        secrets_file = self.folder / _SECRETS
        if secrets_file.exists() or not (self._keystore.exists() or self.certificate.exists()):
            return ""
        return (
            f"{secrets_file} is gone, and with it the passwords of the local Cassandra: its data "
            "can be opened with those alone. Put the file back from a backup, or delete the data: "
            "local_cassandra clear"
        )

    def yaml(self) -> dict[str, object]:
        """Return the settings for login and TLS in a node's cassandra.yaml."""
        keystore = {"keystore": str(self._keystore), "keystore_password": self._secret("keystore")}
        return {
            "authenticator": "PasswordAuthenticator",
            # No cache, so that a changed password is refused at once.
            "credentials_validity": "0ms",
            "authorizer": "CassandraAuthorizer",
            "role_manager": "CassandraRoleManager",
            "client_encryption_options": {
                "enabled": True,
                "optional": False,
                "require_client_auth": False,
                "store_type": "PKCS12",
                **keystore,
            },
            # A node speaks only with nodes that have the key of this cluster, over TLS.
            "server_encryption_options": {
                "internode_encryption": "all",
                "optional": False,
                "require_client_auth": True,
                "store_type": "PKCS12",
                **keystore,
                "truststore": keystore["keystore"],
                "truststore_password": keystore["keystore_password"],
            },
        }

    def context(self) -> ssl.SSLContext:
        """Return the TLS context for our own requests; it trusts only this server."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname = False
        context.load_verify_locations(self.certificate)
        return context

    def login(self) -> tuple[str, str]:
        """Return the user name and password of the programs."""
        return USER, self._secret("user")

    def root_login(self) -> tuple[str, str]:
        """Return the user name and password of Cassandra's superuser."""
        return SUPERUSER, self._secret("root")

    def lets_in(self, address: str) -> bool:
        """Return whether a node accepts the login of the programs; False if files are missing."""
        try:
            self._session(*self.login(), address).close()
        except (OSError, struct.error, ServerError):
            return False
        return True

    def set_superuser(self, directories: Sequence[Path], java: str, jars: Path) -> None:
        """Give Cassandra's superuser its password on those stopped nodes that do not have it yet.

        A password that was changed by CQL stays.

        Args:
            directories: Directories of the nodes.
            java: Path of Java.
            jars: Directory of Cassandra's jars.

        Raises:
            ServerError: The table of roles cannot be written.
        """
        password = self._secret("root")
        nodes = [node for node in directories if not _has_superuser(node)]
        if not nodes:
            return
        try:
            # On the disk of the nodes, because the files are moved to them by renaming.
            with tempfile.TemporaryDirectory(prefix="superuser_", dir=self.folder) as name:
                drafts = [Path(name) / str(number) for number in range(len(nodes))]
                for draft in drafts:
                    draft.mkdir()
                _write_roles(drafts, password, java, jars, Path(name))
                for node, draft in zip(nodes, drafts):
                    _move_roles(draft, node)
        except OSError as exc:
            raise ServerError(f"{_SUPERUSER_FAILURE}: {exc}") from exc

    def ensure_users(self) -> None:
        """Create the user of the programs if the node at the first address does not let it in.

        Raises:
            ServerError: The stored passwords are refused, because they were changed elsewhere.
        """
        if self.lets_in(self._settings.host):
            return
        deadline = time.monotonic() + _ROLES_SEC
        while True:  # with several nodes, the role may not be readable a moment after they answer
            try:
                with self._session(*self.root_login()) as session:
                    if not may_log_in(session, USER):
                        return self._make_users(session)
                    self._session(*self.login()).close()  # a moment ago it was not known yet
                    return
            except (OSError, struct.error) as exc:
                refusal = exc
            if time.monotonic() > deadline:
                raise ServerError(
                    f"the local Cassandra refuses the passwords that are kept in {self.folder} "
                    f"({refusal}): were its passwords changed? Put them back, or clear its data"
                )
            time.sleep(_PAUSE_SEC)

    def _make_users(self, session: CqlSession) -> None:
        """Create the user of the programs; ``session`` is the superuser's. Can be repeated."""
        nodes = self._settings.nodes
        if nodes > 1:  # otherwise no login would work while one of the nodes is down
            session.run(
                "ALTER KEYSPACE system_auth WITH replication = "
                f"{{'class': 'NetworkTopologyStrategy', 'datacenter1': {nodes}}}"
            )
        # CQL of roles has no bound values. We made the password; it contains no quotes.
        user = self._secret("user")
        session.run(f"CREATE ROLE IF NOT EXISTS {USER}")
        for everything in ("ALL KEYSPACES", "ALL ROLES"):
            session.run(f"GRANT ALL PERMISSIONS ON {everything} TO {USER}")
        for right in ("SELECT", "AUTHORIZE"):  # "all" does not include the virtual tables
            session.run(f"GRANT {right} ON KEYSPACE system_views TO {USER}")
        # Allow the login last, so that the user has all rights as soon as it can log in.
        session.run(f"ALTER ROLE {USER} WITH PASSWORD = '{user}' AND LOGIN = true")

    def _session(self, user: str, password: str, address: str = "") -> CqlSession:
        settings, login = self._settings, (user, password)
        return CqlSession(address or settings.host, settings.port, self.context(), login)

    @property
    def _keystore(self) -> Path:
        return self.folder / "keystore.p12"

    def _secret(self, name: str) -> str:
        """Return a password: 'keystore', 'user' or 'root'; ServerError: the file is lost."""
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
        """Run keytool on the keystore; raises ServerError."""
        beside = Path(java).with_name("keytool")
        tool = str(beside) if beside.exists() else shutil.which("keytool")
        if not tool:
            raise ServerError(f"keytool, which comes with Java, is not beside {java}")
        store = ["-alias", _ALIAS, "-keystore", str(self._keystore), "-storetype", "PKCS12"]
        run_to_end(
            [tool, *_QUICK, *words, *store, "-storepass:env", "KEYSTORE_PASSWORD"],
            {"KEYSTORE_PASSWORD": self._secret("keystore")},
            _KEYTOOL_SEC,
            "no certificate could be made",
        )


def write_private(path: Path, text: str) -> None:
    """Write a file atomically; other users cannot read it at any moment."""
    with whole_file(path, private=True) as file:
        file.write(text.encode("utf-8"))


def _has_superuser(node: Path) -> bool:
    """Return whether a node has the password, and the data in which it is."""
    return (node / _SUPERUSER_MARK).exists() and (node / _ROLES_TABLE).is_dir()


def _move_roles(draft: Path, node: Path) -> None:
    """Move the files of the table of roles to a stopped node, and mark that it has the password."""
    node.mkdir(mode=0o700, exist_ok=True)
    (node / _ROLES_TABLE).mkdir(parents=True, exist_ok=True)
    # Cassandra finds a file of a table by its part Data.db, which is therefore moved last.
    for file in sorted(draft.iterdir(), key=lambda path: path.name.endswith("Data.db")):
        version, _, rest = file.name.split("-", 2)
        os.replace(file, node / _ROLES_TABLE / f"{version}-{_ROLES_GENERATION}-{rest}")
    (node / _SUPERUSER_MARK).touch()


def _write_roles(drafts: list[Path], password: str, java: str, jars: Path, folder: Path) -> None:
    """Compile Superuser.java with the compiler that Cassandra brings, and run it.

    Args:
        drafts: Empty folders; each gets the files of a table of roles with the superuser.
        password: Its password.
        java: Path of Java.
        jars: Directory of Cassandra's jars.
        folder: Folder for the compiled program and its temporary files.

    Raises:
        ServerError: It cannot be compiled, or fails.
    """
    # The optimizing compiler would take longer than these programs.
    common = [java, "-XX:TieredStopAtLevel=1", "-Xshare:auto", "-Xmx256M"]
    common += ["-cp", f"{folder}{os.pathsep}{jars / '*'}"]
    compiler = "org.eclipse.jdt.internal.compiler.batch.Main"
    # Only the jars that the program names: another one has a package java.lang.
    needed = [jar for name in ("cassandra-all", "jbcrypt") for jar in jars.glob(f"{name}-*.jar")]
    compiling = [*common, compiler, "-17", "-proc:none", "-nowarn"]
    compiling += ["-cp", os.pathsep.join(map(str, needed)), "-d", str(folder)]
    compiling.append(str(server_file("Superuser.java")))
    run_to_end(compiling, {}, _SUPERUSER_TIMEOUT_SEC, _SUPERUSER_FAILURE)
    places = [f"-D{name}={folder}" for name in ("cassandra.storagedir", "cassandra.logdir")]
    logging = f"-Dlogback.configurationFile={server_file('logback.xml').as_uri()}"
    options = [*module_options(), *places, logging, f"-Djava.io.tmpdir={folder}"]
    words = [*common, *options, "Superuser", *map(str, drafts)]
    run_to_end(words, {"SUPERUSER_PASSWORD": password}, _SUPERUSER_TIMEOUT_SEC, _SUPERUSER_FAILURE)
