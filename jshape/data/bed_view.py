"""Where in a frame the bed is, and what to do about a frame that a bank's camera cannot see."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage

from jshape._typing import Float
from jshape.camera import Camera
from jshape.data.missing import median_of
from jshape.data.planes import NEAR, fit_plane, off_plane, tilt_deg_of
from jshape.errors import JShapeError

TILT_MOST_DEG = 2.0
"""Most tilt: across the 190 mm of a grasp's ROI, 2 degrees are 6.6 mm, a quarter of the 25 mm that
it digs; across a box of 0.5 m, 17 mm, a third of the depth range.  The paper's is perpendicular."""
FILLS = 0.95
"""Share of its rectangle that a bed fills; if that is as much of the view, nothing surrounds it."""
MOSTLY = 0.85
"""Share of what is level with the middle that lies in that rectangle: less of a round heap."""
INSET, MIN_SIDE = 2, 16
"""Pixels: left out at the bed's edge, where readings mix; and the smallest bed."""
ROOM = 0.01, 0.03
"""What a depth range leaves nearer and farther than the bed is, metres: for heaps, for strokes."""


class BedView(NamedTuple):
    """Where in a frame the bed is, and how it lies."""

    window: tuple[int, int, int, int] | None
    """(left, top, width, height) that holds only the bed, pixels; None: it fills the view."""
    near: float
    """Depth that a hundredth of its readings is nearer than, metres."""
    far: float
    around: float
    """Median depth of what is beside it, metres; NaN without."""
    tilt_deg: float
    """Of its plane against the image plane."""
    relief: float
    """What is left of its depths without that tilt, metres."""


def bed_of(depth: Float[np.ndarray, "H W"], camera: Camera) -> BedView:
    """The bed of a frame (metres, NaN: no reading): what is level with the middle of the view.

    A table under it, or the floor around a table, lies higher or lower by a step; if what is level
    with the middle fills a rectangle, that is the bed.

    Raises:
      BadImage: fewer than 100 readings.
    """
    off, _ = off_plane(depth, camera, fit_plane(depth, camera))
    with np.errstate(invalid="ignore"):
        level = np.where(np.isnan(off), 0, np.where(np.abs(off) < 1e3 * NEAR, 1, 2 + (off > 0)))
    height, width = depth.shape
    v, u = height * 2 // 5, width * 2 // 5
    middle = np.s_[v : height - v, u : width - u]
    usual = np.bincount(level[middle].ravel(), minlength=4)[1:].argmax() + 1
    parts = np.zeros(depth.shape, np.int32)
    ndimage.label(level == usual, output=parts)
    found = parts[middle][level[middle] == usual]
    window = _filled(parts == np.bincount(found).argmax()) if found.size else None
    left, top, w, h = window or (0, 0, width, height)
    inside, around = depth[top : top + h, left : left + w], depth.copy()
    around[top : top + h, left : left + w] = np.nan
    part = camera.crop(left, top, w, h)
    plane, seen = fit_plane(inside, part), np.isfinite(inside)
    level = 1e-3 * off_plane(inside, part, plane)[0]
    (near, far), (low, high) = (np.percentile(of[seen], (1, 99)) for of in (inside, level))
    return BedView(
        window, float(near), float(far), median_of(around), tilt_deg_of(plane), float(high - low)
    )


def _filled(part: np.ndarray) -> tuple[int, int, int, int] | None:
    """The rectangle (left, top, width, height) that a part fills; None: all, or no rectangle."""
    found = []
    for axis in (0, 1):
        count = part.sum(axis)
        most = np.flatnonzero(count >= 0.8 * np.percentile(count[count > 0], 90))
        found.append((int(most[0]) + INSET, int(most[-1]) + 1 - INSET))
    (left, right), (top, bottom) = found
    if right - left < MIN_SIDE or bottom - top < MIN_SIDE:
        return None
    height, width = part.shape
    share = (right - left) * (bottom - top) / (width * height)
    inside = part[top:bottom, left:right]
    whole = inside.mean() > FILLS and inside.sum() > MOSTLY * part.sum()
    return (left, top, right - left, bottom - top) if whole and share < FILLS else None


def way_out(
    depth: Float[np.ndarray, "H W"],
    camera: Camera,
    target: Camera,
    corner: tuple[int, int] = (0, 0),
    *,
    moved: bool = True,
) -> str | None:
    """Why a frame is not a bed within another camera's range, and what to do, for an error's end.

    Args:
      depth: the frame, metres; NaN: no reading.
      camera: that took it.
      target: of the bank; a bed is moved to the middle of its range, unless not `moved`.
      corner: (left, top) of what is given here in the whole frame, pixels.
      moved: see `target`; None is returned where the view only lies at another distance.
    """
    span = float(target.z_max) - float(target.z_min)
    seen = depth[np.isfinite(depth)]
    if not moved and seen.size and np.ptp(np.percentile(seen, (1, 99))) <= span:
        return None
    try:
        bed = bed_of(depth, camera)
    except JShapeError:  # too few readings, or all in a row
        return "; is all of the picture the bed?"
    if bed.window is not None:
        left, top, width, height = bed.window
        share = width * height / depth.size
        return (
            f"; surroundings: the bed fills {share:.0%} of the view, {bed.near:.3f} to "
            f"{bed.far:.3f} m away, and what is around it is {bed.around:.3f} m away; "
            f"--window {left + corner[0]},{top + corner[1]},{width}x{height} holds only the bed"
        )
    if bed.tilt_deg > TILT_MOST_DEG and bed.relief < bed.far - bed.near:
        return (
            f"; tilt: the bed is tilted by {bed.tilt_deg:.1f} degrees against the image, "
            f"{bed.near:.3f} to {bed.far:.3f} m away; level the camera (at most "
            f"{TILT_MOST_DEG:g} degrees)"
        )
    low, high = bed.near - ROOM[0], bed.far + ROOM[1]
    high_mm = 1e3 * (bed.far - bed.near)
    return (
        f"; range: the bed is {bed.near:.3f} to {bed.far:.3f} m away, {high_mm:.0f} mm of relief, "
        f"and the bank's camera sees {1e3 * span:.0f} mm; --depth-range "
        f"{low:.3f},{high:.3f} plans within that range of your own camera"
    )
