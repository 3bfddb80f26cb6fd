# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Topics: how they are named, listed, read, written, counted and kept in order.

``cassandra_topic`` has CassandraTopic, a topic as programs see it (paper, section 3). ``keyspace``
holds the parts of a keyspace, ``catalog`` its topics by their names; the rooms above take one of
these. ``message_writer`` stores messages, ``row_reader`` reads rows, and goes on while a topic is
converted. Folders:

- ``overview/``: what is drawn or counted over time: timelines, series, envelopes, samples, latest
  and latched messages.
- ``upkeep/``: work on many topics at once: deletion, retention, checks, conversion, the index of
  places.

In: connections and serialised messages; names and a ``Read``. Out: rows, messages, numbers.
This room imports places/, query/, store/ and messages/.
"""
