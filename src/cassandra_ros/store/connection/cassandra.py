# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Class Cassandra: the connection to a cluster (the left half of the paper's figure 1)."""

from __future__ import annotations

import math
import os
import socket
import ssl
import threading
import time
from contextlib import suppress
from itertools import takewhile
from typing import Any, Callable, Iterable, Sequence, Tuple

from cassandra import (
    ConsistencyLevel,
    DriverException,
    OperationTimedOut,
    UnresolvableContactPoints,
)
from cassandra.auth import PlainTextAuthProvider
from cassandra.cluster import (
    EXEC_PROFILE_DEFAULT,
    Cluster,
    ExecutionProfile,
    NoHostAvailable,
    ResponseFuture,
    Session,
)
from cassandra.policies import (
    DCAwareRoundRobinPolicy,
    ExponentialReconnectionPolicy,
    TokenAwarePolicy,
)
from cassandra.pool import Host
from cassandra.query import PreparedStatement, SimpleStatement, Statement, tuple_factory

from cassandra_ros.errors import (
    CassandraRosError,
    ConnectionFailed,
    InvalidOption,
    KeyspaceNotFound,
    StoreUnavailable,
    TopicNotFound,
)
from cassandra_ros.store.connection.driver_errors import (
    DRIVER_ERRORS,
    START_HINT,
    host_errors,
    is_passing,
    translate,
    translated,
)
from cassandra_ros.store.connection.login import read_login
from cassandra_ros.store.connection.login_errors import explain_refusal
from cassandra_ros.store.connection.outage import Outage
from cassandra_ros.store.connection.protocol import (
    PROTOCOL_VERSION,
    RawProtocolHandler,
    SchemaChanges,
    connection_class,
)
from cassandra_ros.store.connection.requests import (
    REQUEST_TIMEOUT_SEC,
    RETRY_SEC,
    Seconds,
    await_answer,
    retried,
    sent_ahead,
)
from cassandra_ros.store.connection.sessions import Link, Links

CONNECT_TIMEOUT_SEC = 10.0
"""Maximum time to wait for a connection, s."""
NEW_TABLE_SEC = 1.0
"""Maximum pause before a statement is prepared again because a node does not know its table, s."""
POOL_PAUSE_SEC = 0.05
"""Interval at which a wait looks whether the session has connected to the other nodes, s."""
LAST_WORD_SEC = 0.5
"""How long close() waits for the driver if the program has to end and the store is silent, s."""
REQUESTS_AT_ONCE = 16
"""Maximum number of statements of execute_many that wait for their answers at the same time."""
CHANGES_AT_ONCE = 4
"""Maximum number of DDL statements that wait for their answers from a cluster of one node."""
AGREEMENT_SEC = 10
"""How long the driver waits after a DDL statement for the agreement of several nodes, s."""
SAME_SCHEMA_SEC = 150.0
"""Maximum time until several nodes have the same schema, s. A busy node that missed a change asks
the others for it 60 s later (Cassandra's migration_delay_ms), and again after another 60 s."""

_NEEDS = {
    "ONE": "a node that has a copy of the row",
    "LOCAL_ONE": "a node that has a copy of the row",
    "QUORUM": "more than half of the copies of a row, two of three",
    "LOCAL_QUORUM": "more than half of the copies of a row, two of three",
    "ALL": "all copies of a row",
}
"""Consistency level → what it needs, for error texts."""
_LEAST = ("ANY", "ONE", "LOCAL_ONE")
"""Consistency levels for which one copy of a row is enough."""
_READ_ANYWAY = (
    ", or read with consistency='ONE' (programs: --consistency ONE) the rows of which a node that "
    "answers has a copy; with a copy on each node these are all, except the last that it missed"
)
"""Remedy of a read for which too few nodes answer."""

SchemaChange = Tuple[str, str]
"""A DDL statement, and what it does, for the error text."""
CqlRow = Tuple[Any, ...]
"""Decoded values of a row."""

_forks = 0
"""Number of forks between the first process and this one. To ask the system for the process at each
read would take a tenth of its time."""


def _count_fork() -> None:
    global _forks
    _forks += 1


os.register_at_fork(after_in_child=_count_fork)


class Cassandra:
    """A connection to a Cassandra cluster. Safe to share between threads.

    Args:
        host: One address, several divided by commas, or a sequence of them; None =
            CASSANDRA_ROS_HOST of the environment, else the cqlshrc's, else 127.0.0.1.
        port: CQL port, 1 to 65535; None = CASSANDRA_ROS_PORT, else the cqlshrc's, else 9042.
        consistency: Name of a consistency level, e.g. 'LOCAL_QUORUM', 'ONE'.
        username: User name for a cluster with logins; None = the one in the files.
        password: Password of this user; None = the one in the files.
        ssl_context: An ``ssl.SSLContext`` for a cluster with TLS; None = as the cqlshrc says.
        cqlshrc: A file like cqlsh's; None = CASSANDRA_ROS_CQLSHRC, else ~/.cassandra/cqlshrc.
        credentials: A file with user name and password; None = the one that the cqlshrc names,
            else ~/.cassandra/credentials.
        answer_sec: Maximum time to wait for a connection, and for the answer to a read with its
            retries, s; None = as long as is usual, up to 30 s.

    Raises:
        ConnectionFailed: No server answers there, the name cannot be resolved, or there is no such
            consistency level.
        LoginFailed, CertificateRefused, TlsMismatch: The server refuses the login or the
            certificate, or we do not trust the server's certificate, or only one side uses TLS.
        InvalidOption: The port is not a port, or a file cannot be read.
    """

    def __init__(
        self,
        host: str | Sequence[str] | None = None,
        port: int | None = None,
        *,
        consistency: str = "LOCAL_QUORUM",
        username: str | None = None,
        password: str | None = None,
        ssl_context: ssl.SSLContext | None = None,
        cqlshrc: str | None = None,
        credentials: str | None = None,
        answer_sec: float | None = None,
    ) -> None:
        self._login = login = read_login(host, port, cqlshrc, credentials, username, password)
        self.hosts = login.hosts
        self.port = login.port
        self._where = f"{','.join(self.hosts)} port {self.port}"
        limit_sec = math.inf if answer_sec is None else answer_sec
        self._request_sec = min(REQUEST_TIMEOUT_SEC, limit_sec)
        self._connect_sec = min(CONNECT_TIMEOUT_SEC, limit_sec)
        self.outage = Outage(
            self._where,
            self._nodes_now,
            lambda silent_sec: self._links.failed(silent_sec),
            limit_sec,
        )
        self.schema_changes = SchemaChanges()
        self.consistency = _consistency_level(consistency)
        self._ssl_context = ssl_context
        self._files = {"cqlshrc": cqlshrc, "credentials": credentials}
        self._limit_sec = answer_sec
        self._prepared: dict[str, PreparedStatement] = {}
        """CQL text → statement; changed under _prepare_lock, read without it."""
        self._prepare_lock = threading.Lock()
        self._process, self._forks = os.getpid(), _forks
        self._closed = False
        self._expected_nodes = 0
        """Number of nodes that require_nodes asks for."""
        self._keyspaces: set[str] = set()
        """Keyspaces of which the driver knows how they are replicated."""
        self._connecting_until = 0.0
        """Monotonic time until which a new link may still be connecting to further nodes, s."""
        addresses = [(host, self.port) for host in self.hosts]
        self._links = Links(self._make_link, self._adopt, addresses, self._where)

    def arguments(self) -> dict[str, Any]:
        """Return the arguments with which another process connects as this one: plain values.

        The password is one of them.

        Raises:
            InvalidOption: The connection has an ``ssl_context``, which stays in its process.
        """
        if self._ssl_context is not None:
            raise InvalidOption(
                f"{self._where}: another process connects with the files of a cqlshrc, not with an "
                "ssl_context: name its certificates in a cqlshrc"
            )
        return {
            "host": self.hosts,
            "port": self.port,
            "consistency": ConsistencyLevel.value_to_name[self.consistency],
            "username": self._login.username,
            "password": self._login.password,
            **self._files,
            "answer_sec": self._limit_sec,
        }

    def _make_link(self) -> Link:
        """Connect to the cluster; raises like the constructor."""
        try:
            cluster = self._make_cluster()
        except (UnresolvableContactPoints, UnicodeError) as exc:
            raise ConnectionFailed(
                f"no host of this name can be found: {','.join(self.hosts)!r}; check the name, "
                f"or give the address; {START_HINT}"
            ) from exc
        link = self._connect(cluster)
        self._connecting_until = time.monotonic() + CONNECT_TIMEOUT_SEC
        for keyspace in sorted(self._keyspaces):
            with suppress(*DRIVER_ERRORS):  # without it rows go by way of another node
                cluster.refresh_keyspace_metadata(keyspace)
        return link

    def _adopt(self, link: Link) -> None:
        # If a server has lost its prepared statements, the driver prepares them again from these.
        for statement in list(self._prepared.values()):
            link.cluster.add_prepared(statement.query_id, statement)

    @property
    def _cluster(self) -> Cluster:
        return self._links.current.cluster

    @property
    def _session(self) -> Session:
        return self._links.current.session

    def _make_cluster(self) -> Cluster:
        """Return a driver's cluster with our options, not connected yet."""
        name = self._login.username
        password = self._login.password
        auth = PlainTextAuthProvider(name, password or "") if name else None
        tls = self._login.tls
        context = self._ssl_context
        if tls and context is None:
            context = tls.context(self.hosts[0])
        profile = ExecutionProfile(
            load_balancing_policy=TokenAwarePolicy(
                DCAwareRoundRobinPolicy(), shuffle_replicas=True
            ),
            consistency_level=self.consistency,
            request_timeout=self._request_sec,
            row_factory=tuple_factory,
        )
        return Cluster(
            contact_points=self.hosts,
            port=self.port,
            protocol_version=PROTOCOL_VERSION,
            connection_class=connection_class(
                tls if self._ssl_context is None else None, self.schema_changes
            ),
            compression=False,
            auth_provider=auth,
            ssl_context=context,
            execution_profiles={EXEC_PROFILE_DEFAULT: profile},
            # A keyspace may have hundreds of tables; the driver would read them all after each
            # change.
            schema_metadata_enabled=False,
            # After a pushed change it would then only ask for the nodes' agreement again.
            schema_event_refresh_window=-1,
            # Without this option batches stall for 40 ms each on delayed acknowledgements.
            sockopts=[(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)],
            connect_timeout=self._connect_sec,
            control_connection_timeout=self._connect_sec,
            idle_heartbeat_interval=5,
            idle_heartbeat_timeout=5,
            reconnection_policy=ExponentialReconnectionPolicy(0.5, 10),
        )

    def _connect(self, cluster: Cluster) -> Link:
        """Open the two sessions of a cluster; raises like the constructor."""
        try:
            session = cluster.connect()
            raw_session = cluster.connect()
        except NoHostAvailable as exc:
            cluster.shutdown()
            by_tls = self._ssl_context is not None or self._login.tls is not None
            refusal = explain_refusal(host_errors(exc), self._login, by_tls, self._where)
            if refusal:
                raise refusal from exc
            causes = "; ".join(sorted({str(error) for error in host_errors(exc).values()}))
            raise ConnectionFailed(
                f"no Cassandra answers at {self._where} ({causes or 'no address'}); {START_HINT}",
                refused=not is_passing(exc),
            ) from exc
        except (*DRIVER_ERRORS, OSError) as exc:
            cluster.shutdown()
            raise ConnectionFailed(f"cannot connect to Cassandra at {self._where}: {exc}") from exc
        for new_session in (session, raw_session):
            # Clocks of robots are wrong, and rows stamped by a fast clock would hide later rows.
            new_session.use_client_timestamp = False
            # Bounds how long preparing a statement takes, for which the driver has no argument.
            new_session._default_timeout = self._connect_sec
        raw_session.client_protocol_handler = RawProtocolHandler
        return Link(cluster, session, raw_session)

    @property
    def closed(self) -> bool:
        """Whether this connection was closed and can neither read nor write any more."""
        return self._closed

    def __repr__(self) -> str:
        return f"<Cassandra {self._where}{', closed' if self._closed else ''}>"

    def require_open(self) -> None:
        """Raise ConnectionFailed if this connection is closed, or another process's.

        The driver would report a closed connection as an error that may pass, and be retried.

        Raises:
            StoreUnavailable: The program has to end, and the store does not answer.
        """
        if self._forks != _forks:
            raise ConnectionFailed(
                f"this process is a fork of {self._process}, which connected to Cassandra at "
                f"{self._where}, and a connection serves one process: make a RosCassandra in this "
                "one (PyTorch: in worker_init_fn; Celery: at worker_process_init)"
            )
        if self.outage.left_sec <= 0:
            raise StoreUnavailable(f"the store at {self._where} does not answer")
        if self._closed:
            raise ConnectionFailed(
                f"the connection to Cassandra at {self._where} is closed; make another RosCassandra"
            )

    @property
    def is_forked(self) -> bool:
        """Whether this process is a fork of the one that connected: it lacks the threads."""
        return self._forks != _forks

    def prepare(self, cql: str) -> PreparedStatement:
        """Return a prepared statement; each text is prepared once, by one thread at a time.

        After ``forget`` it is prepared again. Raises like ``execute``.
        """
        self.require_open()
        statement = self._prepared.get(cql)
        if statement is None:
            with self._prepare_lock:
                statement = self._prepared.get(cql) or self._prepare_new(cql)
                self._prepared[cql] = statement
                # Meanwhile the link may have been replaced by one that has not prepared it.
                self._cluster.add_prepared(statement.query_id, statement)
        return statement

    def _prepare_new(self, cql: str) -> PreparedStatement:
        """Prepare a statement, again for a moment if its table is not known; mark it idempotent."""
        pause = 0.05
        while True:
            try:
                statement = retried(
                    "preparing a statement", lambda: self._session.prepare(cql), outage=self.outage
                )
                statement.is_idempotent = True
                return statement
            except (TopicNotFound, KeyspaceNotFound):
                # Another client is making the table: system_schema shows it a moment before every
                # coordinator knows it.
                if pause > NEW_TABLE_SEC:
                    raise
            time.sleep(pause)
            pause *= 2

    def forget(self, table: str) -> None:
        """Drop the prepared statements of a table that was dropped, and of its chunk table.

        They are those whose text contains the table's name.
        """
        with self._prepare_lock:
            # A new dict: other threads read the old one without the lock.
            self._prepared = {cql: s for cql, s in self._prepared.items() if table not in cql}

    def execute(
        self,
        cql: str,
        params: Sequence[object] = (),
        *,
        what: str = "a query",
        consistency: int | None = None,
        retry_sec: Seconds = RETRY_SEC,
    ) -> list[CqlRow]:
        """Run one idempotent statement, with retries, and return all rows, decoded.

        Args:
            cql: Text with ``?`` for each parameter.
            what: What the statement does, for the error text ("reading the runs").
            consistency: The driver's number of another consistency level; None = the connection's.
            retry_sec: How long it is repeated while it fails.

        Raises:
            CassandraRosError: See ``retried``; ConnectionFailed: the connection is closed.
        """

        def run() -> list[CqlRow]:
            bound = self.prepare(cql).bind(tuple(params))
            if consistency is not None:
                bound.consistency_level = consistency
            return self._all_rows(self._session.execute_async(bound, timeout=None))

        return retried(what, run, seconds=retry_sec, outage=self.outage)

    def _all_rows(self, future: ResponseFuture) -> list[CqlRow]:
        """Wait for all pages of an answer and return their rows."""
        rows: list[CqlRow] = list(await_answer(future, self.outage).current_rows)
        while future.has_more_pages:
            future.start_fetching_next_page()
            rows += await_answer(future, self.outage).current_rows
        return rows

    def system_schema(self, of: str, names: str, keyspace: str, table: str = "") -> list[CqlRow]:
        """Read system_schema about a keyspace or one of its tables.

        Args:
            of: 'keyspaces', 'tables', 'columns' or 'indexes'.
            names: Names of the columns to read, divided by commas.
        """
        cql = f"SELECT {names} FROM system_schema.{of} WHERE keyspace_name = ?"
        what = f"reading the {of} of {keyspace}"
        if table:
            cql = f"{cql} AND table_name = ?"
            what = f"{what}.{table}"
        return self.execute(cql, (keyspace, table) if table else (keyspace,), what=what)

    def system_schema_of(
        self, of: str, names: str, keyspace: str, tables: Sequence[str]
    ) -> list[list[CqlRow]]:
        """Read system_schema about some tables of a keyspace, like system_schema.

        Returns:
            The rows of each table, in the order of ``tables``; empty for one that does not exist.
        """
        by_table: dict[str, list[CqlRow]] = {table: [] for table in tables}
        if by_table:
            cql = f"SELECT table_name, {names} FROM system_schema.{of} WHERE keyspace_name = ? "
            what = f"reading the {of} of {keyspace}"
            rows = self.execute(f"{cql}AND table_name IN ?", (keyspace, list(tables)), what=what)
            for table, *values in rows:
                by_table[table].append(tuple(values))
        return [by_table[table] for table in tables]

    def execute_on_each(
        self, cql: str, params: Sequence[object] = (), *, what: str
    ) -> dict[str, list[CqlRow]]:
        """Run one statement on each reachable node; return address → rows (for system_views)."""

        def run() -> dict[str, list[CqlRow]]:
            bound = self.prepare(cql).bind(tuple(params))
            nodes = self._nodes_in_reach()
            return {str(n.endpoint): list(self._session.execute(bound, host=n)) for n in nodes}

        return retried(what, run, outage=self.outage)

    def _nodes_in_reach(self) -> list[Host]:
        """Return the reachable nodes of our data centre; raises NoHostAvailable."""
        # A session is ready as soon as one node answers, and connects to the other nodes later:
        # wait for them.
        while True:
            connected = self._session.get_pool_state()
            centres = {host.datacenter for host in connected}
            coming = any(
                host.is_up is not False and host not in connected and host.datacenter in centres
                for host in self._cluster.metadata.all_hosts()
            )
            if not coming or time.monotonic() > self._connecting_until:
                break
            time.sleep(POOL_PAUSE_SEC)
        reachable = [host for host in connected if host.is_up]
        if not reachable:
            raise NoHostAvailable("no node is in reach", {})
        return reachable

    def execute_once(self, cql: str, params: Sequence[object] = (), *, what: str) -> list[CqlRow]:
        """Run a statement that is not idempotent (a lightweight transaction) without retries.

        Raises:
            CassandraRosError: It failed. It may have been carried out all the same.
        """
        bound = self.prepare(cql).bind(tuple(params))
        bound.is_idempotent = False
        with translated(what, self.outage.nodes):
            return self._all_rows(self._open_session().execute_async(bound, timeout=None))

    def _open_session(self) -> Session:
        """Return the session for a request without retries; wait while it is being replaced."""
        return self._links.await_open(RETRY_SEC).session

    def begin(
        self, cql: str, params: Sequence[object] = (), *, what: str, retry_sec: Seconds = RETRY_SEC
    ) -> Callable[[], list[CqlRow]]:
        """Send one idempotent statement; return a function that waits for its rows.

        If the request fails, this function repeats it, and raises, like execute.
        """
        bound = self.prepare(cql).bind(tuple(params))
        future = self._session.execute_async(bound, timeout=None)

        def answer() -> list[CqlRow]:
            try:
                return self._all_rows(future)
            except DRIVER_ERRORS:
                return self.execute(cql, params, what=what, retry_sec=retry_sec)

        return answer

    def execute_many(
        self, cql: str, params: Iterable[CqlRow], *, what: str, retry_sec: Seconds = RETRY_SEC
    ) -> list[list[CqlRow]]:
        """Run one idempotent statement with several sets of parameters, 16 at a time.

        Returns:
            The rows of each set of parameters, in the order of ``params``.
        """
        answers = (self.begin(cql, values, what=what, retry_sec=retry_sec) for values in params)
        return [answer() for answer in sent_ahead(answers, REQUESTS_AT_ONCE)]

    def schema_change(self, cql: str, *, what: str) -> None:
        """Run one DDL statement and wait until all nodes agree on the schema.

        Raises:
            StoreUnavailable: The nodes do not agree within SAME_SCHEMA_SEC.
        """
        self.change_schema([(cql, what)])

    def change_schema(self, changes: Sequence[SchemaChange]) -> None:
        """Run DDL statements that change different tables; wait until all nodes agree.

        One node gets them together, and carries them out one after the other; no other node has to
        agree. Several nodes get each statement after they have agreed on the one before it.

        Raises:
            StoreUnavailable: The nodes do not agree within SAME_SCHEMA_SEC.
            CassandraRosError: The first error. Statements after it are not sent; those on their
                way have been answered.
        """
        self.require_open()
        link, alone = self._links.await_open(RETRY_SEC), self.live_nodes() == 1
        # The driver's own wait asks only the nodes that it knows: of one there is nothing to ask.
        link.cluster.max_schema_agreement_wait = 0 if alone else AGREEMENT_SEC
        failures: list[CassandraRosError] = []

        def begin(change: SchemaChange) -> tuple[str, ResponseFuture]:
            cql, what = change
            with translated(what, self.outage.nodes):
                return what, link.session.execute_async(SimpleStatement(cql), timeout=60.0)

        # Lazy: after a failure no further statement is taken, and so none is sent.
        changes_left = takewhile(lambda _: not failures, changes)
        for what, future in sent_ahead(map(begin, changes_left), CHANGES_AT_ONCE if alone else 1):
            try:
                with translated(what, self.outage.nodes):
                    future.result()
                if not alone:
                    self._agree(what)
            except CassandraRosError as exc:
                failures.append(exc)
        if failures:
            raise failures[0]

    def await_same_schema(self, what: str) -> None:
        """Wait until all nodes have the same schema, however many there are.

        Raises:
            StoreUnavailable: They do not agree within SAME_SCHEMA_SEC.
        """
        if self.live_nodes() > 1:
            self._agree(what)

    def _agree(self, what: str) -> None:
        """Wait until all nodes have the same schema.

        The driver has already waited, and asked the node that made the change. That wait is needed:
        the one here may ask a node that has not heard of the change yet, and find it in agreement
        with others that have not. This one is needed because the driver does not tell whether it
        gave up.

        Raises:
            StoreUnavailable: The nodes do not agree within SAME_SCHEMA_SEC.
        """
        agreed, deadline = False, time.monotonic() + SAME_SCHEMA_SEC
        with translated(what, self.outage.nodes):
            while not agreed and time.monotonic() < deadline:
                agreed = self._cluster.control_connection.wait_for_schema_agreement(wait_time=5.0)
        if not agreed:
            raise translate(TimeoutError("the nodes do not agree on the schema"), what)

    def execute_text(self, cql: str, *, what: str) -> None:
        """Run once, without retries, a statement that cannot be prepared, but no DDL statement."""
        self.require_open()
        with translated(what, self.outage.nodes):
            self._open_session().execute(SimpleStatement(cql))

    def use_keyspace(self, keyspace: str) -> None:
        """Read how a keyspace is replicated, so that rows go straight to a node that holds them."""

        def refresh() -> None:
            self.require_open()
            try:
                self._links.await_open(RETRY_SEC).cluster.refresh_keyspace_metadata(keyspace)
            except DriverException as exc:
                if type(exc) is not DriverException:
                    raise
                # The driver logs why its own connection got no answer, and raises no kind of error.
                raise OperationTimedOut(str(exc)) from exc

        retried(f"reading the replication of {keyspace}", refresh, outage=self.outage)
        self._keyspaces.add(keyspace)

    def send_raw(self, statement: Statement) -> ResponseFuture:
        """Send a bound or batch statement; the rows of its answer are undecoded bytes."""
        self.require_open()
        raw_session = self._links.current.raw_session
        return raw_session.execute_async(statement, timeout=self._request_sec)

    def ask_raw(self, statement: Statement) -> ResponseFuture:
        """Send a statement like send_raw, without a timer; ``await_answer`` waits for it."""
        self.require_open()
        return self._links.current.raw_session.execute_async(statement, timeout=None)

    def server_time_us(self) -> int:
        """Return the server's time in microseconds since 1970, with which it stamps writes."""
        cql = "SELECT toUnixTimestamp(now()) FROM system.local"
        # The server's clock has milliseconds: return the end of the present one.
        return int(self.execute(cql, what="asking for the time")[0][0]) * 1000 + 999

    def _nodes_now(self) -> str:
        """Return a text that says which nodes answer and which do not.

        '' if all do or none does.
        """
        link = self._links.current
        states = link.session.get_pool_state().items()
        there = {host for host, state in states if state["open_count"]}
        hosts = sorted(link.cluster.metadata.all_hosts(), key=lambda host: str(host.endpoint))
        up = [host.address for host in hosts if host in there]
        down = [host.address for host in hosts if host not in there]
        if not (up and down):
            return ""
        level = ConsistencyLevel.value_to_name[self.consistency]
        return (
            f"of {len(hosts)} nodes {', '.join(up)} answers and {', '.join(down)} does not; "
            f"{level} needs {_NEEDS.get(level, 'more copies of a row')}: start the others again"
            f"{'' if level in _LEAST else _READ_ANYWAY}"
        )

    @property
    def finds_all_written(self) -> bool:
        """Whether a read finds all that clients of the same consistency level have written."""
        return is_quorum(ConsistencyLevel.value_to_name[self.consistency])

    def live_nodes(self) -> int:
        """Return the number of nodes that the driver knows, up or down, in all data centres."""
        return max(1, sum(1 for _ in self._cluster.metadata.all_hosts()))

    def local_nodes(self) -> int:
        """Return the number of nodes that the driver knows, up or down, in its own data centre."""
        local, hosts = self.local_datacenter(), self._cluster.metadata.all_hosts()
        return max(1, sum(1 for host in hosts if host.datacenter == local))

    def expect_nodes(self, count: int) -> None:
        """Let require_nodes refuse to make a keyspace before the driver knows ``count`` nodes."""
        self._expected_nodes = count

    def require_nodes(self, keyspace: str) -> None:
        """Raise StoreUnavailable if a keyspace that is made now would keep too few copies.

        A cluster that is just being started has one node at first.
        """
        there = self.live_nodes()
        if there < self._expected_nodes:
            raise StoreUnavailable(
                f"of the {self._expected_nodes} nodes of the local Cassandra {there} can be seen, "
                f"so keyspace {keyspace}, which is missing, would keep too few copies of its "
                "messages: wait for the others, or start them"
            )

    def local_datacenter(self) -> str:
        """Return the name of the data centre of the node that we are connected to."""
        rows = self.execute("SELECT data_center FROM system.local", what="asking for the node")
        return str(rows[0][0])

    def close(self) -> None:
        """Close the connection; a second call is harmless, and one in a fork does nothing."""
        if not (self._closed or self.is_forked):
            self._closed = True
            self.schema_changes.may_have_missed()  # no list of tables is up to date any more
            # If the program has to end and the server is silent, do not wait for a proper end.
            hurried = self.outage.left_sec < math.inf
            self._links.close(LAST_WORD_SEC if hurried else None)

    def __enter__(self) -> Cassandra:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def is_quorum(level: str) -> bool:
    """Return whether what is written at a consistency level is found by all reads at it."""
    return "QUORUM" in level.upper() or level.upper() == "ALL"


def _consistency_level(name: str) -> int:
    """Return the driver's number of a consistency level; raises ConnectionFailed."""
    levels = ConsistencyLevel.name_to_value
    if name.upper() not in levels:
        raise ConnectionFailed(
            f"{name!r} is not a consistency level; there are {', '.join(sorted(levels))}"
        )
    return int(levels[name.upper()])
