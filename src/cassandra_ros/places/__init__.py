# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Where robots were: transforms at a past time, poses, and the places that they have visited.

``poses`` and ``frame_poses`` give the poses of many times at once, out of tf or of a topic that
tells them; a topic of latitude and longitude tells them in the plane of ``earth``. ``whereabouts``
finds when a robot was in a region, by an index of coarse cells (``run_index``) as far as that goes.
``transforms/`` looks up one time.

``array_source`` says what the caller must offer, which has the topics.

In: the topics of a keyspace by those interfaces. Out: arrays of poses, transforms, time ranges.
topics/ uses this room, and is not known here.
This room imports query/, messages/ and store/tables/. tf2_py and geometry_msgs come in here.
"""
