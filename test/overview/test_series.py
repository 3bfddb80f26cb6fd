# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What a plot shows of a statement, beside a loop over all messages, in every kind of format."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Float64, Header, Int64, String
from suites import search

from cassandra_ros.messages.connection_header import api_connection
from cassandra_ros.messages.definition import definition_of, parse_definition
from cassandra_ros.query.arrays.envelope import Grid
from cassandra_ros.topics.overview import bucket_envelope
from cassandra_ros.topics.overview.bucket_envelope import PieceReader
from cassandra_ros.topics.overview.envelopes import EnvelopeCache, spread
from cassandra_ros.topics.overview.plot_series import PlotWindow

SEC = 10**9
T0 = 1_500_000_000 * SEC
TEXT = "float32 f\nfloat64 d\nint8 i\nuint64 u\nbool b\nduration l\nstring s\nfloat64[] a\n"
NAMES = {"f": 0, "d": 1, "i": 2, "u": 3, "b": 4, "l": 5}
FORMATS = ("packed", "ros", "binary")
COUNT = 1200
STEP = 7_000_000


def message(n):
    """The n-th message: its bytes, and its numbers as they are drawn."""
    single = struct.unpack("<f", struct.pack("<f", math.sin(n / 50) * 3))[0]
    single = math.nan if n % 97 == 0 else math.inf if n == 600 else single
    double = math.nan if 200 <= n < 260 else n / 7
    # Those that are deleted again stand out.
    whole, large = 127 if 400 <= n < 410 else n % 200 - 100, 2**64 - 1 - n
    length = (-1, 999_999_999 - n) if n % 2 else (n, 5)
    numbers = struct.pack("<fdbQBii", single, double, whole, large, n % 3 == 0, *length)
    text, array = b"x" * (n % 5), struct.pack(f"<{n % 3}d", *range(n % 3))
    wire = numbers + struct.pack("<I", len(text)) + text + struct.pack("<I", n % 3) + array
    seconds = float(length[0] * SEC + length[1]) / SEC
    return wire, (single, double, float(whole), float(large), float(n % 3 == 0), seconds)


def time_of(n):
    """Messages every 7 ms, of each hundred the last ten in a moment; and a gap of a minute.

    The first message of a second lies at the last nanosecond of the second before, its bucket.
    """
    t = T0 + (n - max(0, n % 100 - 90)) * STEP + (n >= 700) * 60 * SEC
    return t - t % SEC - 1 if t % SEC < STEP else t


@pytest.fixture(scope="module")
def stored(fresh):
    """A topic in each format, of two robots and two writers each, some messages deleted."""
    definition = parse_definition("test/Numbers", TEXT, None)
    with fresh() as store:
        for fmt in FORMATS:
            for node, writer_id, chosen in (
                ("a", 2, range(0, COUNT, 2)),
                ("b", 3, range(1, COUNT, 2)),
            ):
                with store.messageWriter(nodeID=node, writer_id=writer_id, format=fmt) as writer:
                    connection = api_connection(f"/{fmt}", definition, "/x")
                    handle = writer.connect(connection, bucket_ns=SEC, span_ns=SEC // 3)
                    for n in chosen:
                        writer.write(handle, time_of(n), n, message(n)[0])
            topic = store.getTopic(f"/{fmt}")
            assert topic.removeData(time_of(400), time_of(409)) == 10
        yield store


MESSAGES = [(time_of(n), "ab"[n % 2], n, message(n)[1]) for n in range(COUNT) if not 400 <= n < 410]


def brute(grid, columns, passes=lambda t, node, n, numbers: True):
    """Pixel -> middle, count, (least, greatest) of each column; None where there is no number."""
    pixels = {}
    for each in MESSAGES:
        if grid.low <= each[0] <= grid.high and passes(*each):
            pixels.setdefault((each[0] - grid.low) // grid.width, []).append(each)
    found = {}
    for pixel, inside in pixels.items():
        times, ends = [each[0] for each in inside], []
        for column in columns:
            known = [x for *_, numbers in inside for x in [numbers[column]] if math.isfinite(x)]
            ends.append((min(known), max(known)) if known else None)
        found[pixel] = (min(times) + max(times)) // 2, len(inside), ends
    return found


def shown(series):
    grid, points = series.grid, series.points
    found = {}
    for n, t in enumerate(points.times.tolist()):
        pairs = zip(points.low[:, n].tolist(), points.high[:, n].tolist())
        ends = [None if low != low else (low, high) for low, high in pairs]
        found[(t - grid.low) // grid.width] = t, points.rows[n], ends
    return found


def read(store, fmt, columns, where="", window=None, **options):
    select = f"select {', '.join(columns)} from /{fmt} {where}"
    return store.statements.series(select, window=window or PlotWindow(), **options)


CONDITIONS = {
    "": lambda t, node, n, numbers: True,
    "where NODE = 'a'": lambda t, node, n, numbers: node == "a",
    "where KEY > ?": lambda t, node, n, numbers: t > time_of(333),
    "where i > 50 and not b = true": lambda t, node, n, numbers: numbers[2] > 50 and not numbers[4],
    "where RUN = '3' and d < 100": lambda t, node, n, numbers: node == "b" and numbers[1] < 100,
}
ENDS = st.one_of(st.none(), st.integers(-STEP, COUNT * STEP + 61 * SEC).map(lambda ns: T0 + ns))


@search(80)
@given(
    st.sampled_from(FORMATS),
    st.lists(st.sampled_from(sorted(NAMES)), min_size=1, max_size=3, unique=True),
    st.sampled_from(sorted(CONDITIONS)),
    ENDS,
    ENDS,
    st.sampled_from([1, 2, 7, 100, 3000]),
)
@example("packed", ["i"], "", None, None, 1)
@example("packed", ["d", "u"], "", time_of(333) + 1, time_of(777), 1)
@example("packed", ["d"], "where NODE = 'a'", time_of(20), time_of(21), 2)
def test_each_pixel_shows_what_lies_in_it(stored, fmt, names, where, low, high, pixels):
    if None not in (low, high):
        low, high = min(low, high), max(low, high)
    params = [time_of(333)] if "?" in where else []
    found = stored.statements.series(
        f"select {', '.join(names)} from {fmt} {where}", params, PlotWindow(low, high, pixels)
    )
    assert found.complete
    assert [column.name for column in found.columns] == names

    def passes(t, *rest):
        inside = (low is None or t >= low) and (high is None or t <= high)
        return inside and CONDITIONS[where](t, *rest)

    wanted = brute(found.grid, [NAMES[name] for name in names], passes)
    assert shown(found) == wanted
    assert found.grid.pixels <= pixels
    if (low, high, where) == (None, None, ""):
        assert sum(found.points.rows.tolist()) == len(MESSAGES)


def test_of_blocks_in_one_pixel_nothing_is_unpacked(stored, monkeypatch):
    opened = []
    unpack = bucket_envelope.open_blocks

    def counted(part, headers):
        opened.extend(headers)
        return unpack(part, headers)

    monkeypatch.setattr(bucket_envelope, "open_blocks", counted)
    monkeypatch.setattr(PieceReader, "_batches", lambda *_: pytest.fail("all are read"))
    read(stored, "packed", ["d", "i"], window=PlotWindow(pixels=1))
    # Only those of which messages were deleted: their bounds may be too wide.
    assert 1 <= len(opened) <= 4
    assert all(len(header.gone) for header in opened)
    opened.clear()
    read(stored, "packed", ["f", "i"], window=PlotWindow(pixels=1))
    # And those with an infinity, which hides the greatest number.
    assert [header.t <= time_of(600) <= header.last for header in opened if not len(header.gone)]


def test_what_is_found_soon_shows_all_of_it_thinly(stored):
    for fmt in ("packed", "ros"):
        window, cache = PlotWindow(pixels=50, seconds=0.0), EnvelopeCache()
        wanted = brute(Grid.between(time_of(0), time_of(COUNT - 1), 50), [0, 2])
        shares, edges, found = [], [], None
        while found is None or not found.complete:
            found = read(stored, fmt, ["f", "i"], window=window, cache=cache)
            shares.append(found.share)
            edges.append(found.edges)
            for pixel, (_, _, ends) in shown(found).items():
                for has, true in zip(ends, wanted[pixel][2]):
                    if found.edges == 0 and has is not None:  # a part of it
                        assert true[0] <= has[0] <= has[1] <= true[1]
                    elif found.share == 1 and true is not None:  # or more than it
                        assert has[0] <= true[0] and true[1] <= has[1]
        assert shares == sorted(shares) and 0 < shares[0] < 0.5 and len(shares) > 5
        assert shown(found) == wanted
        assert (max(edges) > 0) == (fmt == "packed")


def test_what_was_read_of_closed_buckets_is_kept(stored, monkeypatch):
    cache = EnvelopeCache()
    first = read(stored, "ros", ["f"], window=PlotWindow(pixels=50), cache=cache)
    pieces, reads = [], PieceReader.read

    def noted(reader, piece, *rest):
        pieces.append(piece)
        return reads(reader, piece, *rest)

    monkeypatch.setattr(PieceReader, "read", noted)
    again = read(stored, "ros", ["f"], window=PlotWindow(pixels=50), cache=cache)
    assert shown(first) == shown(again)
    # Messages of this bucket were deleted: its counts are not final.
    assert {piece.bucket for piece in pieces} == {T0 // SEC + 2}
    pieces.clear()
    # A time range that is slightly moved has the same pixels.
    aside = PlotWindow(T0 + 3 * SEC, time_of(COUNT - 1) + SEC, 50)
    assert shown(read(stored, "ros", ["f"], window=aside, cache=cache))
    assert {piece.bucket for piece in pieces} <= {T0 // SEC + 2}
    # Nor does one that moves with now(), but in the bucket where it begins.
    whole = PlotWindow(time_of(0), time_of(COUNT - 1), 50)
    for ns in (5, 6):
        pieces.clear()
        read(stored, "ros", ["f"], f"where KEY > {T0 + ns}", window=whole, cache=cache)
    assert {piece.bucket for piece in pieces} <= {T0 // SEC, T0 // SEC + 2}
    read(stored, "ros", ["d"], window=PlotWindow(pixels=50), cache=cache)  # not the same
    assert len(pieces) > 5


def test_a_plot_whose_time_range_moves_with_now_becomes_complete(stored):
    for fmt in ("packed", "ros"):
        window, cache = PlotWindow(time_of(0), time_of(COUNT - 1), 50, 0.0), EnvelopeCache()
        for moved in range(200):
            where = f"where f > -1e300 and (i > 3 or i < 9) and KEY > {T0 + moved}"
            series = read(stored, fmt, ["f", "i"], where, window=window, cache=cache)
            if series.complete:
                break
        assert series.complete
        assert shown(series) == shown(read(stored, fmt, ["f", "i"], where, window=window))


def test_what_is_written_meanwhile_is_seen(rosCas):
    cache = EnvelopeCache()
    topic = rosCas.addTopic("/live")
    for n in range(5):
        topic.addData(Float64(n), key=T0 + n * SEC)
        found = rosCas.statements.series("select data from live", cache=cache)
        assert found.points.high.tolist() == [[float(k) for k in range(n + 1)]]
        assert found.points.times.tolist() == [T0 + k * SEC for k in range(n + 1)]
    assert topic.removeData(T0 + SEC) == 1
    found = rosCas.statements.series("select data from live", cache=cache)
    assert found.points.low.tolist() == [[0.0, 2.0, 3.0, 4.0]]
    for writer_id in (2, 3, 4):  # of a bucket that is closed each time
        with rosCas.messageWriter(writer_id=writer_id) as writer:
            handle = writer.connect(api_connection("/late", definition_of(Float64), "/x"))
            writer.write(handle, T0, 0, struct.pack("<d", writer_id))
        found = rosCas.statements.series("select data from late", cache=cache)
        assert found.points.rows.tolist() == [writer_id - 1]


def test_a_cache_is_bounded():
    class Sized:
        nbytes = 10

    cache = EnvelopeCache(25)
    cache.put("a", Sized())
    cache.put("b", Sized())
    assert cache.get("a") is not None
    cache.put("c", Sized())  # b was not asked for the longest
    assert cache.get("b") is None
    assert cache.get("a") and cache.get("c")


def test_the_first_of_many_lie_far_apart():
    assert list(spread(8)) == [0, 4, 2, 6, 1, 5, 3, 7]
    assert [sorted(spread(n)) for n in range(70)] == [list(range(n)) for n in range(70)]
    assert max(spread(1000)[:32]) - min(spread(1000)[:32]) > 900


def test_rows_of_groups_and_of_a_limit_are_drawn_over_their_time(stored):
    statement = "select time(1s) as t, max(i), avg(d), count(*) from {} group by t"
    for fmt in FORMATS:
        found = stored.statements.series(statement.format(fmt))
        rows = stored.executeCQL(statement.format(fmt))
        assert [c.name for c in found.columns] == ["max(i)", "avg(d)", "count(*)"]
        assert found.points.times.tolist() == [row[0].ns for row in rows]
        assert found.points.low[0].tolist() == [row[1] for row in rows]
        assert found.points.low[2].tolist() == [row[3] for row in rows]
    found = stored.statements.series("select i from ros where i < -97 order by KEY desc limit 3")
    rows = stored.executeCQL("select KEY, i from ros where i < -97 order by KEY desc limit 3")
    assert found.points.times.tolist() == [row[0].ns for row in rows][::-1]
    assert found.points.low[0].tolist() == [row[1] for row in rows][::-1]
    few = stored.statements.series(
        statement.format("ros"), window=PlotWindow(time_of(200), time_of(300))
    )
    assert few.points.times.tolist() == [T0 + 2 * SEC]


def test_what_cannot_be_drawn_is_left_out_with_the_reason(rosCas):
    topic = rosCas.addTopic("/h")
    topic.addData(Header(seq=3, frame_id="x"), key=T0)
    every = rosCas.statements.series("select * from h")
    assert [c.name for c in every.columns] == ["seq"]
    assert {name: reason[:6] for name, reason in every.left_out} == {
        "stamp": "a time",
        "frame_id": "text",
    }
    lag = rosCas.statements.series("select KEY - stamp as lag, seq * 2 as twice from h")
    assert [(c.name, c.unit) for c in lag.columns] == [("lag", "s"), ("twice", "")]
    assert lag.points.low.tolist() == [[T0 / SEC], [6.0]]
    none = rosCas.statements.series("select frame_id, max(seq) from h group by frame_id")
    assert not none.columns and "time(1m)" in dict(none.left_out)["max(seq)"]
    rosCas.addTopic("/fix").addData(NavSatFix(altitude=7, latitude=2), key=T0)
    fix = rosCas.statements.series("select altitude, latitude, position_covariance from fix")
    assert [(c.name, c.unit) for c in fix.columns] == [("altitude", "m"), ("latitude", "°N")]
    assert "array" in dict(fix.left_out)["position_covariance"]
    named = rosCas.addTopic("/n", key_format="manual", msg_type="std_msgs/Int64")
    named.addData(Int64(1), "one")
    assert not rosCas.statements.series("select data from n").columns
    rosCas.addTopic("/none", msg_type="std_msgs/Int64")
    nothing = rosCas.statements.series("select data from none")
    assert [c.name for c in nothing.columns] == ["data"]
    assert not len(nothing.points.times) and nothing.complete


def test_elements_of_an_array_of_messages_are_points(rosCas):
    from geometry_msgs.msg import TransformStamped
    from tf2_msgs.msg import TFMessage

    topic = rosCas.addTopic("/tf", "packed")
    for n in range(20):
        moved = [TransformStamped(child_frame_id=name) for name in ("a", "b")]
        moved[0].transform.translation.x, moved[1].transform.translation.x = n, -n
        topic.addData(TFMessage(moved), key=T0 + n * SEC)
    every = "select transforms.transform.translation.x as x from tf"
    both = rosCas.statements.series(every)
    assert both.points.low.tolist() == [[float(-n) for n in range(20)]]
    assert both.points.high.tolist() == [[float(n) for n in range(20)]]
    one = rosCas.statements.series(every + " where transforms.child_frame_id = 'a'")
    assert one.points.low.tolist() == one.points.high.tolist() == [[float(n) for n in range(20)]]
    assert one.columns[0].unit == "m"


def test_two_types_of_a_topic_are_one_line(rosCas):
    with rosCas.messageWriter() as writer:
        for n, (kind, text) in enumerate(
            [("test/A", "float32 x\n"), ("test/B", "int32 y\nint64 x\n"), ("test/C", "string s\n")]
        ):
            definition = parse_definition(kind, text, None)
            handle = writer.connect(api_connection("/x", definition, "/x"))
            wire = [struct.pack("<f", 0.5), struct.pack("<iq", 7, 2), struct.pack("<I", 0)][n]
            writer.write(handle, T0 + n * SEC, 0, wire)
    found = rosCas.statements.series("select x from x")
    assert found.points.low[0].tolist()[:2] == [0.5, 2.0]
    assert math.isnan(found.points.low[0].tolist()[2])


def test_whoever_went_away_ends_the_reading(stored):
    class Gone(Exception):
        pass

    calls = []

    def watch():
        calls.append(1)
        if len(calls) > 3:
            raise Gone

    for fmt in FORMATS:
        calls.clear()
        with pytest.raises(Gone):
            read(stored, fmt, ["f"], "where d > 3", watch=watch)
        assert len(calls) == 4
    for statement in ("select d from {} where d > 1e9", "select max(d) from {}"):
        for fmt in FORMATS:
            calls.clear()
            with pytest.raises(Gone):
                list(stored.statements.select(statement.format(fmt), watch=watch))
    # Also where a bucket gives block after block of which no message is wanted.
    calls.clear()
    none = f"select d from packed where i = -37 and i != -37 and KEY < {T0 + SEC}"
    with pytest.raises(Gone):
        list(stored.statements.select(none, watch=watch))


def test_a_large_message_is_drawn_by_its_bounds(rosCas):
    topic = rosCas.addTopic("/large", "packed")
    topic.addData(String("x" * 600_000), key=T0)
    assert not rosCas.statements.series("select data from large").columns
    length = rosCas.statements.series("select len(data) as n from large")
    assert length.points.low.tolist() == [[600_000.0]]


@pytest.mark.parametrize("fmt", ["packed", "ros"])
def test_a_condition_may_name_a_field_of_one_of_two_definitions(rosCas, fmt):
    """Messages that lack it never match, and are no error."""
    texts = ["float64 x", "float64 x\nint8 b"]
    with rosCas.messageWriter(format=fmt) as writer:
        for number, text in enumerate(texts):
            definition = parse_definition(f"test/Definition{number}", text, None)
            handle = writer.connect(api_connection("/two", definition, "/x"))
            for n in range(20):
                wire = struct.pack("<d", 10 * number + n) + bytes([n])[:number]
                writer.write(handle, T0 + n * SEC + number, n, wire)
    found = rosCas.statements.series("select x from /two where b > 4", window=PlotWindow(pixels=1))
    (pixel,) = shown(found).values()
    assert pixel[1:] == (15, [(15.0, 29.0)])
