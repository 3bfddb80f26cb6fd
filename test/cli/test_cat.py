# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""cassandra_bag cat as it is typed."""

from __future__ import annotations

import base64
import json

import yaml
from geometry_msgs.msg import Twist
from std_msgs.msg import Float64, String, UInt8MultiArray

T = 1_400_000_000_123_456_789


def test_cat(rosCas, call, cql):
    twists = [Twist() for _ in range(3)]
    topic = rosCas.addTopic("/cmd_vel", format="packed")
    for n, twist in enumerate(twists):
        twist.linear.x = n / 4
        topic.addData(twist, key=T + n * 10**9, nodeID="r1")
    rosCas.addTopic("/name").addData(String("x: 'y'\x1b"), key=T + 1)
    rosCas.addTopic("/bytes").addData(UInt8MultiArray(data=b"\x01\x02"), key=T + 2)
    rosCas.addTopic("/nan").addData(Float64(float("nan")), key=T + 3)

    # To the letter what rostopic echo prints, and all together YAML.
    status, out, err = call("cat", "/cmd_vel")
    assert (status, err) == (0, "")
    assert [part.split("\n", 1)[1] for part in out.split("\n---\n")[:-1]] == [*map(str, twists)]
    head = "# /cmd_vel 2014-05-13T16:53:20.123456789Z 1400000000123456789 geometry_msgs/Twist r1"
    assert out.splitlines()[0] == head
    assert [found["linear"]["x"] for found in yaml.safe_load_all(out) if found] == [0, 0.25, 0.5]

    # Several topics by time, a part of them, short.
    out = call("cat")[1]
    names = ["/cmd_vel", "/name", "/bytes", "/nan", "/cmd_vel", "/cmd_vel"]
    assert [line.split()[1] for line in out.splitlines() if line.startswith("#")] == names
    assert "\x1b" not in out
    assert call("cat", "-n", "2")[1].count("---") == 2
    assert call("cat", "-e", "/c.*", "--where", "/cmd_vel: linear.x > 0.3")[1].count("---") == 1
    assert call("cat", "--start", f"{T + 10**9}", "--node-id", "r1")[1].count("---") == 2
    out = call("cat", "/bytes", "/name", "--noarr", "--nostr")[1]
    assert 'data: "<array type: uint8, length: 2>"' in out and "<string length: 7>" in out

    found = json.loads(call("cat", "--json")[1])
    assert [each["topic"] for each in found] == names
    assert found[0]["message"]["linear"] == {"x": 0, "y": 0, "z": 0}
    assert (found[0]["time_ns"], found[0]["node"], found[0]["type"]) == (T, "r1", Twist._type)
    assert base64.b64decode(found[2]["message"]["data"]) == b"\x01\x02"
    assert found[3]["message"]["data"] is None
    # Seconds, as rosbag has them: no nanoseconds that are meant as seconds.
    assert json.loads(call("cat", "--json", "--end", "5")[1]) == []

    # What cannot be read is told, and the others come.
    table = rosCas.getTopic("/name").tables[0]
    cql.execute(
        f'UPDATE {table.qualified} SET "_size" = 3 WHERE "_node" = \'\' AND "_bucket" = '
        f'{table.bucket_of(T + 1)} AND "_t" = {T + 1} AND "_seq" = '
        f"{rosCas.getTopic('/name').getRow(T + 1).seq}"
    )
    status, out, err = call("cat")
    assert (status, out.count("---"), err.count("\n")) == (1, 5, 1)
    assert f"the message of topic /name at {T + 1} has 11 bytes instead of 3" in err
