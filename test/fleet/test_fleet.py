# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Several stores asked as one: each message once, in order, and who does not answer is named."""

from __future__ import annotations

import contextlib
import random
import re
import socket
from itertools import product

import pytest
from geometry_msgs.msg import Twist
from hypothesis import given
from hypothesis import strategies as st
from nodes.children import await_true
from proxy import Proxy
from sensor_msgs.msg import Image
from std_msgs.msg import String
from suites import FURTHER, search

from cassandra_ros import Fleet
from cassandra_ros.errors import (
    ConnectionFailed,
    CorruptMessage,
    EventNotFound,
    InvalidKey,
    InvalidOption,
    InvalidQuery,
    MessageNotFound,
    RunNotFound,
    SchemaConflict,
    StoreUnavailable,
    TopicNotFound,
)
from cassandra_ros.files.bag.fleet_export import export_fleet
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.messages.stamps import Stamp
from cassandra_ros.playing.play_selection import PlaySelection, chosen_topics
from cassandra_ros.playing.played_fleet import PlayedFleet
from cassandra_ros.read import EVERYBODY, Read
from cassandra_ros.stores.copying.replicator import Replicator
from cassandra_ros.stores.fleet.fleet_answer import FleetAnswer
from cassandra_ros.stores.fleet.fleet_info import describe_topic
from cassandra_ros.stores.fleet.fleet_topic import find_topic

SEC = 10**9
T0 = 1_500_000_000 * SEC
PATIENT_SEC = 180.0
"""Answer time of stores that answer, however busy the machine is."""
HEIGHTS = "SELECT height FROM image"
LAYOUTS = [
    [("ros", "packed"), ("packed",), ("binary",)],
    [("packed",), ("packed",), ("packed",)],
    [("ros",), ("ros",), ("ros",)],
    [("json",), ("ros", "packed"), ()],
]
"""Formats of the topic in each of three stores."""


def twist(number):
    msg = Twist()
    msg.linear.x, msg.linear.y = number % 7, float(number)
    return msg


def messages(seed, count=120):
    """(t, node, writer, counter, message) of several robots, with many equal times."""
    rand, found = random.Random(seed), []
    for number in range(count):
        t = T0 + rand.randrange(40) * SEC // 4
        counter = 1000 * seed + number  # a writer gives each number once
        found.append((t, rand.choice(["", "husky"]), rand.choice([3, 7]), counter, twist(number)))
    return found


def write(store, topic, format, rows):
    """Store messages as a recorder or a copy would."""
    kinds = {(node, writer) for _, node, writer, _, _ in rows}
    for node, writer_id in sorted(kinds):
        with store.messageWriter(writer_id=writer_id, nodeID=node, format=format) as writer:
            connection = api_connection(topic, definition_of(Twist), f"/{node}")
            handle = writer.connect(connection, bucket_ns=SEC)
            for t, at, by, number, msg in rows:
                if (at, by) == (node, writer_id):
                    writer.write(handle, t, number, serialize(msg))


def place(store):
    return f"{store.cassandra.hosts[0]}:{store.cassandra.port}/{store.keyspace}"


def fleet_of(*stores, **options):
    return Fleet([place(store) for store in stores], **options)


def plain(rows):
    return [(r.t, r.node, r.seq, r.name, r.topic, r.received, r.run, r.wire) for r in rows]


@pytest.fixture
def stores(fresh):
    """Three empty stores."""
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(fresh()) for _ in range(3)]


@pytest.fixture(scope="module")
def mixed(fresh):
    """A fleet of three stores that overlap, and one store that has all messages."""
    with contextlib.ExitStack() as stack:
        *three, whole = [stack.enter_context(fresh()) for _ in range(4)]
        for number, layout in enumerate(LAYOUTS):
            rows, rand, topic = messages(number), random.Random(number), f"/t{number}"
            write(whole, topic, "ros", rows)
            # Of each message the stores, at least one of those that have the topic.
            having = [n for n, formats in enumerate(layout) if formats]
            spread = [set(rand.sample(having, rand.randint(1, len(having)))) for _ in rows]
            for n in having:
                mine = [row for row, where in zip(rows, spread) if n in where]
                for m, format in enumerate(layout[n]):
                    write(three[n], topic, format, mine[m :: len(layout[n])])
        with fleet_of(*three) as fleet:
            yield fleet, whole


TOPICS = st.sampled_from([f"/t{number}" for number in range(len(LAYOUTS))])
TIMES = st.none() | st.integers(-1, 41).map(lambda n: T0 + n * SEC // 4)
LIMITS = st.none() | st.integers(0, 130)
ROBOTS = st.sampled_from([None, "", "husky", "nobody"])
WHERE = st.sampled_from([None, "linear.x > 3", "linear.y < 50.0 AND NODE = 'husky'", "RUN = '7'"])


@pytest.mark.suite("all", "a search; make test asks some of its cases")
@search(200)
@given(topic=TOPICS, low=TIMES, high=TIMES, limit=LIMITS, robot=ROBOTS, where=WHERE, data=st.data())
def test_a_fleet_answers_like_one_store_with_all_messages(
    mixed, topic, low, high, limit, robot, where, data
):
    fleet, whole = mixed
    reverse = data.draw(st.booleans())
    asked = {"nodeID": robot, "limit": limit, "reverse": reverse, "where": where}
    rows = fleet.rows(topic, low, high, **asked)
    finder = whole.getTopic(topic)._finder(robot, where)
    expected = finder.many(low, high, limit=limit, reverse=reverse)
    assert plain(rows) == plain(expected)
    assert not rows.partial
    if not reverse:
        chosen = {} if where is None else {topic: where}
        received = data.draw(st.booleans())
        times = {"nodeID": robot, "where": chosen, "received": received}
        together = fleet.readMessages([topic, "t1"], low, high, **times)
        assert plain(together) == plain(whole.readMessages([topic, "t1"], low, high, **times))


STATEMENTS = [
    "SELECT KEY, NODE, linear.x FROM {} WHERE KEY >= {} {}",
    "SELECT count(*) FROM {} WHERE KEY >= {}",
    "SELECT count(*) FROM {} WHERE KEY < {} AND NODE = 'husky'",
    "SELECT count(*), min(linear.y), max(linear.y), sum(linear.x) FROM {} WHERE KEY <= {}",
    "SELECT linear.x, count(*) FROM {} WHERE KEY > {} GROUP BY linear.x ORDER BY linear.x",
    "SELECT linear.y, RUN FROM {} WHERE KEY > {} AND RUN = '3' {}",
    "SELECT DISTINCT linear.x FROM {} WHERE KEY > {} {}",
]


@pytest.mark.suite("test", "statements over several stores")
@search(200)
@given(
    statement=st.sampled_from(STATEMENTS),
    topic=TOPICS,
    t=st.integers(-1, 41),
    order=st.sampled_from(["", "ORDER BY KEY DESC", "ORDER BY KEY LIMIT 7", "LIMIT 7"]),
    limit=st.none() | st.integers(0, 20),
)
def test_statements_are_answered_over_messages_that_count_once(
    mixed, statement, topic, t, order, limit
):
    fleet, whole = mixed
    text = statement.format(topic, T0 + t * SEC // 4, order if "DISTINCT" not in statement else "")
    found, expected = fleet.executeCQL(text, limit=limit), whole.executeCQL(text, limit=limit)
    assert found == expected
    assert found.columns == expected.columns
    assert not found.partial


@pytest.mark.suite("test", "messages of several stores that count once")
def test_messages_and_single_ones(mixed):
    fleet, whole = mixed
    topic = whole.getTopic("t0")
    pairs = list(fleet.items("t0"))
    assert [(key, msg) for key, msg in pairs] == list(topic.items())
    assert fleet.getData("t0", T0, T0 + 3 * SEC) == topic.getData(T0, T0 + 3 * SEC)
    for key, msg in pairs[:40]:
        assert fleet.getData("/t0", key) == msg
        assert fleet.getData("/t0", key.ns) == topic.getData(key.ns)
    for nearest in ("before", "after", "either"):
        for t in (T0 - 5, T0 + 1, T0 + 5 * SEC + 7, T0 + 10**12):
            found = fleet.getRow("t0", t, nearest=nearest)
            expected = topic.getRow(t, nearest=nearest)
            assert (found and found.identity) == (expected and expected.identity)
    assert fleet.getData("t0", T0 - 1, default=None) is None
    with pytest.raises(MessageNotFound, match="no store of the fleet has a message"):
        fleet.getData("t0", T0 - 1)
    with pytest.raises(InvalidKey):
        fleet.getData("t0", 5, nearest="before")
    assert fleet.topics() == ["/t0", "/t1", "/t2", "/t3"]


def test_a_topic_of_two_spellings_is_listed_once(stores):
    first, second, third = stores
    fill(first, "scan", range(2))
    fill(second, "/scan", range(2, 4))
    fill(third, "tf", range(1))
    fill(third, "/tf", range(1))
    with fleet_of(*stores) as fleet:
        assert fleet.topics() == ["/tf", "scan", "tf"]
        assert chosen_topics(PlayedFleet(fleet), PlaySelection()) == ["/tf", "scan", "tf"]
        assert [info.count for info in fleet.info(["/scan"])] == [4]
    with fleet_of(second, first) as fleet:
        assert fleet.topics() == ["/scan"]


@pytest.mark.suite("test", "pages of a fleet")
def test_a_read_goes_on_after_any_row(mixed):
    """Rows of a page and of the next one are those of one read: none twice, none left out."""
    fleet, whole = mixed
    answer = FleetAnswer(fleet.stores)
    for name in ("/t0", "/t1"):
        topic = find_topic(answer, name)
        rows = list(topic.read(Read()))
        assert plain(rows) == plain(whole.getTopic(name).rows())
        for n in range(0, len(rows), 9 if FURTHER else 40):
            assert plain(topic.read(Read(after=rows[n].position))) == plain(rows[n + 1 :])


def test_each_message_counts_once_in_info(mixed):
    fleet, whole = mixed
    found = fleet.info()
    facts = [(i.topic, i.type, i.node, i.count, i.bytes, i.first_ns, i.last_ns) for i in found]
    expected = [
        (i.topic, i.type, i.node, i.count, i.bytes, i.first_ns, i.last_ns) for i in whole.info()
    ]
    assert facts == expected
    assert all(sum(info.stores.values()) > info.count for info in found)
    assert [i.count for i in fleet.info(["t1"], nodeID="husky", run=7)] == [
        i.count for i in whole.info(["t1"], nodeID="husky", run=7)
    ]


def fill(store, topic, numbers, **added):
    casTopic = store.addTopic(topic, **added)
    for n in numbers:
        casTopic.addData(String(str(n)), key=T0 + n * SEC)
    store.catalog.adder.close()


@pytest.mark.suite("all", "make test asks others of its kind")
def test_copies_are_the_same_messages_also_under_names(stores, connect):
    robot, home, other = stores
    fill(robot, "/s", range(6))
    robot.addTopic("/map", key_format="manual").addData(String("old"), key="kitchen")
    robot.addTopic("/h", key_format="hash").addData(String("equal"))
    robot.catalog.adder.close()
    Replicator(robot, home).copy()
    robot.getTopic("/map").addData(String("new"), key="kitchen")
    fill(robot, "/s", range(6, 9))
    other.addTopic("/h", key_format="hash").addData(String("equal"))
    fill(other, "/s", [3], nodeID="jackal")
    for asked in (stores, [home, robot, other], [home, robot]):
        with fleet_of(*asked) as fleet:
            rows = list(fleet.rows("s"))
            values = [row.message().data for row in rows]
            assert values == [str(n) for n in (0, 1, 2, 3, *[3] * (len(asked) > 2), 4, 5, 6, 7, 8)]
            assert rows[0].stores == [n for n in map(place, asked) if n != place(other)]
            assert [msg.data for _, msg in fleet.items("map")] == ["old", "new"]
            assert fleet.getData("map", "kitchen") == String("new")
            for reverse in (False, True):
                assert [m for _, m in fleet.items("h", reverse=reverse)] == [String("equal")]
            assert fleet.executeCQL("SELECT count(*) FROM h") == [(1,)]
            assert len(list(fleet.readMessages(["h", "map"]))) == 3
            assert len(list(fleet.readMessages(received=True))) == 3 + len(values)


@pytest.mark.suite("all", "make test asks others of its kind")
def test_who_lacks_a_topic_is_not_missing_and_if_all_do_all_are_named(stores, connect, cassandra):
    first, second, _ = stores
    fill(first, "/a", [1])
    nowhere = f"{cassandra.host}:{cassandra.port}/is_not_there"
    names = [place(first), place(second), nowhere]
    with Fleet(names) as fleet:
        rows = fleet.rows("a")
        assert (len(list(rows)), rows.missing, rows.partial) == (1, {}, False)
        for ask in (fleet.rows, fleet.getData, lambda t, *_: fleet.readMessages([t])):
            with pytest.raises(TopicNotFound) as caught:
                ask("b", T0)
            assert all(name in str(caught.value) for name in names)
        with pytest.raises(InvalidQuery) as caught:
            fleet.executeCQL("SELECT * FROM b")
        assert all(name in str(caught.value) for name in names)
        with pytest.raises(RunNotFound):
            fleet.rows("a", run="is not there")


def test_what_has_no_common_meaning_is_refused(stores):
    first, second, _ = stores
    fill(first, "/a", [1])
    second.addTopic("/a", key_format="manual").addData(String("x"), key="name")
    second.catalog.adder.close()
    fill(second, "/b", [1])
    fill(first, "/b", [2])
    fill(first, "/c", [1])
    with fleet_of(first, second) as fleet:
        with pytest.raises(SchemaConflict, match="time in .*manual in "):
            fleet.rows("a")
        with pytest.raises(InvalidQuery, match="only read"):
            fleet.executeCQL("DELETE FROM b WHERE KEY > 5")
        with pytest.raises(InvalidQuery, match="NEAR is answered by one store"):
            fleet.executeCQL("SELECT * FROM b WHERE NEAR(1, 2, 3)")
        with pytest.raises(InvalidQuery, match="data.x"):
            fleet.executeCQL("SELECT data.x FROM b")
        with pytest.raises(InvalidOption, match="which is not read"):
            fleet.readMessages(["c"], where={"b": "data = 'x'"})


def test_events_of_all_stores_count(stores):
    first, second, _ = stores
    fill(first, "/a", range(10))
    Replicator(first, second).copy()
    first.addEvent("bump", T0, T0 + 2 * SEC)
    second.addEvent("bump", T0 + 5 * SEC, T0 + 6 * SEC)
    with fleet_of(first, second) as fleet:
        found = fleet.executeCQL("SELECT data FROM a WHERE EVENT 'bump' ORDER BY KEY DESC")
        assert [data for (data,) in found] == ["6", "5", "2", "1", "0"]
        rows = fleet.readMessages(event=("bump", 0, 1.0), where={"a": "data <> '6'"})
        assert [row.message().data for row in rows] == ["0", "1", "2", "3", "5", "7"]
        assert [event.start_ns for event in fleet.events(like="b%")] == [T0, T0 + 5 * SEC]
        with pytest.raises(EventNotFound, match="no store of the fleet has an event"):
            fleet.readMessages(event="is not there")


EVENTS = [
    ("bump", 10, 12, "", "first"),
    ("bump", 11, 14, "husky", "second"),
    ("bump", 20, 20, "", "both"),
    ("bump", 30, None, "husky", "second"),
    ("other", 0, 40, "", "both"),
]
"""Name, start and end (s, None = it lasts), robot, and the stores that have it."""


@pytest.mark.suite("test", "each kind of event, in each way to ask")
def test_events_with_time_around_them_meet_a_time_range_as_in_one_store(stores):
    """An event may lie outside of the range, and only the time around it reach into it."""
    first, second, whole = stores
    fill(first, "/a", range(0, 40, 2))
    fill(second, "/a", range(1, 40, 2))
    fill(first, "/a", range(0, 40, 3), nodeID="husky")
    fill(second, "/a", set(range(40)).difference(range(0, 40, 3)), nodeID="husky")
    for node in ("", "husky"):
        fill(whole, "/a", range(40), nodeID=node)
    having = {"first": [first], "second": [second], "both": [first, second]}
    for name, start, end, node, where in EVENTS:
        for store in (*having[where], whole):
            last = None if end is None else T0 + end * SEC
            store.addEvent(name, T0 + start * SEC, last, nodeID=node)
    around = [(3, 0), (0, 2.5), (3, 100)]
    with fleet_of(first, second) as fleet:
        for low, high in ((None, None), (5, 8), (15, 17)):
            times = [None if n is None else T0 + n * SEC for n in (low, high)]
            for (before, after), node in product(around, (None, "husky")):
                asked = times, ("bump", before, after), node
                assert messages_of(fleet, *asked) == messages_of(whole, *asked), asked


def messages_of(store, times, event, node):
    """Robot and text of the messages during an event; None = there is no such event."""
    try:
        rows = list(store.readMessages(["/a"], *times, event=event, nodeID=node))
    except EventNotFound:
        return None
    return [(row.t, row.node, row.message().data) for row in rows]


def test_an_index_of_one_store_is_not_looked_for_in_another(stores):
    """Tables of the same name, of which one has an index under the name of the other's."""
    first, second, _ = stores
    for store, field in ((first, "linear.x"), (second, "linear.y")):
        store.addTopic("/a", msg_type="geometry_msgs/Twist", index=[field])
        write(store, "/a", "ros", messages(1)[:: 2 if store is first else 3])
    whole = sorted(
        {number for n in (2, 3) for *_, msg in messages(1)[::n] for number in [int(msg.linear.y)]}
    )
    with fleet_of(first, second) as fleet:
        for field, least in (("linear.x", 4), ("linear.y", 60)):
            found = fleet.executeCQL(f"SELECT linear.y FROM a WHERE {field} > {least}")
            kept = [n for n in whole if (n % 7 if field == "linear.x" else n) > least]
            assert sorted(y for (y,) in found) == kept


@pytest.fixture
def away(stores, cassandra, proxied):
    """A fleet of two stores, of which the second is behind a proxy, and that store's name."""
    first, second, _ = stores
    name = f"{proxied.host}:{proxied.port}/{second.keyspace}"
    with Fleet([place(first), name], answer_sec=PATIENT_SEC) as fleet:
        yield first, second, fleet, name


def outage_of(fleet, name):
    """The limits of the connection to a store, which is made first."""
    (store,) = (each for each in fleet.stores if each.name == name)
    return store.catalog().keyspace.cassandra.outage


def give_up_soon(fleet, name):
    """Wait for 2 s only for a store that is about to go; the others may be slow."""
    outage_of(fleet, name).limit_sec = 2.0


def connects(fleet, name):
    try:
        return bool(outage_of(fleet, name))
    except ConnectionFailed:
        return False


@pytest.fixture
def proxied(cassandra):
    with Proxy(cassandra.host, cassandra.port) as proxy:
        yield proxy


def answers(fleet):
    """What a fleet answers of topic /s, by each of its doors."""
    yield fleet.rows("s"), 5
    yield fleet.items("s", reverse=True), 5
    yield fleet.readMessages(), 5
    yield fleet.executeCQL("SELECT data FROM s"), 5
    yield fleet.getData("s", T0, T0 + 10**12), 5
    yield fleet.topics(), 1
    yield fleet.info(), 1


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
def test_a_store_that_is_away_is_named_and_asked_again(away, proxied):
    first, second, fleet, name = away
    fill(first, "/s", range(5))
    fill(second, "/s", range(5, 9))
    proxied.cut()
    for answer, count in answers(fleet):
        assert len(list(answer)) == count
        assert (answer.partial, list(answer.missing)) == (True, [name])
    assert fleet.executeCQL("SELECT count(*) FROM s") == [(5,)]
    with pytest.raises(MessageNotFound, match=name):
        fleet.getData("s", T0 + 7 * SEC)
    with pytest.raises(TopicNotFound, match=f"do not answer: {name}"):
        fleet.rows("unknown")
    row = fleet.getRow("s", T0)
    assert (row.partial, list(row.missing)) == (True, [name])
    proxied.mend()
    assert (fleet.executeCQL("SELECT count(*) FROM s"), fleet.topics().partial) == ([(9,)], False)
    give_up_soon(fleet, name)
    proxied.freeze()
    answer = fleet.executeCQL("SELECT count(*) FROM s")
    assert (answer, list(answer.missing)) == ([(5,)], [name])


def test_a_place_that_takes_connections_and_is_silent_is_named(stores):
    fill(stores[0], "/a", [1])
    with socket.create_server(("127.0.0.1", 0)) as silent:
        name = f"127.0.0.1:{silent.getsockname()[1]}"
        with Fleet([place(stores[0]), name], answer_sec=1.0) as fleet:
            await_true(lambda: connects(fleet, place(stores[0])))
            there = outage_of(fleet, place(stores[0]))
            assert there.limit_sec == 1.0
            there.limit_sec = PATIENT_SEC
            rows = fleet.rows("a")
            assert (len(list(rows)), list(rows.missing)) == (1, [name])


def test_if_no_store_answers_that_is_an_error(proxied):
    proxied.cut()
    with Fleet([f"{proxied.host}:{proxied.port}/ros"], answer_sec=1.0) as fleet:
        with pytest.raises(StoreUnavailable, match="no store of the fleet answers"):
            fleet.topics()


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
@pytest.mark.parametrize("end", ["cut", "freeze"])
def test_a_store_that_goes_in_the_middle_of_a_stream_is_named(away, proxied, end):
    first, second, fleet, name = away
    for store, step in ((first, 2), (second, 3)):
        rows = [(T0 + n * SEC // 1000, "", 3, n, twist(n)) for n in range(0, 30_000, step)]
        write(store, "/s", "ros", rows)
    whole = [n for n in range(30_000) if n % 2 == 0 or n % 3 == 0]
    for ask, number_of in (
        (lambda: fleet.rows("s"), lambda row: int(row.message().linear.y)),
        (lambda: fleet.iterCQL("SELECT linear.y FROM s"), lambda row: int(row[0])),
    ):
        rows = ask()
        begin = [number_of(next(rows)) for _ in range(1000)]
        assert begin == whole[:1000]
        assert not rows.partial
        give_up_soon(fleet, name)
        getattr(proxied, end)()
        rest = [number_of(row) for row in rows]
        assert (rows.partial, list(rows.missing)) == (True, [name])
        # All of the first store, and of the other one what had come, in order.
        assert [n for n in rest if n % 2 == 0] == [n for n in whole[1000:] if n % 2 == 0]
        odd = [n for n in rest if n % 2]
        expected = [n for n in whole[1000:] if n % 2]
        assert odd == expected[: len(odd)]
        assert len(odd) < len(expected)
        if end == "freeze":
            proxied.cut()
        proxied.mend()
        outage_of(fleet, name).limit_sec = PATIENT_SEC
        await_true(lambda: is_whole(fleet.rows("s", limit=1)))  # the driver connects again, later


def is_whole(rows):
    """Say whether all stores of the fleet answer."""
    assert len(list(rows)) == 1
    return not rows.partial


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
def test_large_messages_come_from_the_store_that_still_answers(stores, proxied):
    """The first store goes away after their rows were read, and before their chunks are."""
    first, second, _ = stores
    casTopic = first.addTopic("/image", format="binary")
    for n in range(6):
        casTopic.addData(Image(height=n, data=bytes([n]) * (1 << 20)), key=T0 + n * SEC)
    first.catalog.adder.close()
    Replicator(first, second).copy()
    first.addTopic("/image").addData(Image(height=6, data=bytes(1 << 20)), key=T0 + 6 * SEC)
    first.catalog.adder.close()
    name = f"{proxied.host}:{proxied.port}/{first.keyspace}"
    with Fleet([name, place(second)], answer_sec=PATIENT_SEC) as fleet:
        rows = fleet.rows("image")
        waiting = [next(rows) for _ in range(4)]
        give_up_soon(fleet, name)
        proxied.cut()
        found = [(row.message().height, row.message().data[0]) for row in (*waiting, *rows)]
        assert found == [(n, n) for n in range(6)]
        assert list(rows.missing) == [name]


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
@pytest.mark.parametrize("door", ["items", "statement", "export"])
def test_messages_that_only_a_store_had_that_went_away_are_counted(stores, proxied, tmp_path, door):
    """Their rows were read, and not yet their chunks."""
    first, second, _ = stores
    casTopic = first.addTopic("/image", format="binary")
    for n in range(6):
        casTopic.addData(Image(height=n, data=bytes([n]) * (1 << 20)), key=T0 + n * SEC)
    first.catalog.adder.close()
    fill(second, "/s", [0])
    name = f"{proxied.host}:{proxied.port}/{first.keyspace}"
    with Fleet([name, place(second)], answer_sec=PATIENT_SEC) as fleet:

        def cut():
            give_up_soon(fleet, name)
            proxied.cut()

        if door == "export":
            cuts = iter([cut])
            report = export_fleet(
                fleet,
                tmp_path / "some.mcap",
                ["/image"],
                progress=lambda *_: next(cuts, lambda: None)(),
            )
            count, missing = report.messages["/image"], report.missing
        else:
            reads = {"items": fleet.items("image"), "statement": fleet.iterCQL(HEIGHTS)}
            rows = reads[door]
            next(rows)
            cut()
            count, missing = 1 + len(list(rows)), rows.missing
    assert list(missing) == [name]
    # Rows that had not been taken when it went away are not known.
    told = re.search("; left out: at least ([0-9]+) messages? that no other store", missing[name])
    assert 1 <= int(told[1]) <= 6 - count


@pytest.mark.suite("all", "make test asks others of its kind")
def test_of_a_damaged_copy_the_sound_one_is_read(stores, cql):
    first, second, _ = stores
    image = Image(height=1, data=bytes(1 << 20))
    first.addTopic("/image", format="binary").addData(image, key=T0)
    first.catalog.adder.close()
    Replicator(first, second).copy()
    (table,) = first.getTopic("/image").tables
    cql.execute(f'TRUNCATE {first.keyspace}."{table.name}_c"')
    with fleet_of(first, second) as fleet:
        assert fleet.getData("image", T0) == image
        assert fleet.executeCQL("SELECT height FROM image") == [(1,)]
    with fleet_of(first) as fleet, pytest.raises(CorruptMessage):
        fleet.getData("image", T0)


def test_a_file_names_stores_with_their_logins(stores, tmp_path):
    first, second, _ = stores
    fill(first, "/a", [1])
    fill(second, "/a", [2])
    file = tmp_path / "stores"
    file.write_text(f"[home]\nplace = {place(first)}\ncqlshrc = {tmp_path / 'none'}\n")
    with Fleet(["home", place(second)], file=str(file)) as fleet:
        with pytest.raises(InvalidOption, match="there is no file"):
            fleet.rows("a")
    (tmp_path / "none").write_text("[connection]\n")
    with Fleet(["home", place(second)], file=str(file)) as fleet:
        assert len(list(fleet.rows("a"))) == 2
    for names, text in (
        (["home", "home"], "given twice"),
        (["home", place(first)], "the same place"),
        (["a b"], "is not the place"),
        ([], "at least one store"),
    ):
        with pytest.raises(InvalidOption, match=text):
            Fleet(names, file=str(file))
    file.write_text("[home]\npassword = x\n")
    with pytest.raises(InvalidOption, match="there are place, cqlshrc, credentials"):
        Fleet(["home"], file=str(file))
    with pytest.raises(InvalidOption, match="answer_sec"):
        Fleet(["home"], answer_sec=0)


def test_a_closed_fleet_says_so(stores):
    fill(stores[0], "/a", range(3))
    fleet = fleet_of(*stores)
    assert len(list(fleet.rows("a"))) == 3
    fleet.close()
    fleet.close()
    with pytest.raises(ConnectionFailed, match="closed"):
        fleet.topics()


@pytest.mark.suite("all", "make test asks others of its kind")
def test_an_event_that_has_ended_in_one_store_has_ended(stores):
    """The copy at home still lasts; a statement takes the end, as events() does."""
    home, robot, _ = stores
    fill(robot, "/s", range(6))
    event = robot.addEvent("bump", Stamp.from_ns(T0 + SEC))
    Replicator(robot, home).copy()
    robot.endEvent(event, Stamp.from_ns(T0 + 3 * SEC))
    for order in ((home, robot), (robot, home)):
        with fleet_of(*order) as fleet:
            (found,) = fleet.events()
            assert found.end_ns == T0 + 3 * SEC
            rows = fleet.executeCQL("SELECT data FROM s WHERE EVENT 'bump'")
            assert [data for (data,) in rows] == ["1", "2", "3"]
            rows = fleet.executeCQL("SELECT data FROM s WHERE EVENT LIKE 'b%' ORDER BY KEY DESC")
            assert [data for (data,) in rows] == ["3", "2", "1"]
            assert len(list(fleet.readMessages(event="bump"))) == 3


@pytest.mark.suite("all", "make test asks others of its kind")
def test_who_does_not_wait_any_more_ends_the_counting(stores):
    class Gone(Exception):
        pass

    read = []

    def watch():
        read.append(1)
        if len(read) > 20:
            raise Gone

    for number, store in enumerate(stores[:2]):
        write(store, "/t", "ros", messages(number))
    with fleet_of(*stores[:2]) as fleet:
        answer = FleetAnswer(fleet.stores, watch=watch)
        topic = find_topic(answer, "/t")
        for work in (
            lambda: topic.count(Read()),
            lambda: list(describe_topic(answer, topic, EVERYBODY)),
        ):
            read.clear()
            with pytest.raises(Gone):
                work()
            assert len(read) < 40
