"""RVL, in which image_transport's compressedDepth may pack counts: runs of zeros, and differences.

Four bytes each say width and height, then words of 32 bits hold numbers of three bits a nibble, the
lowest first, whose fourth bit says that more follow.  The numbers are: how many pixels are 0, how
many are not, the difference of each of those to the one before it (its sign in the lowest bit); and
so on.  (Wilson, *Fast lossless depth image compression*, 2017.)
"""

import struct

import numpy as np

from jshape.errors import BadImage
from jshape.io.formats import PIXEL_LIMIT

_SIZE = struct.Struct("<II")
_LONGEST = 11
"""Nibbles of the longest number: 33 bits hold any that the words can mean."""
_LARGEST = 8
"""Bytes that a pixel takes at most: its difference has six nibbles, and may come after a run."""


def decode_rvl(data: bytes, where: str) -> np.ndarray:
    """The counts (H, W) of an RVL stream with its size before it.

    Raises:
      BadImage: it is cut off or damaged, or has more pixels than are read.
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
