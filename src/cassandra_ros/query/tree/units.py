# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Units of numbers, as far as ROS defines them: those of REP 103, by type and field.

Definitions have no units. The table holds what the comments in ROS's own messages say; all other
fields have no unit.
"""

from __future__ import annotations

from typing import Sequence

from cassandra_ros.messages.definition import Definition
from cassandra_ros.query.tree.field_names import FieldStep, field_of
from cassandra_ros.query.tree.syntax import Aggregate, Call, FieldPath, StatementError, Term

SECONDS = "s"
"""Unit in which durations are shown."""
_SAME = ("abs", "neg", "min", "max", "sum", "avg")
"""Functions whose result has the unit of their operand."""

_METRES, _RADIANS = "m", "rad"
_BY_NAME = {"latitude": "°N", "longitude": "°E"}
"""Units of fields with these names, in any type. They differ, because a plot axis that had to
include both would hide the changes of each."""
_UNITS = {
    "geometry_msgs/Point": {"x": _METRES, "y": _METRES, "z": _METRES},
    "geometry_msgs/Point32": {"x": _METRES, "y": _METRES, "z": _METRES},
    "geometry_msgs/Pose2D": {"x": _METRES, "y": _METRES, "theta": _RADIANS},
    "geometry_msgs/Transform": {"translation": _METRES},
    "geometry_msgs/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/Accel": {"linear": "m/s²", "angular": "rad/s²"},
    "geometry_msgs/Wrench": {"force": "N", "torque": "N·m"},
    "geometry_msgs/Inertia": {"m": "kg", "com": _METRES},
    "nav_msgs/MapMetaData": {"resolution": "m"},
    "sensor_msgs/Imu": {"angular_velocity": "rad/s", "linear_acceleration": "m/s²"},
    "sensor_msgs/MagneticField": {"magnetic_field": "T"},
    "sensor_msgs/NavSatFix": {
        "altitude": _METRES,
        "position_covariance": "m²",
    },
    "sensor_msgs/LaserScan": {
        **dict.fromkeys(("angle_min", "angle_max", "angle_increment"), _RADIANS),
        **dict.fromkeys(("range_min", "range_max", "ranges"), _METRES),
        **dict.fromkeys(("time_increment", "scan_time"), SECONDS),
    },
    "sensor_msgs/Range": {
        "field_of_view": _RADIANS,
        **dict.fromkeys(("min_range", "max_range", "range"), _METRES),
    },
    "sensor_msgs/BatteryState": {
        **{"voltage": "V", "current": "A", "cell_voltage": "V", "temperature": "°C"},
        **dict.fromkeys(("charge", "capacity", "design_capacity"), "Ah"),
    },
    "sensor_msgs/FluidPressure": {"fluid_pressure": "Pa", "variance": "Pa²"},
    "sensor_msgs/Illuminance": {"illuminance": "lx"},
    "sensor_msgs/Temperature": {"temperature": "°C", "variance": "°C²"},
    "sensor_msgs/TimeReference": {"time_ref": SECONDS},
}


def unit_of_field(steps: Sequence[FieldStep], definition: Definition) -> str:
    """Return the unit of the field to which steps lead; '' = unknown."""
    unit, msg_type = "", definition.type
    for step in steps:
        # The innermost message with a unit decides: an angular velocity is a plain Vector3.
        unit = _UNITS.get(msg_type, {}).get(step.name, unit)
        spec = definition.specs.get(msg_type)
        fields = () if spec is None else spec.fields
        msg_type = next((field.type for field in fields if field.name == step.name), "")
    return _BY_NAME.get(steps[-1].name, unit) if steps else unit


def unit_of(what: Term | Aggregate, definition: Definition) -> str:
    """Return the unit of a selected term; '' = unknown, also if this definition lacks a field."""
    if isinstance(what, FieldPath):
        try:
            ref = field_of(what, definition, None)
        except StatementError:
            return ""
        return "" if ref.part else unit_of_field(ref.steps, definition)
    if isinstance(what, Aggregate):
        operand = what.operand if what.function in _SAME else None
        return "" if operand is None else unit_of(operand, definition)
    if isinstance(what, Call) and what.function in _SAME:
        return unit_of(what.arguments[0], definition)
    if isinstance(what, Call) and what.function in ("+", "-"):
        units = {unit_of(argument, definition) for argument in what.arguments}
        return units.pop() if len(units) == 1 else ""
    return ""
