"""ROS messages to arrays: `sensor_msgs/Image`, and image_transport's packed ones (PNG, RVL).

An array is (H, W), uint16 (counts) or float32 (metres; 0, NaN and infinity are no reading).
"""

import struct
from typing import Any

import numpy as np

from jshape.errors import BadImage, quoted
from jshape.io.formats import PIXEL_LIMIT, read_png

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"

ENCODINGS = {"16UC1": "u2", "32FC1": "f4", "mono16": "u2"}
"""What depth is written in.  Infrared is mono16 too: such a topic must have depth in its name."""

_HEADER = struct.Struct("<iff")
_PNG = b"\x89PNG"
_SIZE = struct.Struct("<II")
_LONGEST = 11
"""Nibbles of the longest number of RVL: 33 bits hold any that the words can mean."""
_LARGEST = 8
"""Bytes that a pixel takes at most: its difference has six nibbles, and may come after a run."""


def encoding_of(message: Any, topic: str) -> str | None:
    """The encoding of an image if it is depth, else None."""
    if message.__msgtype__ == IMAGE:
        name = message.encoding
        good = name in ENCODINGS and (name != "mono16" or "depth" in topic.lower())
        return name if good else None
    name, how = _format(message)
    if "compressedDepth" in how:
        return name if name in ENCODINGS else None
    # As image_transport's `compressed` packs counts; some write no more than "png".
    grey16 = bytes(message.data[:26])[24:] == b"\x10\0" and _is_png(message.data)
    return "16UC1" if grey16 and (name == "16UC1" or "depth" in topic.lower()) else None


def decode(message: Any, where: str) -> np.ndarray:
    """The depth image (H, W) of a message.

    Raises BadImage: another encoding, or fewer bytes than the message says.
    """
    return _plain(message, where) if message.__msgtype__ == IMAGE else _packed(message, where)


def _plain(message: Any, where: str) -> np.ndarray:
    if message.encoding not in ENCODINGS:
        raise BadImage(
            f"{where}: is {quoted(message.encoding)}; depth is one of {', '.join(ENCODINGS)}"
        )
    dtype = np.dtype(ENCODINGS[message.encoding]).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = int(message.height), int(message.width), int(message.step)
    if not 0 < height * width <= PIXEL_LIMIT:
        raise BadImage(f"{where}: has {width}x{height} pixels; 1 to {PIXEL_LIMIT:,} are read")
    if step < width * dtype.itemsize or message.data.size < step * height:
        raise BadImage(
            f"{where}: has {message.data.size:,} bytes for {width}x{height} pixels in rows of "
            f"{step} bytes: the frame is cut off"
        )
    # Rows may be longer than their pixels.
    rows = np.asarray(message.data, np.uint8)[: step * height].reshape(height, step)
    pixels = np.ascontiguousarray(rows[:, : width * dtype.itemsize]).view(dtype)
    return pixels.astype(dtype.newbyteorder("="))


def _packed(message: Any, where: str) -> np.ndarray:
    """A PNG; in compressedDepth a PNG or RVL after twelve bytes: how it was made, and two numbers.

    What names no codec and is no PNG is RVL: so old versions of image_transport wrote it.
    """
    name, how = _format(message)
    data = np.asarray(message.data, np.uint8).tobytes()
    a, b, rvl = 0.0, 0.0, False
    if "compressedDepth" in how and name in ENCODINGS:
        if len(data) < _HEADER.size:
            raise BadImage(f"{where}: has {len(data)} bytes: the frame is cut off")
        _, a, b = _HEADER.unpack(data[: _HEADER.size])
        data = data[_HEADER.size :]
        rvl = not _is_png(data)
        if rvl and "png" in how.lower():
            raise BadImage(f"{where}: is {quoted(message.format)} and holds no PNG")
    elif not _is_png(data) or name == "32FC1":
        raise BadImage(
            f"{where}: is {quoted(message.format)}; packed depth is compressedDepth or a PNG"
        )
    counts = decode_rvl(data, where) if rvl else read_png(data, where)
    if counts.dtype != np.uint16:
        raise BadImage(f"{where}: holds a PNG of {counts.dtype}; packed depth has 16 bits")
    if name != "32FC1":
        return counts
    if not 0 < a < np.inf or not np.isfinite(b):
        raise BadImage(
            f"{where}: compressedDepth's numbers are {a:g} and {b:g}: no depth is stated"
        )
    # compressed_depth_image_transport keeps inverse depths: fine steps near, coarse ones far.
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.float32(a) / (counts.astype(np.float32) - np.float32(b))
    return np.where(counts > 0, depth, np.float32(0.0)).astype(np.float32)


def _format(message: Any) -> tuple[str, str]:
    """The encoding of a CompressedImage and how it is packed: "16UC1; compressedDepth png"."""
    name, _, how = message.format.partition(";")
    return name.strip(), how


def _is_png(data: Any) -> bool:
    return bytes(data[: len(_PNG)]) == _PNG


def decode_rvl(data: bytes, where: str) -> np.ndarray:
    """The counts (H, W) of an RVL stream: runs of zeros, and differences.

    Four bytes each say width and height, then words of 32 bits hold numbers of three bits a nibble,
    the lowest first, whose fourth bit says that more follow.  The numbers are: how many pixels are
    0, how many are not, the difference of each of those to the one before it (its sign in the
    lowest bit); and so on.  (Wilson, *Fast lossless depth image compression*, 2017.)

    Raises BadImage: it is cut off or damaged, or has more pixels than are read.
    """
    broken = BadImage(f"{where}: the RVL stream is cut off or damaged")
    if len(data) < _SIZE.size:
        raise broken
    width, height = _SIZE.unpack_from(data)
    total = width * height
    if not 0 < total <= PIXEL_LIMIT:
        raise BadImage(f"{where}: has {width}x{height} pixels; 1 to {PIXEL_LIMIT:,} are read")
    numbers = _numbers(data[_SIZE.size : _SIZE.size + _LARGEST * total + 64])
    if numbers is None:
        raise broken
    starts = _starts(numbers)
    zeros, count = numbers[starts], numbers[starts + 1]
    after = (zeros + count).cumsum()
    end = int(np.searchsorted(after, total))
    if end == len(after) or after[end] != total:
        raise broken
    number, count, pixel = starts[: end + 1] + 2, count[: end + 1], (after - count)[: end + 1]
    if number[-1] + count[-1] > len(numbers):
        raise broken
    within = np.arange(count.sum()) - np.repeat(count.cumsum() - count, count)
    difference = numbers[np.repeat(number, count) + within]
    difference = (difference >> 1) ^ -(difference & 1)
    counts = np.zeros(total, np.uint16)
    counts[np.repeat(pixel, count) + within] = difference.cumsum().astype(np.uint16)
    return counts.reshape(height, width)


def _numbers(data: bytes) -> np.ndarray | None:
    """All numbers in the words of a stream; None: one has no end."""
    words = np.frombuffer(data, "<u4", len(data) // 4).astype(">u4").view(np.uint8)
    nibbles = np.stack([words >> 4, words & 15], 1).reshape(-1)
    last = np.flatnonzero(nibbles < 8)
    if not last.size:
        return None
    nibbles = nibbles[: last[-1] + 1]
    first = np.concatenate([[0], last[:-1] + 1])
    length = last - first + 1
    if length.max() > _LONGEST:
        return None
    place = np.arange(len(nibbles)) - np.repeat(first, length)
    return np.add.reduceat((nibbles & 7).astype(np.int64) << (3 * place), first)


def _starts(numbers: np.ndarray) -> np.ndarray:
    """Which numbers begin a run: say how many pixels are 0, before how many are not."""
    values, starts, at = numbers.tolist(), [], 0
    last = len(values) - 1
    while at < last:
        starts.append(at)
        at += 2 + values[at + 1]
    return np.array(starts, np.int64)
