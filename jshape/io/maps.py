"""Height maps on disk: an NPZ of plain arrays, which NumPy alone reads and writes too.

`height_m` (rows, columns) metres, NaN where nothing is known; `seen` (rows, columns) true or
false; `pitch_m`; `x_m` (columns) and `y_m` (rows) of the nodes, metres; `frame` (4, 4) from the
map's frame to the one that the cameras share, if they share one.
"""

import os
from typing import Any

import numpy as np

from jshape.camera import check_pose
from jshape.errors import BadCamera, BadFile, BadImage, quoted
from jshape.height_map import HeightMap, as_frame, check_map
from jshape.io.arrays import npz_bytes, read_arrays
from jshape.io.files import as_error, read_bytes, write_atomic

SUFFIX = ".npz"
LIMIT = 256 * 2**20
"""Most bytes that a map may have, packed or unpacked: 20 million nodes."""
OFF = 0.05
"""Share of the pitch that a node may lie off the grid."""
_KINDS = {"f": "metres as floats", "biu": "true or false", "fiu": "metres"}
"""What arrays of these kinds (`dtype.kind`) hold."""


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
    write_atomic(path, npz_bytes(arrays))


def read_map(path: str | os.PathLike) -> HeightMap:
    """A height map that `write_map`, or somebody's NumPy, wrote; arrays of other names are left.

    Raises BadFile: it cannot be read, lacks an array, or its arrays do not fit each other.
    """
    where = str(path)
    arrays = read_arrays(read_bytes(path, limit=LIMIT), where, LIMIT)

    def array(name: str, kinds: str, shape: tuple[int, ...] | None = None) -> np.ndarray:
        if name not in arrays:
            there = ", ".join(map(quoted, list(arrays)[:8])) or "nothing"
            raise BadFile(f"{where}: has no {name}, so it is no height map; it holds {there}")
        found = np.squeeze(arrays[name]) if shape == () else arrays[name]
        fits = found.ndim == 2 if shape is None else found.shape == shape
        if not fits or found.dtype.kind not in kinds:
            raise BadFile(
                f"{where}: {name} is {found.dtype} of shape {found.shape}; expected {_KINDS[kinds]}"
                f" of shape {'(rows, columns)' if shape is None else shape}"
            )
        return found

    heights = array("height_m", "f")
    rows, columns = heights.shape
    seen, pitch = array("seen", "biu", heights.shape), float(array("pitch_m", "fiu", ()))
    x, y = (
        _first(array(name, "fiu", (size,)), pitch, f"{where}: {name}")
        for name, size in (("x_m", columns), ("y_m", rows))
    )
    frame = arrays.get("frame")
    with as_error(BadFile, BadImage, BadCamera):
        if frame is not None:
            check_pose(frame, where, "frame")
            frame = as_frame(frame)
        heights = heights.astype(np.float32)
        return check_map(HeightMap(heights, pitch, (x, y), seen.astype(bool), frame), where)


def _first(at: np.ndarray, pitch: float, where: str) -> float:
    """Where the first node along an axis is, if all lie `pitch` apart; else BadFile."""
    if not np.abs(at - (at[0] + pitch * np.arange(len(at)))).max() <= OFF * abs(pitch):
        step = float(np.median(np.diff(at.astype(float)))) if len(at) > 1 else 0.0
        raise BadFile(
            f"{where} goes up in steps of {step:g}, some or all of them; pitch_m is {pitch:g}; all "
            "are metres"
        )
    return float(at[0])
