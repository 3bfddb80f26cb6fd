# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The address and login of the store, decided on the driver and sent to the executors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Mapping

from cassandra_ros.client.ros_cassandra import RosCassandra
from cassandra_ros.errors import InvalidOption
from cassandra_ros.store.connection.address import DEFAULT_KEYSPACE, from_environment
from cassandra_ros.store.connection.login import read_login

_OF_LOGIN = ("username", "password", "cqlshrc", "credentials")
"""Options that the driver reads; the executors get what they say."""
_OF_ANSWERS = ("consistency", "answer_sec")
"""Options that the executors get as they are."""


@dataclass(frozen=True)
class StoreLogin:
    """What an executor needs to open the store. Its text shows no password."""

    hosts: tuple[str, ...]
    port: int
    keyspace: str
    username: str | None = None
    password: str | None = field(default=None, repr=False)
    cqlshrc: str | None = None
    """File with the settings of TLS, which each executor reads on its machine; None = no TLS."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of class Cassandra for answers."""

    @classmethod
    def read(
        cls, host: str | None, port: int | None, keyspace: str | None, options: Mapping[str, Any]
    ) -> StoreLogin:
        """Decide where to connect and as whom, as RosCassandra does.

        Raises:
            InvalidOption: An option is not one of those, or a file cannot be read.
        """
        unknown = sorted(set(options) - {*_OF_LOGIN, *_OF_ANSWERS})
        if unknown:
            reason = "name the certificates in a cqlshrc" if "ssl_context" in unknown else ""
            choices = f"give one of {', '.join((*_OF_LOGIN, *_OF_ANSWERS))}"
            raise InvalidOption(f"{unknown[0]}= cannot be sent to executors: {reason or choices}")
        login = read_login(
            host, port, **{name: options[name] for name in _OF_LOGIN if name in options}
        )
        return cls(
            tuple(login.hosts),
            login.port,
            keyspace or from_environment("KEYSPACE") or DEFAULT_KEYSPACE,
            login.username,
            login.password,
            login.files[0] if login.tls else None,
            {name: options[name] for name in _OF_ANSWERS if name in options},
        )

    def open(self) -> RosCassandra:
        """Connect to the store. Close what it returns."""
        return RosCassandra(
            ",".join(self.hosts),
            self.port,
            keyspace=self.keyspace,
            username=self.username,
            password=self.password,
            cqlshrc=self.cqlshrc,
            **self.options,
        )
