"""From a raw depth frame of any camera to the weighed image of a bank's camera."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jshape import camera as cameras
from jshape import metric
from jshape._typing import ArrayLike, Float
from jshape.camera import GEOMETRY, Camera, check_camera, window_of
from jshape.data.depth import check_depth, outside_range, to_metres, wrong_shape
from jshape.data.missing import fill_missing, missing
from jshape.errors import BadCamera, BadImage, JShapeError, quoted

MAX_CLAMPED = 0.1
"""Largest share of a frame's readings that may lie beyond the camera's depth range."""


@dataclass(frozen=True)
class View:
    """How the frames of one camera become those of another: cut a window out, or look again."""

    source: Camera
    """The camera that takes the frames."""
    target: Camera
    """The bank's camera."""
    window: tuple[int, int] | None
    """(left, top) of the target's image in the source's; None: it is no window of it."""
    rise: float = 0.0
    """How much farther the target stands from the bed, metres."""

    def depth(self, depth: np.ndarray, where: str) -> Float[np.ndarray, "h w"]:
        """A frame (H, W) in metres as the target would see it; NaN where it has no reading.

        Raises:
          BadImage: another size than the source's, or no reading at all.
        """
        if depth.shape != self.source.shape:
            raise BadImage(wrong_shape(where, depth.shape, self.source))
        if self.window is not None:
            left, top = self.window
            return depth[top : top + self.target.height, left : left + self.target.width]
        # Gaps are bridged before looking again, since a NaN would spread, and cut out again after.
        gaps = missing(depth)
        whole, _ = fill_missing(depth, limit=1.0, where=where)
        seen, place = (
            np.array(x) for x in cameras.reproject(whole, self.source, self.target, self.rise)
        )
        inside = np.isfinite(seen)
        v, u = np.rint(place[:, inside]).astype(int)
        height, width = depth.shape
        seen[inside] = np.where(
            gaps[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)], np.nan, seen[inside]
        )
        return seen

    def pixels(self, positions: np.ndarray) -> np.ndarray:
        """Where positions (N, 2) of (u, v) in the target's image are in the source's: (N, 2).

        The bed is taken to be in the middle of the target's range.
        """
        if self.window is not None:
            return positions + np.array(self.window)
        source, target = self.source, self.target
        z = _middle(target)
        shrink = z / (z - self.rise)
        u = (positions[:, 0] - float(target.u0)) / float(target.fx) * shrink
        v = (positions[:, 1] - float(target.v0)) / float(target.fy) * shrink
        both = (u * float(source.fx) + float(source.u0), v * float(source.fy) + float(source.v0))
        return np.rint(np.stack(both, -1)).astype(int)


def view_of(source: Camera, target: Camera, first: np.ndarray, *, reproject: bool = False) -> View:
    """The view from `source` frames to `target` frames.

    Args:
      source: the camera that took the frames.
      target: the bank's camera.
      first: (H, W) metres, a frame: the middle of its bed goes to the middle of target's range.
      reproject: allow another camera than the bank's, or another distance from the bed.

    Raises:
      BadCamera: another camera, and `reproject` is False; or a camera that makes no sense.
    """
    check_camera(source)
    window = window_of(target, source)
    if window is not None and not reproject:
        return View(source, target, window)
    if not reproject:
        numbers = [(n, float(getattr(source, n)), float(getattr(target, n))) for n in GEOMETRY]
        differ = ", ".join(f"{n} {a:g} (bank: {b:g})" for n, a, b in numbers if a != b)
        raise BadCamera(
            f"the bank is for another camera: {differ}; with reproject (--reproject) the frames "
            "are seen as its camera would see them"
        )
    if first.shape != source.shape:
        raise BadImage(f"a frame has shape {first.shape}; the camera makes {source.shape}")
    height, width = source.shape
    middle = first[height // 4 : height - height // 4, width // 4 : width - width // 4]
    seen = middle[~missing(middle)]
    if seen.size == 0:
        raise BadImage("no depth reading in the middle of the frame: where is the bed?")
    bed = float(np.median(seen))
    if window is not None and float(target.z_min) <= bed <= float(target.z_max):
        return View(source, target, window)
    return View(source, target, None, _middle(target) - bed)


class Seen(NamedTuple):
    """A weighed image made from a raw depth frame."""

    image: np.ndarray
    """(H, W) I of the bank's camera."""
    filled: int
    """Pixels without a reading."""
    clamped: int
    """Pixels beyond the camera's depth range, taken for its end."""


def image_of_depth(
    depth: ArrayLike,
    camera: Camera,
    *,
    view: View | None = None,
    depth_unit: float = 0.001,
    max_missing: float = 0.1,
    where: str = "depth",
) -> Seen:
    """The weighed image I of a raw depth frame: viewed, checked, filled, not rounded to levels.

    Raises:
      MissingDepth: too many pixels without a reading.
      BadImage: wrong shape or type, or more than `MAX_CLAMPED` beyond the camera's depth range.
      JShapeError: a share that is none.
    """
    if not (np.ndim(max_missing) == 0 and 0 <= max_missing <= 1):
        raise JShapeError(f"max_missing is {quoted(max_missing)}; it must be a share from 0 to 1")
    metres, hint = to_metres(depth, depth_unit, where), None
    if view is not None:
        metres = view.depth(metres, where)
        if view.window is None:
            nearer = "nearer" if view.rise < 0 else "farther"
            where = f"{where}, seen by the bank's camera from {abs(view.rise):.3f} m {nearer}"
            hint = "; is all of the picture the bed, and is its relief within that range?"
    check_depth(metres, camera, where, least_inside=1 - MAX_CLAMPED, hint=hint)
    metres, filled = fill_missing(metres, limit=max_missing, where=where)
    clamped = int(outside_range(metres, camera).sum())
    level = camera.luminance(metres, quantize=False)
    return Seen(np.asarray(metric.weigh(level, camera)), filled, clamped)


def _middle(camera: Camera) -> float:
    """Depth in the middle of a camera's range, metres."""
    return (float(camera.z_min) + float(camera.z_max)) / 2
