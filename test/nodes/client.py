# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Calls services: a line of JSON in, [service, request]; a line of JSON out, the response."""

from __future__ import annotations

import base64
import functools
import json
import sys

import genpy
import rospy
import rosservice


def plain(value):
    if isinstance(value, genpy.Message):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, (genpy.Time, genpy.Duration)):
        return value.to_nsec()
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    if isinstance(value, (list, tuple)):
        return [plain(element) for element in value]
    return value


@functools.lru_cache(maxsize=None)
def service_class(name):
    for _ in range(25):
        try:
            return rosservice.get_service_class_by_name(name)
        except rosservice.ROSServiceIOException:  # after 5 s: a busy machine
            pass
    return rosservice.get_service_class_by_name(name)


def answer(line):
    name, fields = json.loads(line)
    service = service_class(name)
    request = service._request_class()
    for field, value in fields.items():
        if isinstance(getattr(request, field), genpy.Time):
            value = genpy.Time(0, value)
        setattr(request, field, value)
    try:
        return plain(rospy.ServiceProxy(name, service)(request))
    except (rospy.ServiceException, rosservice.ROSServiceException) as exc:
        return {"error": str(exc)}


def main():
    rospy.init_node("client", anonymous=True, disable_signals=True)
    print("ready", flush=True)
    for line in sys.stdin:
        # At once: print writes the end of a line by itself, behind what others log meanwhile.
        sys.stdout.write(json.dumps(answer(line)) + "\n")
        sys.stdout.flush()
    rospy.signal_shutdown("no more requests")


main()
