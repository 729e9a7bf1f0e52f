"""PCD, the point cloud format of PCL: header and points, ASCII, binary or compressed.

trimesh has no reader of it; those of PyPI bring pydantic and a compiled LZF for these few rules.
"""

from pathlib import Path

import numpy as np

from jshape._typing import Float
from jshape.errors import BadFile, one_line, quoted

UNPACKED_LIMIT = 2**27
"""Most bytes that a compressed PCD may unpack to: some 8 million points."""
_KEYS = ("FIELDS", "SIZE", "TYPE", "COUNT", "POINTS", "DATA")


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
    header, start = _header(path, data)
    names, dtype = _layout(path, header)
    try:
        count = int(header["POINTS"][0])
    except (ValueError, IndexError):
        raise BadFile(f"{path}: POINTS of the PCD is not a number") from None
    if count <= 0:
        raise BadFile(f"{path}: holds no points")
    kind, body = " ".join(header["DATA"]).lower(), data[start:]
    cut_off = BadFile(f"{path}: the PCD is cut off: {count:,} points expected")
    if kind == "ascii":
        return _ascii(path, body, names, dtype, count)
    if kind == "binary":
        if len(body) < count * dtype.itemsize:
            raise cut_off
        table = np.frombuffer(body, dtype, count)
        return np.stack([table[f"f{names.index(axis)}"][:, 0] for axis in "xyz"], -1)
    if kind != "binary_compressed":
        raise BadFile(
            f"{path}: DATA of the PCD is {quoted(kind)}; allowed: ascii, binary, binary_compressed"
        )
    packed, unpacked = (int.from_bytes(body[k : k + 4], "little") for k in (0, 4))
    if unpacked != count * dtype.itemsize or len(body) < 8 + packed:
        raise cut_off
    if unpacked > UNPACKED_LIMIT:
        raise BadFile(f"{path}: unpacks to {unpacked:,} bytes; at most {UNPACKED_LIMIT:,} are read")
    try:
        plain = _unpack_lzf(body[8 : 8 + packed], unpacked)
    except (IndexError, ValueError):
        raise BadFile(f"{path}: the PCD is damaged: it does not unpack") from None
    columns, at = {}, 0  # packed field by field: all of x, then all of y, ...
    for k, name in enumerate(names):
        field = dtype[k]
        columns[name] = np.frombuffer(plain, field.base, count * field.shape[0], at)
        at += count * field.itemsize
    return np.stack([columns[axis] for axis in "xyz"], -1)


def _unpack_lzf(data: bytes, size: int) -> bytearray:
    """What LZF packed: runs of new bytes, and copies of what stands up to 8 KiB before.

    Raises:
      IndexError, ValueError: it is damaged.
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


def _header(path: Path, data: bytes) -> tuple[dict[str, list[str]], int]:
    """The header's lines by key, and where the points start."""
    header: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in header:
        end = data.find(b"\n", at, at + 10_000)
        if end < 0 or at > 100_000:
            raise BadFile(f"{path}: is not a PCD file (no DATA line)")
        words = data[at:end].decode("latin-1").split()
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
        at = end + 1
    header.setdefault("COUNT", ["1"] * len(header.get("FIELDS", [])))
    if "POINTS" not in header and "WIDTH" in header:
        try:
            width, height = int(header["WIDTH"][0]), int(header.get("HEIGHT", ["1"])[0])
        except (ValueError, IndexError):
            raise BadFile(f"{path}: WIDTH or HEIGHT of the PCD is not a number") from None
        header["POINTS"] = [str(width * height)]
    absent = [key for key in _KEYS if key not in header]
    if absent:
        raise BadFile(f"{path}: the header of the PCD has no {', '.join(absent)}")
    return header, at


def _layout(path: Path, header: dict[str, list[str]]) -> tuple[list[str], np.dtype]:
    """Names of the fields, and the type of one point with fields f0, f1, ..."""
    names = [name.lower() for name in header["FIELDS"]]
    if any(names.count(axis) != 1 for axis in "xyz"):
        raise BadFile(f"{path}: the PCD has fields {' '.join(names)[:80]}; x, y and z are needed")
    columns = header["TYPE"], header["SIZE"], header["COUNT"]
    if any(len(column) != len(names) for column in columns):
        raise BadFile(f"{path}: FIELDS, SIZE, TYPE and COUNT of the PCD differ in length")
    fields = []
    for k, (name, kind, size, count) in enumerate(zip(names, *columns, strict=True)):
        code = f"<{kind.lower()}{size}"
        known = (
            code in ("<f4", "<f8") or kind.upper() in ("I", "U") and size in ("1", "2", "4", "8")
        )
        if not known or not count.isascii() or not count.isdigit() or not 1 <= int(count) < 1e6:
            raise BadFile(f"{path}: field {name} of the PCD has type {kind}{size}, count {count}")
        if name in ("x", "y", "z") and code not in ("<f4", "<f8"):
            raise BadFile(f"{path}: field {name} of the PCD is {kind}{size}; it must be F4 or F8")
        fields.append((f"f{k}", code, (int(count),)))
    return names, np.dtype(fields)


def _ascii(path: Path, text: bytes, names: list[str], dtype: np.dtype, count: int) -> np.ndarray:
    widths = [dtype[k].shape[0] for k in range(len(names))]
    columns = [sum(widths[: names.index(axis)]) for axis in "xyz"]
    rows = [row for row in map(bytes.split, text.split(b"\n")) if row][:count]
    if len(rows) < count:
        raise BadFile(f"{path}: the PCD is cut off: {count:,} points expected, {len(rows):,} found")
    if any(len(row) != sum(widths) for row in rows):
        raise BadFile(f"{path}: a point of the PCD has not {sum(widths)} numbers")
    try:
        return np.array([[float(row[k]) for k in columns] for row in rows])
    except ValueError as problem:
        raise BadFile(f"{path}: a point of the PCD is not a number: {one_line(problem)}") from None
