# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where the store is and how one logs in there: decided here, for every program and RosCassandra.

As cqlsh decides it, from the same two files: ~/.cassandra/cqlshrc and ~/.cassandra/credentials.
"""

from __future__ import annotations

import configparser
import logging
import os
import ssl
import stat
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Iterator, Mapping, Sequence

from cassandra_ros.connection.address import from_environment, host_names, port_number
from cassandra_ros.errors import InvalidOption

CQLSHRC = "~/.cassandra/cqlshrc"
CREDENTIALS = "~/.cassandra/credentials"
PROVIDERS = ("PlainTextAuthProvider", "DSEPlainTextAuthProvider")
"""What [auth_provider] may name, all in module cassandra.auth. Nothing is imported that a file
names: who may write the file could run anything."""

_SECTION = "auth_provider"
_log = logging.getLogger(__name__)
_warned: set[str] = set()


@dataclass(frozen=True)
class Tls:
    """The files of [ssl] and [certfiles]; all are PEM."""

    source: str
    """The file that said so, for error texts."""
    validate: bool = True
    """Whether the server's certificate must be one that is trusted."""
    certfile: str = ""
    """Certificates that are trusted."""
    certfiles: Mapping[str, str] = field(default_factory=dict)
    """By host: what is trusted there, in the place of certfile."""
    userkey: str = ""
    usercert: str = ""
    """Our own key and certificate, where the server asks for one."""

    def context(self, host: str) -> ssl.SSLContext:
        """Make what a connection to a host is encrypted with.

        Raises:
            InvalidOption: A file is missing or is none of certificates, or none is named.
        """
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        # As cqlsh: who has the key of a trusted certificate is the server, under any name.
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
    """What a connection is made with."""

    hosts: list[str]
    port: int
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: Tls | None = None
    files: tuple[str, str] = (CQLSHRC, CREDENTIALS)
    """The two files, whether they are there or not."""
    ignored: str = ""
    """A credentials file that others can read."""


@contextmanager
def _readable(option: str, name: str) -> Iterator[None]:
    """Turn errors of reading PEM files into ours."""
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

    What is given goes before the environment (CASSANDRA_ROS_HOST, CASSANDRA_ROS_PORT,
    CASSANDRA_ROS_CQLSHRC, SSL_CERTFILE, SSL_VALIDATE), that before the files, these before what is
    usual. Given empty, as a launch file may do, is not given.

    Args:
        host: One address, several divided by commas, or a sequence of them.
        port: CQL port, 1 to 65535.
        cqlshrc: A file like cqlsh's; default ~/.cassandra/cqlshrc, which may be missing.
        credentials: A file with user name and password; default as the cqlshrc says, else
            ~/.cassandra/credentials, which may be missing.

    Raises:
        InvalidOption: A named file cannot be read, or something in it cannot be.
    """
    named = cqlshrc or from_environment("CQLSHRC")
    config_file = os.path.expanduser(named or CQLSHRC)
    config = _read(config_file, "cqlshrc", must_exist=bool(named))
    keys_named = credentials or config.get("authentication", "credentials", fallback="")
    keys_file = os.path.expanduser(keys_named or CREDENTIALS)
    ignored = "" if is_private(keys_file) else keys_file
    if ignored:
        _warn(
            f"{ignored} is not used: others can read it, or it belongs to somebody else; "
            f"make it yours alone: chmod 600 {ignored}"
        )
    keys = _read("" if ignored else keys_file, "credentials", must_exist=bool(keys_named))
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
    """Tell whether nobody else can read a file, or there is none; root's may be another's."""
    try:
        found = os.stat(name)
    except OSError:
        return True  # what cannot be read either is told where it is read
    ours = os.getuid() in (0, found.st_uid)
    return ours and not found.st_mode & (stat.S_IRGRP | stat.S_IROTH)


def _warn(text: str) -> None:
    """Warn once a process: a program may connect often."""
    if text not in _warned:
        _warned.add(text)
        _log.warning("%s", text)


def _read(name: str, option: str, *, must_exist: bool) -> configparser.ConfigParser:
    """Read one of the two files; nothing where there is none. A % in a password is one."""
    config = configparser.ConfigParser(interpolation=None)
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
        # Its own text may show a line of the file, a password perhaps.
        line = getattr(exc, "lineno", None) or next(iter(getattr(exc, "errors", ())), ("?",))[0]
        raise InvalidOption(
            f"{option} {name} cannot be read: line {line} is none of a file of sections; "
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
    """Return user name and password; what is further on in the list goes before."""
    provider = _section(config, _SECTION)
    module, name = provider.get("module"), provider.get("classname")
    known = (module, name) in [("cassandra.auth", each) for each in PROVIDERS]
    if not known and (module or name):
        raise InvalidOption(
            f"[{_SECTION}] of {config_file}: {module or '(no module)'} {name or '(no classname)'} "
            f"is none that is known: module = cassandra.auth, classname = {' or '.join(PROVIDERS)}"
        )
    for section in ("authentication", _SECTION):
        if _section(config, section).get("password") and not is_private(config_file):
            _warn(
                f"{config_file} holds a password and others can read it; "
                f"put it into a file of yours alone: {CREDENTIALS} (chmod 600)"
            )
    found: dict[str, str] = {}
    for settings in (
        provider,
        _section(keys, name or PROVIDERS[0]),
        _section(config, "authentication"),
        _section(keys, "plain_text_auth"),
        {"username": username, "password": password},
    ):
        found.update({key: text for key, text in settings.items() if text is not None})
    return found.get("username") or None, found.get("password")


def _section(config: configparser.ConfigParser, name: str) -> dict[str, str | None]:
    return dict(config[name]) if config.has_section(name) else {}


def _tls(config: configparser.ConfigParser, config_file: str) -> Tls | None:
    try:
        wanted = config.getboolean("connection", "ssl", fallback=False)
    except ValueError as exc:
        raise InvalidOption(f"[connection] ssl of {config_file} is neither true nor false") from exc
    if not wanted:
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
