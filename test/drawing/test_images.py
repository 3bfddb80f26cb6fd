# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Pictures have the pixels of the messages that they are made of."""

from __future__ import annotations

import io
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image as Pillow
from sensor_msgs.msg import CompressedImage, Image

from cassandra_ros.errors import CorruptMessage, TypeMismatch, UnknownEncoding
from cassandra_ros.viewing.drawing.images import jpeg_of, picture_of, scaled_depth

RANDOM = np.random.default_rng(1)


def row_of(msg):
    return SimpleNamespace(type=msg._type, topic="/camera", t=5, message=lambda: msg)


def image(samples, encoding, padding=0, big=False):
    """A message of samples (rows, columns, channels), its rows followed by some bytes."""
    samples = samples.astype(samples.dtype.newbyteorder(">" if big else "<"))
    rows = [bytes(row.tobytes()) + b"\xee" * padding for row in samples]
    return Image(
        height=samples.shape[0],
        width=samples.shape[1],
        encoding=encoding,
        is_bigendian=int(big),
        step=len(rows[0]),
        data=b"".join(rows),
    )


def drawn(msg, width=None):
    return np.asarray(picture_of(row_of(msg), width))


def random(sample, channels, height=5, width=7):
    values = RANDOM.integers(0, 2**16, (height, width, channels)).astype(sample)
    return values if channels > 1 else values.reshape(height, width, 1)


@pytest.mark.parametrize("padding", [0, 3])
@pytest.mark.parametrize("colours", ["rgb", "bgr", "rgba", "bgra"])
def test_colours(colours, padding):
    samples, order = random("u1", len(colours)), [colours.index(each) for each in "rgb"]
    found = drawn(image(samples, f"{colours}8", padding))
    assert (found == samples[:, :, order]).all()
    wide = random("u2", len(colours))
    for big in (False, True):
        found = drawn(image(wide, f"{colours}16", padding, big))
        assert (found == np.rint(wide[:, :, order] / 257)).all()


@pytest.mark.parametrize("padding", [1, 3, 64])
def test_the_padding_of_the_last_row_may_be_missing(padding):
    """Some drivers send no bytes after the last pixel; a pixel that is missing is a damage."""
    samples = random("u1", 3)
    msg = image(samples, "rgb8", padding)
    msg.data = msg.data[:-padding]
    assert (drawn(msg) == samples).all()
    msg.data = msg.data[:-1]
    with pytest.raises(CorruptMessage, match="is damaged"):
        drawn(msg)


@pytest.mark.parametrize("encoding", ["mono8", "8UC1", "mono16", "8UC3", "8UC4", "16UC3", "MONO8"])
def test_grey_and_the_names_of_opencv(encoding):
    channels = int(encoding[-1]) if "C" in encoding else 1
    samples = random("u2" if "16" in encoding else "u1", channels)
    grey = samples if samples.dtype == np.uint8 else np.rint(samples / 257).astype(np.uint8)
    wanted = grey[:, :, 0] if channels == 1 else grey[:, :, [2, 1, 0]]
    assert (drawn(image(samples, encoding, padding=1)) == wanted).all()


@pytest.mark.parametrize(
    ("encoding", "sample"),
    [("16UC1", "u2"), ("16SC1", "i2"), ("32SC1", "i4"), ("32FC1", "f4"), ("64FC1", "f8")],
)
def test_depths_are_scaled_and_what_was_not_measured_is_black(encoding, sample):
    samples = RANDOM.integers(0, 100, (4, 6, 1)).astype(sample)
    samples[0, 0], samples[0, 1] = 0, 100
    missing = np.zeros((4, 6), bool)
    if "F" in encoding:
        samples[1, :3] = [[np.nan], [np.inf], [-np.inf]]
        missing[1, :3] = True
    wanted = np.where(missing, 0, np.rint(np.where(missing, 0, samples[:, :, 0]) * 2.55))
    for big in (False, True):
        assert abs(drawn(image(samples, encoding, 2, big)).astype(int) - wanted).max() <= 1
    assert not drawn(image(np.full((2, 2, 1), 7, sample), encoding)).any()


@given(
    arrays.arrays(
        np.float64, (3, 3), elements=st.floats(allow_nan=True, allow_infinity=True, width=64)
    )
)
@example(np.array([[5e-324, 0, 0], [-0.0, 0, 0], [0, 0, np.nan]]))
@example(np.array([[1.7e308, -1.7e308, 0], [np.inf, 0, 0], [0, 0, np.nan]]))
def test_any_numbers_have_a_picture(values):
    found = scaled_depth(values)
    known = np.isfinite(values)
    assert not found[~known].any()
    if known.any() and values[known].min() < values[known].max():
        assert set(found[values == values[known].max()]) == {255}
        assert set(found[values == values[known].min()]) == {0}


@pytest.mark.parametrize("cell", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("shape", [(4, 6), (5, 7)])
def test_a_cell_of_a_bayer_pattern_is_one_colour(cell, shape):
    samples = RANDOM.integers(0, 256, (*shape, 1)).astype("u1")
    found = drawn(image(samples, f"bayer_{cell}8"))
    assert found.shape == (*shape, 3)
    at = {(row, column): cell[row * 2 + column] for row in (0, 1) for column in (0, 1)}
    for y in range(0, shape[0] - 1, 2):
        for x in range(0, shape[1] - 1, 2):
            values = {"r": [], "g": [], "b": []}
            for (down, right), colour in at.items():
                values[colour].append(int(samples[y + down, x + right, 0]))
            wanted = [sum(values[colour]) // len(values[colour]) for colour in "rgb"]
            assert (found[y : y + 2, x : x + 2] == wanted).all()


def test_yuv422():
    for encoding, luma in (("yuv422", 1), ("yuv422_yuy2", 0)):
        samples = np.full((2, 4, 2), 128, np.uint8)
        samples[:, :, luma] = [[0, 50, 100, 255], [255, 100, 50, 0]]
        found = drawn(image(samples, encoding))
        assert (found == samples[:, :, luma, None].repeat(3, axis=2)).all()
        samples[:, 1::2, 1 - luma] = 255  # the second of both is red
        red, green, _ = drawn(image(samples, encoding))[0, 1]
        assert red > 200 and green == 0
    with pytest.raises(CorruptMessage, match="3 pixels wide"):
        drawn(image(np.zeros((2, 3, 2), np.uint8), "yuv422"))


def compressed(picture, kind, form, before=b"", **options):
    found = io.BytesIO()
    picture.save(found, kind, **options)
    return CompressedImage(format=form, data=before + found.getvalue())


def test_compressed_images():
    samples = random("u1", 3, 40, 60)
    msg = compressed(Pillow.fromarray(samples), "PNG", "bgr8; png compressed bgr8")
    assert (drawn(msg) == samples).all()
    jpeg = compressed(Pillow.fromarray(samples), "JPEG", "rgb8; jpeg compressed bgr8")
    assert (drawn(jpeg) == np.asarray(Pillow.open(io.BytesIO(jpeg.data)))).all()
    # Itself, and smaller where that is asked for.
    assert jpeg_of(row_of(jpeg)) == jpeg_of(row_of(jpeg), 60) == jpeg.data
    assert Pillow.open(io.BytesIO(jpeg_of(row_of(jpeg), 30))).size == (30, 20)
    assert Pillow.open(io.BytesIO(jpeg_of(row_of(msg)))).size == (60, 40)
    wide = (random("u2", 1, 4, 5)[:, :, 0], "mono16; png compressed mono16")
    found = drawn(compressed(Pillow.fromarray(wide[0]), "PNG", wide[1]))
    assert (found == np.rint(wide[0] / 257)).all()


def test_compressed_depths():
    depths = np.array([[0, 1000], [2000, 3000]], np.uint16)
    head = struct.pack("<iff", 0, 0.0, 0.0)
    msg = compressed(Pillow.fromarray(depths), "PNG", "16UC1; compressedDepth", head)
    assert (drawn(msg) == [[0, 85], [170, 255]]).all()
    # 32FC1 keeps inverses: raw = scale / depth + offset.
    scale, offset = 10_100.0, 100.0
    raw = np.array([[0, scale / 1.0 + offset], [scale / 2.0 + offset, scale / 3.0 + offset]])
    head = struct.pack("<iff", 0, scale, offset)
    picture = Pillow.fromarray(np.rint(raw).astype(np.uint16))
    found = drawn(compressed(picture, "PNG", "32FC1; compressedDepth", head)).astype(int)
    assert abs(found - [[0, 0], [128, 255]]).max() <= 1


def test_a_picture_is_shrunk_and_never_enlarged():
    msg = image(random("u1", 3, 40, 60), "rgb8")
    assert picture_of(row_of(msg), 30).size == (30, 20)
    assert picture_of(row_of(msg), 600).size == (60, 40)
    assert picture_of(row_of(image(random("u1", 1, 3, 500), "mono8")), 1).size == (1, 1)


@pytest.mark.parametrize(
    ("msg", "error", "text"),
    [
        (image(random("u1", 2), "8UC2"), UnknownEncoding, "encoded as '8UC2'.*known are rgb8"),
        (image(random("u1", 1), "h264"), UnknownEncoding, "encoded as 'h264'"),
        (
            Image(height=2, width=2, encoding="rgb8", step=6, data=b"x" * 11),
            CorruptMessage,
            "11 by",
        ),
        (
            Image(height=2, width=2, encoding="rgb8", step=5, data=b"x" * 12),
            CorruptMessage,
            "step 5",
        ),
        (Image(height=0, width=2, encoding="rgb8", step=6, data=b""), CorruptMessage, "2 x 0 pix"),
        (CompressedImage(format="h264", data=b"\0\0\0\1gg"), UnknownEncoding, "format 'h264'"),
        (CompressedImage(format="jpeg", data=b"\xff\xd8\xff\xe0"), UnknownEncoding, "'jpeg'"),
        (CompressedImage(format="png", data=b""), UnknownEncoding, "known are JPEG, PNG"),
    ],
    ids=range(8),
)
def test_what_cannot_be_drawn_says_why(msg, error, text):
    with pytest.raises(error, match=text):
        picture_of(row_of(msg))


def test_a_damaged_jpeg_and_another_type():
    whole = compressed(Pillow.fromarray(random("u1", 3, 64, 64)), "JPEG", "jpeg")
    whole.data = whole.data[: len(whole.data) // 2]
    with pytest.raises(CorruptMessage, match="/camera at 5 cannot be decoded: .*truncated"):
        picture_of(row_of(whole))
    other = SimpleNamespace(type="std_msgs/String", topic="/chatter", t=5)
    with pytest.raises(TypeMismatch, match="/chatter holds std_msgs/String: pictures are made of"):
        jpeg_of(other)


DRAWN = [f"{order}{bits}" for order in ("rgb", "rgba", "bgr", "bgra", "mono") for bits in (8, 16)]
DRAWN += [f"bayer_{cell}{bits}" for cell in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16)]
DRAWN += ["yuv422", "yuv422_yuy2"]
DRAWN += [f"{sample}C1" for sample in ("8U", "8S", "16U", "16S", "32S", "32F", "64F")]
DRAWN += ["8UC3", "8UC4", "16UC3", "16UC4"]
REFUSED = [f"{sample}C{n}" for sample in ("8S", "16S", "32S", "32F", "64F") for n in (2, 3, 4)]
REFUSED += ["8UC2", "16UC2", ""]


@pytest.mark.parametrize("encoding", DRAWN + REFUSED)
def test_each_encoding_of_ros_is_drawn_or_named(encoding):
    """All names of sensor_msgs/image_encodings.h; enough bytes for any of them."""
    msg = Image(height=4, width=6, encoding=encoding, data=bytes(range(200)) * 4)
    if encoding in DRAWN:
        assert drawn(msg).shape[:2] == (4, 6)
    else:
        with pytest.raises(UnknownEncoding, match=f"is encoded as '{encoding}', which cannot be"):
            drawn(msg)
