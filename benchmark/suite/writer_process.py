# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""One of several writers of a topic: HOST PORT KEYSPACE FORMAT COUNT."""

from __future__ import annotations

import sys

from cassandra_ros import RosCassandra
from cassandra_ros.store.tables.lengths import bucket_for, span_for
from suite.messages import imu

TOPIC = "/many"


def main() -> None:
    """Write the messages when told to."""
    host, port, keyspace, format, count = sys.argv[1:]
    batch = imu(int(count)).first(int(count), TOPIC)
    with RosCassandra(host, int(port), keyspace=keyspace) as store:
        with store.messageWriter(format=format, block_sec=None) as writer:
            bucket_ns, span_ns = bucket_for(*batch.rate), span_for(*batch.rate)
            handle = writer.connect(batch.connection, bucket_ns, span_ns=span_ns)
            print("ready", flush=True)
            sys.stdin.readline()
            for number, (t_ns, wire) in enumerate(zip(batch.times, batch.wires)):
                writer.write(handle, t_ns, number, wire)
        print("done", flush=True)


if __name__ == "__main__":
    main()
