"""PCD, the point cloud format of PCL: header and points, ASCII, binary or compressed.

trimesh has no reader of it; those of PyPI bring pydantic and a compiled LZF for these few rules.
"""

from pathlib import Path
from typing import Any

import numpy as np

from jshape._typing import Float
from jshape.errors import BadFile, one_line, quoted

UNPACKED_LIMIT = 2**27
"""Most bytes that a compressed PCD may unpack to: some 8 million points."""


def parse_pcd(path: Path, data: bytes) -> Float[np.ndarray, "P 3"]:
    """The x, y, z of every point of a PCD file's bytes, wherever they stand among its fields.

    Args:
      path: what the file is called in errors.
      data: its content; DATA ascii, binary or binary_compressed, x y z as float32 or float64.

    Returns:
      (P, 3) floating point, metres; may hold NaN.

    Raises:
      BadFile: a damaged header, too few points, or no x y z.
    """
    try:
        return _points(data)
    except KeyError as missing:
        raise BadFile(f"{path}: the header of the PCD has no {missing.args[0]}") from None
    except (ValueError, TypeError, IndexError, OverflowError, MemoryError) as problem:
        raise BadFile(f"{path}: the PCD is damaged or cut off: {one_line(problem)}") from None


def _points(data: bytes) -> np.ndarray:
    header, start = _header(data)
    names = [name.lower() for name in header["FIELDS"]]
    counts = header.get("COUNT", ["1"] * len(names))
    layout = zip(header["TYPE"], header["SIZE"], counts, names, strict=True)
    point = np.dtype(
        [(f"f{k}", f"<{t.lower()}{size}", (int(n),)) for k, (t, size, n, _) in enumerate(layout)]
    )
    if any(names.count(axis) != 1 for axis in "xyz"):
        raise ValueError(f"x, y and z are needed; its fields are {' '.join(names)[:80]}")
    xyz = [f"f{names.index(axis)}" for axis in "xyz"]
    if any(point[name].base.kind != "f" or point[name].shape != (1,) for name in xyz):
        raise ValueError("x, y and z must each be one F4 or F8")
    size = header["POINTS"] if "POINTS" in header else [*header["WIDTH"], *header["HEIGHT"]]
    count = int(np.prod([int(n) for n in size]))
    if count <= 0:
        raise ValueError("it holds no points")
    kind, body = " ".join(header["DATA"]).lower(), data[start:]
    if kind == "ascii":
        return _ascii(body, point, xyz, count)
    if kind == "binary":
        table = np.frombuffer(body, point, count)
        return np.stack([table[name][:, 0] for name in xyz], -1)
    if kind != "binary_compressed":
        raise ValueError(f"DATA is {quoted(kind)}; allowed: ascii, binary, binary_compressed")
    packed, unpacked = (int(n) for n in np.frombuffer(body, "<u4", 2))
    if unpacked != count * point.itemsize or len(body) < 8 + packed:
        raise ValueError(f"{count:,} points expected")
    if unpacked > UNPACKED_LIMIT:
        raise ValueError(f"unpacks to {unpacked:,} bytes; at most {UNPACKED_LIMIT:,} are read")
    plain = _unpack_lzf(body[8 : 8 + packed], unpacked)
    starts: Any = point.fields  # packed field by field: all of x, then all of y, ...
    return np.stack(
        [np.frombuffer(plain, point[n].base, count, count * starts[n][1]) for n in xyz], -1
    )


def _header(data: bytes) -> tuple[dict[str, list[str]], int]:
    """The words behind every key of the header, and where the points begin."""
    header: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in header:
        end = data.find(b"\n", start)
        if end < 0:
            raise KeyError("DATA")
        key, *words = data[start:end].decode("ascii").split() or ["#"]
        header[key.upper()] = words
        start = end + 1
    return header, start


def _ascii(text: bytes, point: np.dtype, xyz: list[str], count: int) -> np.ndarray:
    first = np.cumsum([0, *(point[name].shape[0] for name in point.names or ())])
    lines = [line for line in text.splitlines() if line.strip()][:count]
    rows = np.array([line.split() for line in lines], "S").astype(float)
    if rows.shape != (count, first[-1]):
        raise ValueError(f"{count:,} points of {first[-1]} numbers expected, {len(lines):,} found")
    return rows[:, [first[int(name[1:])] for name in xyz]]


def _unpack_lzf(data: bytes, size: int) -> bytearray:
    """What LZF packed: runs of new bytes, and copies of what stands up to 8 KiB before.

    Raises IndexError, ValueError: it is damaged.
    """
    out, at = bytearray(), 0
    while at < len(data):
        first, at = data[at], at + 1
        if first < 32:
            out += data[at : at + first + 1]
            at += first + 1
            continue
        length = first >> 5
        if length == 7:
            length, at = length + data[at], at + 1
        length += 2
        back, at = ((first & 31) << 8) + data[at] + 1, at + 1
        if back > len(out) or len(out) + length > size:
            raise ValueError("a copy of what is not there, or more than was said")
        piece = out[len(out) - back :][:length]
        out += (piece * (length // len(piece) + 1))[:length]  # it may reach into itself
    if len(out) != size:
        raise ValueError("another size than was said")
    return out
