# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Address, login and TLS of the store: decided here for every program and for RosCassandra.

The rules are cqlsh's, from the same two files: ~/.cassandra/cqlshrc and ~/.cassandra/credentials.
"""

from __future__ import annotations

import configparser
import logging
import os
import stat
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Iterator, Mapping, Sequence

from cassandra_ros.errors import InvalidOption
from cassandra_ros.store.connection.address import from_environment, host_names, port_number

if TYPE_CHECKING:
    import ssl

CQLSHRC = "~/.cassandra/cqlshrc"
CREDENTIALS = "~/.cassandra/credentials"
PROVIDERS = ("PlainTextAuthProvider", "DSEPlainTextAuthProvider")
"""Class names that [auth_provider] may have, all of the module cassandra.auth. A class that a file
names is never imported: it could run any code of the file's owner."""

_SECTION = "auth_provider"
_log = logging.getLogger(__name__)
_warned: set[str] = set()
"""Texts that this process has logged as a warning."""


@dataclass(frozen=True)
class Tls:
    """The settings of [ssl] and [certfiles] in a cqlshrc; all files are PEM."""

    source: str
    """File that has these settings, for error texts."""
    validate: bool = True
    """Whether the server's certificate must be trusted."""
    certfile: str = ""
    """File of trusted certificates; '' = the cqlshrc names no file."""
    certfiles: Mapping[str, str] = field(default_factory=dict)
    """File of trusted certificates for each host, in place of certfile."""
    userkey: str = ""
    usercert: str = ""
    """Files of our own key and certificate, for servers that ask for a client certificate."""

    def context(self, host: str) -> ssl.SSLContext:
        """Return the SSL context for a connection to a host.

        Raises:
            InvalidOption: A file is missing or holds no certificates, or no certificates are named.
        """
        import ssl

        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        # Like cqlsh: the server is the one that has the key of a trusted certificate, under any
        # name.
        context.check_hostname = False
        context.verify_mode = ssl.CERT_REQUIRED if self.validate else ssl.CERT_NONE
        trusted = self.certfiles.get(host.lower(), self.certfile)
        if self.validate and not trusted:
            raise InvalidOption(
                f"{self.source} asks for TLS and names no certificate to trust for {host}: write "
                "certfile = FILE under [ssl] (or HOST = FILE under [certfiles]), or set "
                "SSL_CERTFILE"
            )
        if trusted:
            with _readable("certfile", trusted):
                context.load_verify_locations(trusted)
        if self.usercert or self.userkey:
            with _readable("usercert, userkey", f"{self.usercert}, {self.userkey}"):
                context.load_cert_chain(self.usercert or self.userkey, self.userkey or None)
        return context


@dataclass(frozen=True)
class Login:
    """Address, user and TLS settings of a connection."""

    hosts: list[str]
    port: int
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: Tls | None = None
    files: tuple[str, str] = (CQLSHRC, CREDENTIALS)
    """Names of the cqlshrc and the credentials file, which may be missing."""
    ignored: str = ""
    """Credentials file that was not read because other users can read it; '' = there is no such
    file."""

    @property
    def is_secret(self) -> bool:
        """Whether there is a password or a key, which other users of the machine do not have."""
        return bool(self.username or (self.tls is not None and self.tls.userkey))


@contextmanager
def _readable(option: str, name: str) -> Iterator[None]:
    """Run a block that reads PEM files, and translate its errors to InvalidOption.

    Args:
        option, name: Option that names the files, and their names, for the error text.
    """
    try:
        yield
    except (OSError, ValueError) as exc:  # ssl.SSLError is an OSError
        raise InvalidOption(
            f"{option} {name}: cannot be read as certificates or keys (PEM): {exc}"
        ) from exc


def read_login(
    host: str | Sequence[str] | None = None,
    port: int | str | None = None,
    cqlshrc: str | None = None,
    credentials: str | None = None,
    username: str | None = None,
    password: str | None = None,
) -> Login:
    """Decide where to connect and as whom.

    The order is: arguments, environment (CASSANDRA_ROS_HOST, CASSANDRA_ROS_PORT,
    CASSANDRA_ROS_CQLSHRC, SSL_CERTFILE, SSL_VALIDATE), files, defaults. An empty argument, which a
    launch file may pass, counts as not given.

    Args:
        host: One address, several divided by commas, or a sequence of them.
        port: CQL port, 1 to 65535.
        cqlshrc: A file like cqlsh's; default ~/.cassandra/cqlshrc, which may be missing.
        credentials: A file with user name and password; default as the cqlshrc says, else
            ~/.cassandra/credentials, which may be missing.

    Raises:
        InvalidOption: A named file cannot be read, or a value in it is not valid.
    """
    named = cqlshrc or from_environment("CQLSHRC")
    config_file = os.path.expanduser(named or CQLSHRC)
    config = read_sections(config_file, "cqlshrc", must_exist=bool(named))
    keys_named = credentials or config.get("authentication", "credentials", fallback="")
    keys_file = os.path.expanduser(keys_named or CREDENTIALS)
    ignored = "" if is_private(keys_file) else keys_file
    if ignored:
        _warn(
            f"{ignored} is not used: others can read it, or it belongs to another user; "
            f"make it yours alone: chmod 600 {ignored}"
        )
    keys = read_sections("" if ignored else keys_file, "credentials", must_exist=bool(keys_named))
    user, secret = _user(config, config_file, keys, username, password)
    return Login(
        hosts=host_names(host, config.get("connection", "hostname", fallback="")),
        port=port_number(port, config.get("connection", "port", fallback=""), config_file),
        username=user,
        password=secret,
        tls=_tls(config, config_file),
        files=(config_file, keys_file),
        ignored=ignored,
    )


def is_private(name: str) -> bool:
    """Return whether no other user can read a file, or the file is missing.

    For root the file may belong to any user.
    """
    try:
        status = os.stat(name)
    except OSError:
        return True  # read_sections reports a file that cannot be read
    ours = os.getuid() in (0, status.st_uid)
    return ours and not status.st_mode & (stat.S_IRGRP | stat.S_IROTH)


def _warn(text: str) -> None:
    """Log a warning once per process: a program may connect often."""
    if text not in _warned:
        _warned.add(text)
        _log.warning("%s", text)


def read_sections(name: str, option: str, *, must_exist: bool) -> configparser.ConfigParser:
    """Read a file of sections, as cqlsh's two are; empty if it is missing, or if ``name`` is ''.

    Raises:
        InvalidOption: The file cannot be read, or is missing though it must exist.
    """
    config = configparser.ConfigParser(interpolation=None)  # a % in a password stays as it is
    if not name:
        return config
    try:
        config.read_string(Path(name).read_text(encoding="utf-8"), name)
    except FileNotFoundError as exc:
        if must_exist:
            raise InvalidOption(f"{option}: there is no file {name}") from exc
    except (OSError, UnicodeDecodeError, ValueError) as exc:
        raise InvalidOption(f"{option} {name} cannot be read: {exc}") from exc
    except configparser.Error as exc:
        # Its own text may show a line of the file, which may hold a password.
        line = getattr(exc, "lineno", None) or next(iter(getattr(exc, "errors", ())), ("?",))[0]
        raise InvalidOption(
            f"{option} {name} cannot be read: line {line} does not belong to a file of sections; "
            "write [section] and name = value"
        ) from None
    return config


def _user(
    config: configparser.ConfigParser,
    config_file: str,
    keys: configparser.ConfigParser,
    username: str | None,
    password: str | None,
) -> tuple[str | None, str | None]:
    """Return user name and password, as cqlsh decides them.

    The files and the arguments are looked at in the order of the loop below. Each entry in a later
    one replaces that in an earlier one.

    Args:
        config, config_file: The cqlshrc and its name.
        keys: The credentials file; empty if it must not be used.
    """
    provider = _section(config, _SECTION)
    module, name = provider.get("module"), provider.get("classname")
    is_provider = (module, name) in [("cassandra.auth", classname) for classname in PROVIDERS]
    if not is_provider and (module or name):
        raise InvalidOption(
            f"[{_SECTION}] of {config_file}: {module or '(no module)'} {name or '(no classname)'} "
            f"is not supported: use module = cassandra.auth, classname = {' or '.join(PROVIDERS)}"
        )
    for section in ("authentication", _SECTION):
        if _section(config, section).get("password") and not is_private(config_file):
            _warn(
                f"{config_file} holds a password and others can read it; "
                f"put it into a file of yours alone: {CREDENTIALS} (chmod 600)"
            )
    entries: dict[str, str] = {}
    for settings in (
        provider,
        _section(keys, name or PROVIDERS[0]),
        _section(config, "authentication"),
        _section(keys, "plain_text_auth"),
        {"username": username, "password": password},
    ):
        entries.update({key: text for key, text in settings.items() if text is not None})
    return entries.get("username") or None, entries.get("password")


def _section(config: configparser.ConfigParser, name: str) -> dict[str, str | None]:
    """Return the options of a section; empty if it is missing."""
    return dict(config[name]) if config.has_section(name) else {}


def _tls(config: configparser.ConfigParser, config_file: str) -> Tls | None:
    """Return the TLS settings of a cqlshrc and the environment; None = no TLS."""
    try:
        uses_tls = config.getboolean("connection", "ssl", fallback=False)
    except ValueError as exc:
        raise InvalidOption(f"[connection] ssl of {config_file} is neither true nor false") from exc
    if not uses_tls:
        return None
    validate = os.environ.get("SSL_VALIDATE") or config.get("ssl", "validate", fallback="true")
    hosts = {name: str(text) for name, text in _section(config, "certfiles").items()}
    certfile = config.get("ssl", "certfile", fallback="")
    if os.environ.get("SSL_CERTFILE"):
        certfile, hosts = os.environ["SSL_CERTFILE"], {}
    return Tls(
        source=config_file,
        validate=str(validate).lower() != "false",
        certfile=os.path.expanduser(certfile),
        certfiles={name: os.path.expanduser(text) for name, text in hosts.items()},
        userkey=os.path.expanduser(config.get("ssl", "userkey", fallback="")),
        usercert=os.path.expanduser(config.get("ssl", "usercert", fallback="")),
    )
