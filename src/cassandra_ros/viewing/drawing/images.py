# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""Pictures of messages: sensor_msgs/Image and sensor_msgs/CompressedImage.

Colours of 8 bits are used unchanged, without alpha; those of 16 bits, and mono16, are scaled to 8
bits as by cv_bridge. Measurements (16UC1, 32FC1 and similar: depths) are drawn from black, the
minimum of the picture, to white, the maximum; pixels without a measurement (NaN, infinity) are
black. In a Bayer pattern each cell of 2 x 2 becomes one colour.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cassandra_ros.errors import CorruptMessage, TypeMismatch, UnknownEncoding
from cassandra_ros.installation import optional_module
from cassandra_ros.topics.stored_row import StoredRow

if TYPE_CHECKING:
    from PIL.Image import Image

IMAGE = "sensor_msgs/Image"
COMPRESSED = "sensor_msgs/CompressedImage"
IMAGE_TYPES = (IMAGE, COMPRESSED)
"""Message types that can be drawn."""
_DEPTH = "depth"
_YUV = ("uyvy", "yuyv")
_NAMED = {
    **{f"{name}8": ("u1", name) for name in ("rgb", "bgr", "rgba", "bgra")},
    **{f"{name}16": ("u2", name) for name in ("rgb", "bgr", "rgba", "bgra")},
    **{f"bayer_{cell}8": ("u1", cell) for cell in ("rggb", "bggr", "gbrg", "grbg")},
    **{f"bayer_{cell}16": ("u2", cell) for cell in ("rggb", "bggr", "gbrg", "grbg")},
    "mono8": ("u1", "l"),
    "mono16": ("u2", "l"),
    "yuv422": ("u1", "uyvy"),
    "yuv422_yuy2": ("u1", "yuyv"),
    "uyvy": ("u1", "uyvy"),
    "yuyv": ("u1", "yuyv"),
}
"""Sample type and order of the samples, by encoding."""
_OPENCV = re.compile(r"(8|16|32|64)(u|s|f)c([1-4])")
_OPENCV_COLOURS = {3: "bgr", 4: "bgra"}
_DECODERS = ("JPEG", "PNG", "WEBP", "BMP", "TIFF")
"""Formats accepted in a compressed image; other decoders of Pillow start programs."""
_JPEG_START = b"\xff\xd8"
_MAX_JPEG = 65_500
"""Maximum width or height of a JPEG, pixels."""
_MAX_PIXELS = 1 << 26
"""Maximum number of pixels of a compressed image. A few bytes can decode to very many pixels."""
_DEPTH_HEADER = struct.Struct("<iff")
"""Header that compressed_depth_image_transport writes: an enum and two parameters."""


class _SampleLayout(NamedTuple):
    """Arrangement of the samples of an encoding."""

    sample: str
    """numpy type of a sample, without byte order."""
    kind: str
    """Colours in order ('bgra'), 'l', 'depth', a Bayer cell ('rggb'), 'uyvy' or 'yuyv'."""

    @property
    def channels(self) -> int:
        """Number of samples per pixel."""
        if self.kind in _YUV:
            return 2
        return len(self.kind) if self.kind in ("rgb", "bgr", "rgba", "bgra") else 1


def picture_of(row: StoredRow, width: int | None = None) -> Image:
    """Draw the image in a message, in colours or grey.

    Args:
        row: Row of the message.
        width: Maximum width, pixels, at least 1; a wider image is shrunk. None = its own size.

    Raises:
        TypeMismatch: The message has none of the types IMAGE_TYPES.
        UnknownEncoding: The encoding of its pixels cannot be drawn.
        CorruptMessage: The image is malformed, or has no pixels.
        MissingDependency: Pillow is not installed.
    """
    msg = _message(row)
    picture = _draw(row, msg) if row.type == IMAGE else _decompress(row, msg, width)
    if width is not None:
        picture.thumbnail((width, max(1, picture.height)))
    return picture


def jpeg_of(row: StoredRow, width: int | None = None, quality: int = 85) -> bytes:
    """Return the image in a message as a JPEG; an image that is a JPEG stays unchanged.

    Args:
        row: Row of the message.
        width: As in picture_of; errors are the same too.
        quality: Quality of images compressed here, 1 to 95.
    """
    msg = _message(row)
    if row.type == COMPRESSED and bytes(msg.data[:2]) == _JPEG_START:
        stored_width = _open_image(row, bytes(msg.data)).width
        if width is None or stored_width <= width:
            return bytes(msg.data)
    picture, jpeg = picture_of(row, width), io.BytesIO()
    picture.thumbnail((_MAX_JPEG, _MAX_JPEG))
    picture.save(jpeg, "JPEG", quality=quality)
    return jpeg.getvalue()


def _message(row: StoredRow) -> Any:
    if row.type not in IMAGE_TYPES:
        raise TypeMismatch(
            f"topic {row.topic} holds {row.type}: pictures are made of {' and '.join(IMAGE_TYPES)}"
        )
    return row.message()


def _draw(row: StoredRow, msg: Any) -> Image:
    layout = _layout_of(row, str(msg.encoding))
    samples = _samples(row, msg, layout)
    if layout.kind in _YUV:
        return _from_yuv(row, samples, layout.kind)
    if layout.kind == _DEPTH:
        return _picture(scaled_depth(samples[:, :, 0]))
    grey = _to_bytes(samples)
    if layout.channels == 1:
        plane = grey[:, :, 0]
        return _picture(plane if layout.kind == "l" else _from_bayer(plane, layout.kind))
    return _picture(grey[:, :, [layout.kind.index(colour) for colour in "rgb"]])


def _layout_of(row: StoredRow, encoding: str) -> _SampleLayout:
    name = encoding.strip().lower()
    if name in _NAMED:
        return _SampleLayout(*_NAMED[name])
    match = _OPENCV.fullmatch(name)
    if match is not None:
        bits, sign, channels = int(match[1]), match[2], int(match[3])
        sample = f"{'i' if sign == 's' else sign}{bits // 8}"
        if channels == 1 and sample != "f1":
            return _SampleLayout(sample, "l" if sample == "u1" else _DEPTH)
        if channels in _OPENCV_COLOURS and sample in ("u1", "u2"):
            return _SampleLayout(sample, _OPENCV_COLOURS[channels])
    encodings = ", ".join([*_NAMED, "8UC1, 8UC3, 8UC4, 16UC1, 16SC1, 32SC1, 32FC1, 64FC1"])
    raise UnknownEncoding(
        f"the image of topic {row.topic} at {row.t} is encoded as {encoding!r:.80}, which cannot "
        f"be drawn; known are {encodings}"
    )


def _samples(row: StoredRow, msg: Any, layout: _SampleLayout) -> np.ndarray[Any, Any]:
    """Return a view of the samples: rows, columns, channels."""
    sample = np.dtype(layout.sample).newbyteorder(">" if msg.is_bigendian else "<")
    height, width, size = int(msg.height), int(msg.width), sample.itemsize
    least = width * layout.channels * size
    step = int(msg.step) or least
    # The padding after the pixels may be missing in the last row.
    needed = step * (height - 1) + least
    if not (height and width) or step < least or len(msg.data) < needed:
        raise CorruptMessage(
            f"the image of topic {row.topic} at {row.t} is damaged: {width} x {height} pixels of "
            f"{msg.encoding}, step {msg.step}, in {len(msg.data)} bytes"
        )
    shape = (height, width, layout.channels)
    return np.ndarray(shape, sample, msg.data, strides=(step, layout.channels * size, size))


def _to_bytes(samples: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Scale samples of 16 bits to 8 bits, rounded; those of 8 bits stay unchanged."""
    if samples.dtype.itemsize == 1:
        return samples
    rounded: np.ndarray[Any, Any] = (samples.astype(np.uint32) + 128) // 257
    return rounded.astype(np.uint8)


def scaled_depth(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Scale numbers to 0 (minimum) to 255 (maximum), rounded; infinities and NaN become 0."""
    exact = values.astype(np.float64)
    finite = np.isfinite(exact)
    if not finite.any():
        return np.zeros(exact.shape, np.uint8)
    least, greatest = exact[finite].min(), exact[finite].max()
    with np.errstate(over="ignore", invalid="ignore"):
        if not np.isfinite(greatest - least):
            exact, least, greatest = exact / 2, least / 2, greatest / 2
        fraction = (exact - least) / (greatest - least or 1.0)
    fraction[~finite] = 0
    scaled: np.ndarray[Any, Any] = np.rint(fraction * 255).astype(np.uint8)
    return scaled


def _from_bayer(cells: np.ndarray[Any, Any], pattern: str) -> np.ndarray[Any, Any]:
    height, width = cells.shape
    # At an odd border, mirroring a row or column continues the pattern.
    even = np.pad(cells, ((0, height % 2), (0, width % 2)), mode="reflect")
    planes = [even[down::2, right::2] for down in (0, 1) for right in (0, 1)]
    greens = [plane for plane, colour in zip(planes, pattern) if colour == "g"]
    green = (greens[0].astype(np.uint16) + greens[1]) // 2
    red, blue = planes[pattern.index("r")], planes[pattern.index("b")]
    small = np.stack([red, green.astype(np.uint8), blue], axis=-1)
    whole: np.ndarray[Any, Any] = small.repeat(2, axis=0).repeat(2, axis=1)
    return whole[:height, :width]


def _from_yuv(row: StoredRow, samples: np.ndarray[Any, Any], kind: str) -> Image:
    if samples.shape[1] % 2:
        raise CorruptMessage(
            f"the image of topic {row.topic} at {row.t} is damaged: two pixels of yuv422 share "
            f"their colour, and it is {samples.shape[1]} pixels wide"
        )
    luma, chroma = samples[:, :, kind.index("y")], samples[:, :, kind.index("u") % 2]
    planes = [luma, *(chroma[:, first::2].repeat(2, axis=1) for first in (0, 1))]
    image = optional_module("PIL.Image", "a picture")
    merged: Image = image.merge("YCbCr", [_picture(plane) for plane in planes])
    return merged.convert("RGB")


def _picture(values: np.ndarray[Any, Any]) -> Image:
    """Make a picture of bytes: grey from two dimensions, RGB from three."""
    image = optional_module("PIL.Image", "a picture")
    picture: Image = image.fromarray(np.ascontiguousarray(values))
    return picture


def _decompress(row: StoredRow, msg: Any, width: int | None) -> Image:
    form, data = str(msg.format), bytes(msg.data)
    parameters = None
    if "compressedDepth" in form and len(data) > _DEPTH_HEADER.size:
        parameters, data = _DEPTH_HEADER.unpack_from(data), data[_DEPTH_HEADER.size :]
    picture = _open_image(row, data)
    try:
        if picture.format == "JPEG" and width is not None:
            picture.draft(None, (width, 1))  # decodes at a reduced size
        picture.load()
    except (OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error) as exc:
        raise _undecodable(row, str(exc)) from exc
    if not picture.mode.startswith(("I", "F")):
        return picture.convert("L" if picture.mode in ("1", "L", "LA") else "RGB")
    values = np.asarray(picture)
    if form.startswith("mono16"):
        return _picture(_to_bytes(values.astype(np.uint16)))
    if parameters is not None and form.startswith("32FC1"):
        values = _depth_of_inverse(values, parameters[1], parameters[2])
    return _picture(scaled_depth(values))


def _depth_of_inverse(
    values: np.ndarray[Any, Any], scale: float, offset: float
) -> np.ndarray[Any, Any]:
    """Return depths from the inverse depths of compressed_depth_image_transport; 0 = unknown."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(values == 0, np.nan, scale / (values - np.float64(offset)))


def _open_image(row: StoredRow, data: bytes) -> Image:
    """Open a compressed image without decoding its pixels."""
    image = optional_module("PIL.Image", "a picture")
    try:
        picture: Image = image.open(io.BytesIO(data), formats=_DECODERS)
    except image.UnidentifiedImageError as exc:
        raise UnknownEncoding(
            f"the image of topic {row.topic} at {row.t} is compressed in a way that cannot be "
            f"drawn (format {str(row.message().format)!r:.80}); known are {', '.join(_DECODERS)}"
        ) from exc
    except (OSError, SyntaxError, ValueError, struct.error, image.DecompressionBombError) as exc:
        raise _undecodable(row, str(exc)) from exc
    if picture.width * picture.height > _MAX_PIXELS:
        raise _undecodable(
            row, f"it has {picture.width} x {picture.height} pixels, which are too many"
        )
    return picture


def _undecodable(row: StoredRow, why: str) -> CorruptMessage:
    return CorruptMessage(f"the image of topic {row.topic} at {row.t} cannot be decoded: {why}")
