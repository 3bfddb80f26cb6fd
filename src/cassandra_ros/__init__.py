# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Keep ROS topics in Apache Cassandra: every message a row, stored exactly, found by time."""

from __future__ import annotations

from pkgutil import extend_path

# The generated modules cassandra_ros.msg and .srv are in another folder of the same name.
__path__ = extend_path(__path__, __name__)

_PUBLIC = {
    "Bag": "cassandra_ros.files.bag.stored_bag",
    "Cassandra": "cassandra_ros.store.connection.cassandra",
    "CassandraTopic": "cassandra_ros.topics.cassandra_topic",
    "Fleet": "cassandra_ros.stores.fleet.fleet",
    "HistorySubscriber": "cassandra_ros.nodes.history_subscriber",
    "MapOptions": "cassandra_ros.viewing.mapping.map_builder",
    "OccupancyMap": "cassandra_ros.viewing.mapping.occupancy",
    "Player": "cassandra_ros.nodes.player",
    "PlayerOptions": "cassandra_ros.playing.play_options",
    "PlaySelection": "cassandra_ros.playing.play_selection",
    "PoseChoice": "cassandra_ros.viewing.mapping.sensor_poses",
    "Recorder": "cassandra_ros.nodes.recorder",
    "RecorderOptions": "cassandra_ros.recording.recorder_options",
    "Replicator": "cassandra_ros.stores.copying.replicator",
    "RosCassandra": "cassandra_ros.client.ros_cassandra",
    "CassandraTopic_": "cassandra_ros.messages.formats.cassandra_topic_",
    "CassandraTopic_binary": "cassandra_ros.messages.formats.binary",
    "CassandraTopic_json": "cassandra_ros.messages.formats.json",
    "CassandraTopic_ros": "cassandra_ros.messages.formats.ros",
    "CassandraTopic_string": "cassandra_ros.messages.formats.string",
    "CassandraTopic_yaml": "cassandra_ros.messages.formats.yaml",
    "makeMap": "cassandra_ros.viewing.mapping.map_builder",
    "Stamp": "cassandra_ros.messages.stamps",
    "CassandraRosError": "cassandra_ros.errors",
}

__all__ = list(_PUBLIC)


def __getattr__(name: str) -> object:
    # Modules are loaded on first use, so that a node that only uses cassandra_ros.srv does not need
    # the database driver.
    if name not in _PUBLIC:
        raise AttributeError(f"module 'cassandra_ros' has no attribute '{name}'")
    from importlib import import_module

    try:
        value = getattr(import_module(_PUBLIC[name]), name)
    except ModuleNotFoundError as exc:
        from cassandra_ros.errors import MissingDependency
        from cassandra_ros.installation import explain_missing, is_needed

        if not is_needed(exc):
            raise
        raise MissingDependency(explain_missing(exc)) from None
    globals()[name] = value
    return value


def __dir__() -> list:  # type: ignore[type-arg]
    return sorted(__all__)
