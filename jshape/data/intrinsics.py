"""What a device or a bag says of its lens, as a `Camera`."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from jshape.camera import D435_BAZAR, Camera, check_camera
from jshape.errors import BadCamera

Z_RANGE = (float(D435_BAZAR.z_min), float(D435_BAZAR.z_max))
"""Depth range that no device knows, since it is the bed's: the paper's, metres."""
FLOAT_UNIT = 1e-4
"""Metres per count that frames in metres get: finer than the noise, and 16 bits reach 6.5 m."""
REACH = (0.05, 65535 * FLOAT_UNIT)
"""Metres: nearer no depth camera sees, farther no count reaches."""

_LEAST_DISTORTION = 1e-6


def pinhole(
    where: str,
    size: tuple[int, int],
    focal: tuple[float, float],
    centre: tuple[float, float],
    distortion: Iterable[float] = (),
    z_range: tuple[float, float] = Z_RANGE,
) -> Camera:
    """The camera of intrinsics that somebody else states.

    `size` (width, height), `focal` (fx, fy), `centre` (u0, v0): pixels; `distortion` of a model in
    which all 0 is none; the bed lies in `z_range`, metres; `where` states them, for errors.

    Raises:
      BadCamera: numbers that make no sense, or a lens that distorts: frames of such a one must be
        rectified first, since everything here takes straight rays.
    """
    coefficients = [float(c) for c in distortion]
    if bent(coefficients):
        shown = ", ".join(f"{c:g}" for c in coefficients[:5])
        raise BadCamera(
            f"{where}: the lens distorts (coefficients {shown}); rectify the frames first"
        )
    (fx, fy), (u0, v0), (low, high) = ((float(a), float(b)) for a, b in (focal, centre, z_range))
    return check_camera(Camera(int(size[0]), int(size[1]), fx, fy, u0, v0, low, high), where)


def bent(distortion: Iterable[float]) -> bool:
    """Whether a lens of these coefficients distorts."""
    return any(not abs(float(c)) <= _LEAST_DISTORTION for c in distortion)


def same_frames(given: Camera, stated: tuple[int, int], where: str) -> Camera:
    """A camera given for frames of another source, if they are of its size, else BadCamera."""
    if (given.width, given.height) != tuple(stated):
        raise BadCamera(
            f"{where}: has {stated[0]}x{stated[1]} pixels; the camera given for it makes "
            f"{given.width}x{given.height}"
        )
    return given


def within(camera: Camera, z_range: tuple[float, float] | None) -> Camera:
    """The camera with another depth range, metres; None: as it is.  BadCamera: it does not rise."""
    if z_range is None:
        return camera
    low, high = (float(z) for z in z_range)
    return check_camera(replace(camera, z_min=low, z_max=high), "depth range")


def counts_of(metres: np.ndarray, unit: float = FLOAT_UNIT) -> np.ndarray:
    """Counts (H, W) uint16 of depths in metres; what is no depth, or beyond 16 bits, becomes 0."""
    with np.errstate(invalid="ignore", over="ignore"):
        counts = np.rint(np.asarray(metres, np.float64) / unit)
        good = np.isfinite(counts) & (counts > 0) & (counts < 65535)
    return np.where(good, counts, 0.0).astype(np.uint16)
