"""Frames of a camera that does not look straight down as pairs: seen from above, as banks learn.

What a camera straight above records stays as it is, to the bit.  Frames are (H, W), `[v, u]`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jshape.camera import Camera
from jshape.data.depth import outside_range, to_metres
from jshape.data.fusion import APART
from jshape.data.intrinsics import counts_of
from jshape.data.looks import bed_of
from jshape.data.view import (
    MAX_CLAMPED,
    View,
    look_of,
    middle_of,
    tilt_deg,
    view_above,
    view_like,
)

LEVEL_DEG = 5.0
"""Tilt from which a bed is looked at from above.  Hills of 8 mm alone tilt the plane that is found
by up to 2.1 degrees, and what a straight camera sees must not be resampled because of them."""
FINEST = 1e-4
"""Most metres per count of frames that were looked at from above: means of millimetres are finer,
and so is what lies between pixels."""
TURNED_DEG = 1.0
"""A camera that turned by more sees the bed aslant from there on: 7 mm across 400 mm."""

LEAST = 50
"""Readings of both frames that tell whether a camera moved."""


@dataclass(frozen=True)
class PairView:
    """How the frames of a camera become those of a data set."""

    source: Camera
    unit: float
    """Metres per count of its frames."""
    view: View | None = None
    """None: they stay as they are."""
    depth_unit: float = 0.0
    """Metres per count of the data set's frames."""
    why: str = ""
    """In words, why they do not."""

    @property
    def camera(self) -> Camera:
        """The data set's."""
        return self.source if self.view is None else self.view.target

    @property
    def said(self) -> str:
        """What it does, for people; empty where frames stay as they are."""
        if self.view is None:
            return ""
        camera = self.camera
        z = middle_of(camera)
        return (
            f"looked at from above ({self.why}): {camera.width}x{camera.height} pixels of "
            f"{1e3 / float(camera.scale(z)[0]):.2f} mm"
        )

    def counts(self, counts: np.ndarray, where: str) -> np.ndarray:
        """A frame (H, W) uint16 as the data set's camera sees it; 0 where nothing is known.

        Raises BadImage: nothing of the bed is in it.
        """
        if self.view is None:
            return counts
        depth = self.view.depth(to_metres(counts, self.unit, where), where)
        return counts_of(depth, self.depth_unit)


def pair_view(
    camera: Camera,
    unit: float,
    first: np.ndarray,
    where: str,
    like: tuple[Camera, float] | None = None,
) -> PairView:
    """The view of frames that pairs are made of.

    Args:
      camera: that took them.
      unit: metres per count.
      first: the bed at rest, (H, W) counts: its plane is found in it.
      where: what to call it in errors.
      like: camera and depth unit of a data set that the new one is to be merged with.

    Raises:
      BadImage: no bed is found, by a camera that does not see it from above or in its range.
    """
    depth = to_metres(first, unit, where)
    if like is not None and like != (camera, unit):
        target, theirs = like
        return PairView(camera, unit, view_like(View(target, target), camera, depth, where), theirs,
                        "as in the other data set")  # fmt: skip
    why = not_from_above(camera, depth)
    if not why:
        return PairView(camera, unit, None, unit)
    view = view_above(camera, depth, where=where)
    return PairView(camera, unit, view, min(unit, FINEST), why)


def not_from_above(camera: Camera, depth: np.ndarray) -> str:
    """Why pairs of a camera's frames (metres) are not learned from as they are; empty: they are."""
    if camera.orthographic:
        return ""
    if camera.lens is not None:
        return "the lens distorts"
    tilt = tilt_deg(depth, camera)
    if tilt > LEVEL_DEG:
        return f"the bed is seen at {tilt:.0f} degrees"
    bed, _ = bed_of(look_of(depth, camera))
    beyond = outside_range(bed[np.isfinite(bed)], camera)
    share = float(beyond.mean()) if beyond.size else 0.0
    # All of it beyond the range is the floor around the bed.
    if MAX_CLAMPED < share < 0.5:
        low, high = float(camera.z_min), float(camera.z_max)
        return f"{share:.0%} of the bed lie beyond {low:g} to {high:g} m"
    return ""


class Displaced(NamedTuple):
    """How a bed lies elsewhere as a whole than before."""

    off_mm: float
    """In the median, along the camera's axis."""
    turned_deg: float

    def said(self, before: str) -> str:
        """In words, for people."""
        return (
            f"the bed lies {self.off_mm:.1f} mm from where it lay in {before}, turned by "
            f"{self.turned_deg:.1f} degrees"
        )


def moved(first: np.ndarray, later: np.ndarray, camera: Camera, step: int = 1) -> Displaced | None:
    """Whether all of a bed lies elsewhere in a later frame (h, w; metres, NaN: none) than before.

    A pixel of both is `step` of the camera's each way.

    Molding lowers some of it and raises some, a hand hides some; a camera that moves changes 1/z
    by a linear function of the ray.  None: by neither `APART` nor `TURNED_DEG`, or otherwise.
    """
    both = np.isfinite(first) & np.isfinite(later)
    if both.sum() < LEAST:
        return None
    v, u = (step * at + (step - 1) / 2 for at in np.nonzero(both))
    x, y = camera.at(u, v, 1.0)
    terms = np.stack([x, y, np.ones_like(x)], 1).astype(float)
    one, other = 1.0 / first[both].astype(float), 1.0 / later[both].astype(float)
    change, left = _linear(terms, other - one)
    off = float(np.median(np.abs(1.0 / other - 1.0 / one)))
    if np.median(left / one**2) > off / 3:
        return None
    before, _ = _linear(terms, one)
    normals = [plane / np.linalg.norm(plane) for plane in (before, before + change)]
    turned = float(np.degrees(np.arccos(np.clip(normals[0] @ normals[1], -1.0, 1.0))))
    return Displaced(1e3 * off, turned) if off > APART or turned > TURNED_DEG else None


def _linear(terms: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors (3,) of terms (n, 3) from which values (n,) are least off, summed; and by how much.

    Not in the sum of squares: a hand does not pull.
    """
    weight = np.ones(len(values))
    for _ in range(20):
        weighed = weight[:, None] * terms
        found = np.linalg.solve(weighed.T @ terms, weighed.T @ values)
        off = np.abs(values - terms @ found)
        weight = 1.0 / np.maximum(off, 0.1 * np.median(off) + 1e-12)
    return found, off
