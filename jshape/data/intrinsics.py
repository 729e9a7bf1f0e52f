"""What a device or a bag says of its lens, as a `Camera`."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from jshape.camera import D435_BAZAR, Camera, check_camera
from jshape.errors import LENS_WAY, BadCamera, quoted

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

    `size` (width, height), `focal` (fx, fy), `centre` (u0, v0): pixels; `distortion`: see
    `lens_of`; the bed lies in `z_range`, metres; `where` states them, for errors.

    Raises:
      BadCamera: numbers that make no sense.
    """
    (fx, fy), (u0, v0), (low, high) = ((float(a), float(b)) for a, b in (focal, centre, z_range))
    camera = Camera(int(size[0]), int(size[1]), fx, fy, u0, v0, low, high)
    return check_camera(replace(camera, lens=lens_of(distortion, where)), where)


def lens_of(distortion: Iterable[float], where: str) -> tuple[float, ...] | None:
    """A camera's `lens` of k1, k2, p1, p2, k3, k4, k5, k6; None: its rays are straight.

    So OpenCV orders them, ROS (plumb_bob the first five, rational_polynomial all) and the RealSense
    SDK (Brown-Conrady).

    Raises BadCamera: others than these are not 0 (thin prisms, a tilted sensor).
    """
    coefficients = [float(c) for c in distortion]
    if bent(coefficients[8:]):
        raise BadCamera(
            f"{where}: the lens has {len(coefficients)} coefficients of distortion, "
            f"{quoted(coefficients[8:])} behind the eighth; k1, k2, p1, p2, k3 to k6 are taken: "
            "rectify the frames first"
        )
    if not bent(coefficients):
        return None
    return tuple(coefficients[:8] + [0.0] * (8 - len(coefficients)))


def bent(distortion: Iterable[float]) -> bool:
    """Whether a lens of these coefficients distorts."""
    return any(not abs(float(c)) <= _LEAST_DISTORTION for c in distortion)


def check_straight(camera: Camera, where: str) -> Camera:
    """The camera itself, if its rays are straight.

    Raises BadCamera: its lens bends them, which nothing that takes its images knows of.
    """
    if camera.lens is not None:
        raise BadCamera(f"{where}: the camera's lens distorts; {LENS_WAY}")
    return camera


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
