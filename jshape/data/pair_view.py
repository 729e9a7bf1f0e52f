"""Frames of cameras that do not look straight down as pairs: seen from above, as banks learn.

What a camera straight above records stays as it is, to the bit.  Frames are (H, W), `[v, u]`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jshape.camera import Camera
from jshape.data.depth import outside_range, to_metres
from jshape.data.fusion import Look
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


@dataclass(frozen=True)
class PairView:
    """How the frames of a camera, or of several at once, become those of a data set."""

    sources: Sequence[tuple[Camera, float]]
    """The cameras, and metres per count of their frames."""
    view: View | None = None
    """None: they stay as they are."""
    depth_unit: float = 0.0
    """Metres per count of the data set's frames."""
    why: str = ""
    """In words, why they do not."""

    @property
    def camera(self) -> Camera:
        """The data set's."""
        return self.sources[0][0] if self.view is None else self.view.target

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

    def counts(self, frames: Sequence[np.ndarray], where: str) -> np.ndarray:
        """Frames (H, W) uint16, one of each camera, as the data set's camera sees the bed.

        Where several see it, by the noise of each; 0 where none does.

        Raises:
          BadImage: nothing of the bed is in them.
          BadCamera: they do not agree.
        """
        if self.view is None:
            return frames[0]
        first, *others = _looks(self.sources, frames, where)
        return counts_of(self.view.depth(first.depth, where, others), self.depth_unit)


def _looks(
    sources: Sequence[tuple[Camera, float]], frames: Sequence[np.ndarray], where: str
) -> list[Look]:
    depths = [to_metres(f, unit, where) for f, (_, unit) in zip(frames, sources, strict=True)]
    return [look_of(depth, camera) for depth, (camera, _) in zip(depths, sources, strict=True)]


def pair_view(
    sources: Sequence[tuple[Camera, float]],
    frames: Sequence[np.ndarray],
    where: str,
    like: tuple[Camera, float] | None = None,
) -> PairView:
    """The view of frames that pairs are made of.

    Args:
      sources: the cameras, several each with a pose, and metres per count of their frames.
      frames: the bed at rest, (H, W) counts of each: its plane is found in the first.
      where: what to call it in errors.
      like: camera and depth unit of a data set that the new one is to be merged with.

    Raises:
      BadImage: no bed is found, by a camera that does not see it from above or in its range.
    """
    (depth, camera), *others = _looks(sources, frames, where)
    if like is not None and like != sources[0]:
        view = view_like(View(like[0], like[0]), camera, depth, where)
        return PairView(sources, view, like[1], "as in the other data set")
    why = f"by {len(sources)} cameras" if others else not_from_above(camera, depth)
    if not why:
        return PairView(sources, None, sources[0][1])
    view = view_above(camera, depth, where=where, others=others)
    return PairView(sources, view, min(FINEST, *(unit for _, unit in sources)), why)


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
