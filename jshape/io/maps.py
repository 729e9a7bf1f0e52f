"""Height maps on disk: an NPZ of plain arrays, which NumPy alone reads and writes too.

`height_m` (rows, columns) metres, NaN where nothing is known; `seen` (rows, columns) true or
false; `pitch_m`; `x_m` (columns) and `y_m` (rows) of the nodes, metres; `frame` (4, 4) from the
map's frame to the one that the cameras share, if they share one.
"""

import io
import os
from typing import Any

import numpy as np

from jshape.camera import check_pose
from jshape.errors import BadCamera, BadFile, BadImage, quoted
from jshape.height_map import HeightMap, as_frame, check_map
from jshape.io.arrays import read_arrays
from jshape.io.files import as_error, read_bytes, write_atomic

SUFFIX = ".npz"
LIMIT = 256 * 2**20
"""Most bytes that a map may have, packed or unpacked: 20 million nodes."""
OFF = 0.05
"""Share of the pitch that a node may lie off the grid."""
_NEEDED = ("height_m", "seen", "pitch_m", "x_m", "y_m")


def write_map(path: str | os.PathLike, found: HeightMap) -> None:
    """Write a height map, whole or not at all.

    Raises:
      BadImage: it can be none.
      BadFile: it cannot be written.
    """
    check_map(found, str(path))
    rows, columns = np.shape(found.heights)
    pitch = float(found.pitch)
    arrays: dict[str, Any] = {
        "height_m": np.asarray(found.heights, np.float32),
        "seen": found.mask,
        "pitch_m": np.float64(pitch),
        "x_m": float(found.origin[0]) + pitch * np.arange(columns),
        "y_m": float(found.origin[1]) + pitch * np.arange(rows),
    }
    if found.frame is not None:
        arrays["frame"] = np.array(found.frame)
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **arrays)
    write_atomic(path, stream.getvalue())


def read_map(path: str | os.PathLike) -> HeightMap:
    """A height map that `write_map`, or somebody's NumPy, wrote; arrays of other names are left.

    Raises:
      BadFile: it cannot be read, lacks an array, or its arrays do not fit each other.
    """
    where = str(path)
    arrays = read_arrays(read_bytes(path, limit=LIMIT), where, LIMIT)
    for name in _NEEDED:
        if name not in arrays:
            there = ", ".join(map(quoted, list(arrays)[:8])) or "nothing"
            raise BadFile(f"{where}: has no {name}, so it is no height map; it holds {there}")
    heights, seen = arrays["height_m"], arrays["seen"]
    if heights.ndim != 2 or heights.dtype.kind != "f":
        raise BadFile(
            f"{where}: height_m is {heights.dtype} of shape {heights.shape}; expected (rows, "
            "columns) of metres as floats"
        )
    if seen.shape != heights.shape or seen.dtype.kind not in "biu":
        raise BadFile(
            f"{where}: seen is {seen.dtype} of shape {seen.shape}; expected true or false of "
            f"{heights.shape}"
        )
    pitch = arrays["pitch_m"]
    if pitch.size != 1:
        raise BadFile(f"{where}: pitch_m has shape {pitch.shape}; expected one number, metres")
    step = float(pitch.reshape(()))
    rows, columns = heights.shape
    first = [_first(arrays[n], size, step, f"{where}: {n}")
             for n, size in (("x_m", columns), ("y_m", rows))]  # fmt: skip
    frame = arrays.get("frame")
    with as_error(BadFile, BadImage, BadCamera):
        if frame is not None:
            check_pose(frame, where, "frame")
        return check_map(
            HeightMap(
                heights.astype(np.float32),
                step,
                (first[0], first[1]),
                seen.astype(bool),
                None if frame is None else as_frame(frame),
            ),
            where,
        )


def _first(at: np.ndarray, size: int, pitch: float, where: str) -> float:
    """Where the first node along an axis is, if all lie `pitch` apart; else BadFile."""
    if at.shape != (size,) or at.dtype.kind not in "fiu":
        raise BadFile(
            f"{where} is {at.dtype} of shape {at.shape}; expected {size} numbers, as height_m has"
        )
    even = at[0] + pitch * np.arange(size)
    if not np.abs(at - even).max() <= OFF * abs(pitch):
        step = float(np.median(np.diff(at.astype(float)))) if size > 1 else 0.0
        mm = "; is one of them in millimetres?" if 0.5 < abs(step / (1e3 * pitch)) < 2 else ""
        mm = mm or ("; is one of them in millimetres?" if 0.5 < abs(1e3 * step / pitch) < 2 else "")
        raise BadFile(
            f"{where} goes up in steps of {step:g}, some or all of them; pitch_m is {pitch:g}{mm}"
        )
    return float(at[0])
