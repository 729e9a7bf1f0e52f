"""Depth images on disk.

Arrays are (H, W), `[v, u]`, metres, float32; NaN = no reading.  Counts are whole numbers of
`depth_unit` metres, uint16, 0 = no reading.
"""

import os
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from jshape._typing import Float
from jshape.camera import Camera
from jshape.data.depth import check_depth, check_depth_unit, check_shape, check_unit, to_metres
from jshape.data.missing import check_image, missing, only_readings
from jshape.errors import BadImage
from jshape.io.cameras import DEPTH_UNIT
from jshape.io.files import write_atomic
from jshape.io.formats import encode_png, read_array


def read_depth(
    path: str | os.PathLike,
    *,
    raw: np.ndarray | None = None,
    depth_unit: float = DEPTH_UNIT,
    camera: Camera | None = None,
    check_range: bool = True,
    left_out: Counter[str] | None = None,
) -> Float[np.ndarray, "H W"]:
    """A depth image: PNG, TIFF or NPY, one channel.

    uint16 is counts of `depth_unit`; floating point is metres; 8 bits are the luminance of
    `camera`, white = z_min and black = z_max, where 0 and 255 are clipped depths and not missing
    ones.  What is no reading in the others, `data.missing.readings` says.

    Args:
      path: the file.
      raw: (H, W), what `read_array` gave of it, if it was read already.
      depth_unit: metres per count.
      camera: whose image it is: its size and range are checked.  8-bit images need it.
      check_range: False takes depths outside the camera's range as well (8 bits hold none), unless
        another unit would bring them there.
      left_out: adds up why pixels are no readings.

    Raises:
      BadFile: it cannot be read.
      BadImage: it is not a depth image, has no reading at all, or does not fit the camera.
      BadCamera: depth_unit is not a positive number.
    """
    raw = read_array(path) if raw is None else raw
    where, depth_unit = str(path), check_depth_unit(depth_unit, str(path))
    luminance = raw.dtype == np.uint8
    if luminance and camera is None:
        raise BadImage(f"{where}: 8-bit images are luminance and need a camera to be depth")
    depth = raw if luminance else to_metres(raw, depth_unit, where, left_out)
    if not luminance and np.isnan(depth).all():
        raise BadImage(f"{where}: no pixel has a reading")
    if camera is None:
        return depth
    check_shape(depth, camera, where)
    if luminance:
        for level, colour in ((0, "black"), (255, "white")):
            if (raw == level).all():
                raise BadImage(
                    f"{where}: every pixel is {colour}: nothing within the camera's range"
                )
        return np.asarray(replace(camera, bits=8).depth(raw), np.float32)
    check = check_depth if check_range else check_unit
    return check(depth, camera, where, depth_unit if raw.dtype == np.uint16 else None)


def read_counts(
    path: str | os.PathLike, left_out: Counter[str] | None = None, *, covered: bool = False
) -> np.ndarray:
    """The counts of a 16-bit single-channel frame, (H, W) uint16, 0 = no reading.

    Raises:
      BadFile: the file cannot be read.
      BadImage: it is not such an image, or (unless the lens may be `covered`) has no reading.
    """
    counts = read_array(path)
    if counts.dtype != np.uint16:
        raise BadImage(f"{path}: holds {counts.dtype}; a frame is 16-bit, one channel")
    counts = only_readings(counts, left_out)
    if not (covered or counts.any()):
        raise BadImage(f"{path}: no pixel has a reading")
    return counts


def to_counts(depth: np.ndarray, depth_unit: float, where: str = "image") -> np.ndarray:
    """Counts (H, W) uint16 of depths in metres; 0, NaN and infinity become 0.

    Raises:
      BadImage: a depth needs more than 16 bits, or is nearer than half a count.
      BadCamera: depth_unit is not a positive number.
    """
    depth_unit = check_depth_unit(depth_unit, where)
    depth = check_image(depth, where)
    seen = ~missing(depth)
    counts = np.rint(np.where(seen, depth, 0.0).astype(np.float64) / depth_unit)
    if counts.max() > 65534:  # the largest is no reading
        raise BadImage(
            f"{where}: depth {np.where(seen, depth, 0.0).max():g} m is {counts.max():.0f} counts "
            f"of {depth_unit:g} m; 16 bits hold at most 65534"
        )
    if (counts[seen] == 0).any():
        raise BadImage(
            f"{where}: depth {depth[seen].min():g} m is less than half a count of {depth_unit:g} m"
        )
    return counts.astype(np.uint16)


def write_depth_png(
    path: str | os.PathLike, depth: np.ndarray, depth_unit: float = DEPTH_UNIT
) -> Path:
    """Write depths (H, W) in metres as a 16-bit PNG, atomically; raises as `to_counts`, BadFile."""
    return write_counts_png(path, to_counts(depth, depth_unit, str(path)))


def write_counts_png(path: str | os.PathLike, counts: np.ndarray) -> Path:
    """Write counts (H, W) uint16 as a 16-bit PNG, atomically; raises BadImage, BadFile."""
    return write_atomic(path, encode_png(counts))
