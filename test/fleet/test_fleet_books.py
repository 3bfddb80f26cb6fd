# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""A store of a fleet is read only for what a store before it lacks, and no answer differs by it."""

from __future__ import annotations

import contextlib
import itertools

import pytest
from fleet.test_fleet import PATIENT_SEC, SEC, T0, give_up_soon, place, plain, twist, write
from hypothesis import given
from hypothesis import strategies as st
from proxy import Proxy
from sensor_msgs.msg import Image
from suites import search, sparing

from cassandra_ros import Fleet
from cassandra_ros.messages.classes import serialize
from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of
from cassandra_ros.store.tables.directory import SLOT_BUCKETS
from cassandra_ros.stores.copying.replicator import Replicator
from cassandra_ros.stores.copying.rules import CopyRule, CopyRules
from cassandra_ros.stores.copying.target_buckets import TargetBuckets
from cassandra_ros.stores.fleet.fleet_books import Spared

WRITERS = {"husky": 3, "jackal": 5}
THINNED = CopyRules([CopyRule(where="linear.x > 3")])
NUMBERS = itertools.count()


@pytest.fixture
def stores(fresh):
    with contextlib.ExitStack() as stack:
        yield {n: stack.enter_context(fresh()) for n in ("home", "husky", "jackal")}


@pytest.fixture(scope="module")
def lasting(fresh):
    """Three stores, a fleet that believes their books, and one that reads every store."""
    with contextlib.ExitStack() as stack:
        three = {n: stack.enter_context(fresh()) for n in ("home", "husky", "jackal")}
        places = list(map(place, three.values()))
        both = (stack.enter_context(Fleet(places, consistency=c)) for c in ("LOCAL_QUORUM", "ONE"))
        yield (three, *both)


def numbered(robot, numbers):
    """Messages of a robot, four in a second."""
    return [(T0 + n * SEC // 4, robot, WRITERS[robot], n, twist(n)) for n in numbers]


def copy(source, target, topic, rules=None):
    return Replicator(source, target, [topic], rules=rules).copy()


PARTS = st.tuples(st.integers(0, 39), st.integers(1, 40)).map(lambda p: range(p[0], sum(p)))
ROBOT = st.sampled_from(["husky", "jackal"])
STORE = st.sampled_from(["home", "husky", "jackal"])
COPIES = st.sampled_from([("husky", "home"), ("jackal", "home"), ("husky", "jackal")])
ACTIONS = st.one_of(
    st.tuples(st.just("write"), ROBOT, PARTS),
    st.tuples(st.just("import"), ROBOT, PARTS),
    st.tuples(st.just("copy"), COPIES),
    st.tuples(st.just("copy"), COPIES),
    st.tuples(st.just("thin"), COPIES),
    st.tuples(st.just("delete"), STORE, PARTS),
    st.tuples(st.just("count"), STORE),
)
PACKING = st.sampled_from(["ros", "packed"])


def act(stores, topic, formats, written, action, *said):
    if action == "write":
        robot, numbers = said
        # Blocks that begin at other messages would have some of them twice.
        rows = numbered(robot, [n for n in numbers if n not in written[robot]])
        written[robot].update(numbers)
        write(stores[robot], topic, formats[robot], rows)
    elif action == "import":
        write(stores["home"], topic, "ros", numbered(*said))
    elif action in ("copy", "thin"):
        source, target = (stores[name] for name in said[0])
        if source.existTopic(topic):
            copy(source, target, topic, THINNED if action == "thin" else None)
    elif stores[said[0]].existTopic(topic):
        casTopic = stores[said[0]].getTopic(topic)
        if action == "delete":
            low, *_, high = (T0 + n * SEC // 4 for n in (said[1][0], said[1][-1]))
            casTopic.removeData(low, high)
        else:
            casTopic.countTopicData()


@contextlib.contextmanager
def recording(store, topic, format, rows):
    """Writes messages into buckets that stay open."""
    node, writer_id = rows[0][1:3] if rows else ("husky", 3)
    with store.messageWriter(writer_id=writer_id, nodeID=node, format=format) as writer:
        connection = api_connection(topic, definition_of(twist(0).__class__), f"/{node}")
        handle = writer.connect(connection, bucket_ns=SEC)
        for t, _, _, number, msg in rows:
            writer.write(handle, t, number, serialize(msg))
        writer.flush()
        yield


def facts(fleet, topic):
    names = ("topic", "type", "node", "count", "bytes", "first_ns", "last_ns", "stores", "formats")
    return [[getattr(info, name) for name in names] for info in fleet.info([topic])]


@pytest.mark.suite("all", "a search; make test asks some of its cases")
@search(20)
@given(
    formats=st.fixed_dictionaries({"husky": PACKING, "jackal": PACKING}),
    actions=st.lists(ACTIONS, min_size=3, max_size=9),
    still=st.none() | st.tuples(ROBOT, PARTS),
    low=st.integers(-1, 60),
    length=st.integers(0, 60),
    robot=st.sampled_from([None, "husky", "jackal"]),
)
def test_no_answer_differs_because_the_books_are_believed(
    lasting, formats, actions, still, low, length, robot
):
    stores, fleet, whole = lasting
    topic = f"/x{next(NUMBERS)}"
    written = {"husky": set(), "jackal": set()}
    begin = [("write", "husky", range(24)), ("copy", ("husky", "home"))]
    for action in (*begin, *actions):
        act(stores, topic, formats, written, *action)
    low, high = T0 + low * SEC // 4, T0 + (low + length) * SEC // 4
    with contextlib.ExitStack() as stack:
        if still is not None:
            name, numbers = still
            rows = numbered(name, [n for n in numbers if n not in written[name]])
            stack.enter_context(recording(stores[name], topic, formats[name], rows))
        for times in ((), (low, high)):
            for where in (None, "linear.x > 3", "RUN = '3'"):
                for reverse in (False, True):
                    asked = {"nodeID": robot, "where": where, "reverse": reverse}
                    found = plain(fleet.rows(topic, *times, **asked))
                    assert found == plain(whole.rows(topic, *times, **asked))
            for received in (False, True):
                asked = {"nodeID": robot, "received": received}
                found = plain(fleet.readMessages([topic], *times, **asked))
                assert found == plain(whole.readMessages([topic], *times, **asked))
        for statement in (
            f"SELECT count(*) FROM {topic}",
            f"SELECT count(*) FROM {topic} WHERE KEY >= {low} AND KEY <= {high}",
            f"SELECT NODE, count(*), sum(linear.y) FROM {topic} GROUP BY NODE",
            f"SELECT KEY, NODE, linear.x FROM {topic} WHERE KEY > {low} ORDER BY KEY DESC LIMIT 9",
        ):
            found = fleet.executeCQL(statement, nodeID=robot)
            assert found == whole.executeCQL(statement, nodeID=robot)
        assert fleet.getData(topic, low, high) == whole.getData(topic, low, high)
        for nearest in ("before", "after", "either"):
            found, expected = (f.getRow(topic, low, nearest=nearest) for f in (fleet, whole))
            assert (found and found.identity) == (expected and expected.identity)
        assert facts(fleet, topic) == facts(whole, topic)


def given_by(fleet, robot, topic="/s", **asked):
    """Return the number of messages, and of those that a robot's store gave."""
    rows = list(fleet.rows(topic, **asked))
    assert not fleet.rows(topic).partial
    return len(rows), sum(place(robot) in row.stores for row in rows)


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("format", sparing(["ros", "packed"], kept=["packed"]))
def test_only_what_home_lacks_or_may_lack_is_read_from_the_robot(stores, format):
    home, husky, _ = stores.values()
    write(husky, "/s", format, numbered("husky", range(40)))
    with Fleet([place(home), place(husky)]) as fleet, Fleet([place(husky), place(home)]) as turned:
        assert given_by(fleet, husky) == (40, 40)
        copy(husky, home, "/s")
        assert given_by(fleet, husky) == (40, 0)
        assert given_by(fleet, husky, reverse=True, where="linear.x > 0") == (34, 0)
        assert given_by(turned, husky) == (40, 40)  # the robot's store comes first
        write(husky, "/s", format, numbered("husky", range(40, 46)))
        assert given_by(fleet, husky) == (46, 6)
        copy(husky, home, "/s")
        assert given_by(fleet, husky) == (46, 0)
        home.getTopic("/s").removeData(T0 + SEC, T0 + SEC)
        assert given_by(fleet, husky) == (46, 4)  # the bucket of the message that home deleted
        husky.getTopic("/s").removeData(T0 + 3 * SEC, T0 + 3 * SEC)
        assert given_by(fleet, husky) == (46, 4 + 3)
        with recording(husky, "/s", format, numbered("husky", range(46, 50))):
            copy(husky, home, "/s")
            assert given_by(fleet, husky)[1] >= 4
        home.removeTopic("/s")
        assert given_by(fleet, husky) == (49, 49)


@pytest.mark.parametrize("format", sparing(["ros", "packed"], kept=["packed"]))
def test_what_a_second_writer_adds_to_a_copied_bucket_is_read(stores, format):
    """Home has all of the first writer's messages of that time, and none of the second's."""
    home, husky, _ = stores.values()
    rows = numbered("husky", range(12))
    write(husky, "/s", format, rows)
    copy(husky, home, "/s")
    later = [(t + 1, node, 9, number, msg) for t, node, _, number, msg in rows[4:8]]
    write(husky, "/s", format, later)
    with Fleet([place(home), place(husky)]) as fleet:
        assert given_by(fleet, husky) == (16, 8)  # the bucket of both is read from the robot
        assert [row.t for row in fleet.rows("s")] == sorted(row[0] for row in (*rows, *later))
        assert fleet.executeCQL("SELECT count(*) FROM s") == [(16,)]


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("reverse", [False, True])
def test_what_is_copied_while_it_is_read_is_given_once(stores, reverse):
    """Home was read to its end before the copy: the robot gives what home has not given."""
    home, husky, _ = stores.values()
    border = (T0 // SEC // SLOT_BUCKETS + 1) * SLOT_BUCKETS * SEC
    times = [border + n * SEC // 200 for n in range(-10 * 200, 10 * 200)]
    rows = [(t, "husky", 3, number, twist(number)) for number, t in enumerate(times)]
    first = [row for row in rows if (row[0] >= border) == reverse]
    write(husky, "/s", "ros", first)
    copy(husky, home, "/s")
    write(husky, "/s", "ros", [row for row in rows if row not in first])
    with Fleet([place(home), place(husky)]) as fleet:
        found = fleet.rows("s", reverse=reverse)
        begin = [next(found) for _ in range(10)]
        copy(husky, home, "/s")
        given = [row.t for row in (*begin, *found)]
        assert given == sorted(times, reverse=reverse) and not found.missing


@pytest.fixture
def shared_robot(stores, proxied):
    """A function that makes one store of a fleet fragile.

    Of /s jackal has copies at home, of /x at husky; /x of husky is not at home, which has others.
    """
    home, husky, jackal = stores.values()
    for topic in ("/s", "/x"):
        write(jackal, topic, "ros", numbered("jackal", range(16)))
    write(husky, "/x", "ros", numbered("husky", range(16)))
    others = [(T0 + n * SEC // 1000, "base", 9, n, twist(n)) for n in range(30_000)]
    write(home, "/x", "ros", others)
    copy(jackal, home, "/s")
    copy(jackal, husky, "/x")

    @contextlib.contextmanager
    def fleet(gone):
        names = {name: place(store) for name, store in stores.items()}
        names[gone] = f"{proxied.host}:{proxied.port}/{stores[gone].keyspace}"
        with Fleet(list(names.values()), answer_sec=PATIENT_SEC) as made:
            yield made, names[gone]

    return fleet


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
def test_a_store_that_goes_away_does_not_stop_an_answer(shared_robot, proxied):
    with shared_robot("home") as (fleet, name):
        answer = fleet.rows("x")
        given = [next(answer).node for _ in range(1000)]
        give_up_soon(fleet, name)
        proxied.cut()
        given += [row.node for row in answer]
        assert (given.count("husky"), given.count("jackal")) == (16, 16)
        assert list(answer.missing) == [name]


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
@pytest.mark.parametrize("door", ["count", "info"])
def test_what_a_store_has_is_counted_if_the_store_that_stands_for_it_goes_away(
    shared_robot, proxied, monkeypatch, door
):
    shared = Spared.shared

    with shared_robot("husky") as (fleet, name):

        def cut(self, *words):
            give_up_soon(fleet, name)
            proxied.cut()
            return shared(self, *words)

        monkeypatch.setattr(Spared, "shared", cut)
        if door == "count":
            answer = fleet.executeCQL("SELECT count(*) FROM x")
            assert answer == [(30_016,)]
        else:
            answer = fleet.info(["/x"])
            # What husky has alone was counted before it went away.
            counts = {"base": 30_000, "husky": 16, "jackal": 16}
            assert {info.node: info.count for info in answer} == counts
        assert list(answer.missing) == [name]


def test_a_deletion_at_home_during_a_copy_is_not_forgotten(stores, monkeypatch):
    """The copier has not closed the bucket yet, so it must not close it with its own count."""
    home, husky, _ = stores.values()
    write(husky, "/s", "ros", numbered("husky", range(4)))
    close = TargetBuckets.close

    def delete_and_close(self, *words):
        home.getTopic("/s").removeData(T0 + SEC // 4, T0 + SEC // 4)
        self._marked.clear()  # as if the heartbeat was old
        self.open("husky", T0 // SEC, 3)
        close(self, *words)

    with monkeypatch.context() as patch:
        patch.setattr(TargetBuckets, "close", delete_and_close)
        copy(husky, home, "/s")
    with Fleet([place(home), place(husky)]) as fleet:
        assert given_by(fleet, husky) == (4, 4)
    assert home.getTopic("/s").countTopicData() == 3


@pytest.mark.suite("all", "make test asks others of its kind")
def test_a_home_that_was_made_again_has_nothing(stores, cql):
    home, husky, _ = stores.values()
    write(husky, "/s", "ros", numbered("husky", range(40)))
    copy(husky, home, "/s")
    cql.execute(f"DROP KEYSPACE {home.keyspace}")
    cql.execute(
        f"CREATE KEYSPACE {home.keyspace} WITH replication = "
        "{'class': 'SimpleStrategy', 'replication_factor': 1}"
    )
    with Fleet([place(home), place(husky)]) as fleet:
        assert given_by(fleet, husky) == (40, 40)


@pytest.fixture
def proxied(cassandra):
    with Proxy(cassandra.host, cassandra.port) as proxy:
        yield proxy


@pytest.mark.suite("all", "make test asks others of its kind")
@pytest.mark.parametrize("door", ["info", "count", "rows"])
def test_the_robot_sends_no_message_for_what_home_has(stores, proxied, door):
    home, husky, _ = stores.values()
    write(
        husky, "/s", "ros", [(T0 + n * SEC // 1000, "husky", 3, n, twist(n)) for n in range(9000)]
    )
    copy(husky, home, "/s")
    name = f"{proxied.host}:{proxied.port}/{husky.keyspace}"
    sent = {}
    for consistency in ("LOCAL_QUORUM", "ONE"):
        with Fleet([place(home), name], consistency=consistency) as fleet:
            assert fleet.topics() == ["/s"]
            before = proxied.answered_bytes
            if door == "info":
                (info,) = fleet.info()
                assert (info.count, info.stores) == (9000, {place(home): 9000, name: 9000})
            elif door == "count":
                assert fleet.executeCQL("SELECT count(*) FROM s") == [(9000,)]
            else:
                assert len(list(fleet.rows("s"))) == 9000
            sent[consistency] = proxied.answered_bytes - before
    assert sent["LOCAL_QUORUM"] < sent["ONE"] / 5, sent


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
@pytest.mark.parametrize("reverse", [False, True])
def test_if_home_goes_away_in_the_middle_the_robot_gives_the_rest(stores, proxied, reverse):
    home, husky, jackal = stores.values()
    rows = [(T0 + n * SEC // 1000, "husky", 3, n, twist(n)) for n in range(30_000)]
    write(husky, "/s", "ros", rows)
    copy(husky, home, "/s")
    write(jackal, "/s", "ros", [(T0 + SEC // 9, "jackal", 5, 1, twist(1))])
    name = f"{proxied.host}:{proxied.port}/{home.keyspace}"
    with Fleet([name, place(husky), place(jackal)], answer_sec=PATIENT_SEC) as fleet:
        found = fleet.rows("s", reverse=reverse)
        begin = [next(found) for _ in range(1000)]
        assert all(row.stores in ([name], [place(jackal)]) for row in begin)
        give_up_soon(fleet, name)
        proxied.cut()
        rest = list(found)
        numbers = [row.seq for row in (*begin, *rest) if row.node == "husky"]
        assert [n & 0xFFFFFFFF for n in numbers] == sorted(range(30_000), reverse=reverse)
        assert len(begin) + len(rest) == 30_001
        assert list(found.missing) == [name]
        assert rest[-2].stores == [place(husky)]


@pytest.mark.suite("all", "it kills or cuts something, and waits")
@pytest.mark.fault
@pytest.mark.parametrize("fault", ["away", "damaged"])
def test_bytes_that_home_does_not_give_any_more_come_from_the_robot(stores, proxied, cql, fault):
    home, husky, _ = stores.values()
    casTopic = husky.addTopic("/image", format="binary")
    for n in range(4):
        casTopic.addData(Image(height=n, data=bytes([n]) * (1 << 20)), key=T0 + n * SEC)
    husky.catalog.adder.close()
    copy(husky, home, "/image")
    name = f"{proxied.host}:{proxied.port}/{home.keyspace}"
    with Fleet([name, place(husky)], answer_sec=PATIENT_SEC) as fleet:
        rows = list(fleet.rows("image"))
        assert [row.stores for row in rows] == [[name]] * 4
        if fault == "away":
            give_up_soon(fleet, name)
            proxied.cut()
        else:
            (table,) = home.getTopic("/image").tables
            cql.execute(f'TRUNCATE {home.keyspace}."{table.name}_c"')
        found = [(row.message().height, row.message().data[0]) for row in rows]
        assert found == [(n, n) for n in range(4)]
        assert "left out" not in str(rows[0].missing)
