# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Messages in files: bags, MCAP, and the files of the spool; no rospy here.

- ``bag/``: read, import, export and verify. We read and write bag format 2.0 ourselves: chunk by
  chunk in bounded memory, without generated classes (a definition in a bag is text from outside),
  and with all connections byte for byte. MCAP files are written by the mcap library, and read by
  our own walk over their records. ``importer`` and ``exporter`` do the work; ``stored_bag`` is a
  stored run as a ``rosbag.Bag``.
- ``spool/``: received messages that wait on disk until the store has them, in files that are only
  appended to (``segment_writer``) and read past any damage (``segment_reader``).

In: files, topics. Out: connections and messages, files.
This room imports stores/fleet/, client/ and what client/ imports. rosbag, mcap and lz4 come in
here.
"""
