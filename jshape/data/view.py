"""From a raw depth frame of any camera to the weighed image of a bank's camera."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from jshape import camera as cameras
from jshape import metric
from jshape._typing import ArrayLike, Float
from jshape.camera import PAPER_BOX, Camera, check_camera, differing, window_of
from jshape.data.bed_view import way_out
from jshape.data.depth import check_depth, outside_range, to_metres, wrong_shape
from jshape.data.missing import fill_missing, missing
from jshape.errors import BadCamera, BadImage, JShapeError, MissingDepth, quoted

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
        seen, pixel = (
            np.array(x) for x in cameras.reproject(whole, self.source, self.target, self.rise)
        )
        inside = np.isfinite(seen)
        u, v = np.rint(pixel[:, inside]).astype(int)
        height, width = depth.shape
        seen[inside] = np.where(
            gaps[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)], np.nan, seen[inside]
        )
        return seen

    def hint(self, depth: np.ndarray) -> str | None:
        """Why a frame (H, W) in metres is no bed within the target's range: see `way_out`."""
        if self.window is None:
            return way_out(depth, self.source, self.target)
        part = self.depth(depth, "frame")
        return way_out(part, self.target, self.target, self.window, moved=False)

    def shown(self) -> float:
        """Share of the target's pixels that the source's frames show."""
        there = self.pixels(np.indices(self.target.shape).reshape(2, -1).T[:, ::-1])
        inside = (there >= 0) & (there < self.source.shape[::-1])
        return float(inside.all(1).mean())

    def pixels(self, positions: np.ndarray) -> np.ndarray:
        """Where positions (N, 2) of (u, v) in the target's image are in the source's: (N, 2).

        The bed is taken to be in the middle of the target's range.
        """
        if self.window is not None:
            return positions + np.array(self.window)
        z = _middle(self.target)
        (ours, to_ours), (theirs, to_theirs) = (
            (np.array([c.fx, c.fy], float), np.array([c.u0, c.v0], float))
            for c in (self.source, self.target)
        )
        rays = (positions - to_theirs) / theirs * (z / (z - self.rise))
        return np.rint(rays * ours + to_ours).astype(int)


def view_of(
    source: Camera,
    target: Camera,
    first: np.ndarray,
    *,
    reproject: bool = False,
    where: str = "frame",
) -> View:
    """The view from `source` frames to frames of the bank's camera, `target`.

    With `reproject` it may be another camera, or at another distance from the bed: then the middle
    of the bed in the `first` frame, (H, W) metres, goes to the middle of target's range.

    Raises:
      BadCamera: another camera, and `reproject` is False; or a camera that makes no sense.
    """
    check_camera(source)
    window = window_of(target, source)
    if window is not None and not reproject:
        return View(source, target, window)
    if not reproject:
        way = (
            "; with reproject (--reproject) the frames are seen as its camera would see them, and "
            "--window or --depth-range plan on the frames as they are"
        )
        if first.shape == source.shape and _relief(first) > float(target.z_max - target.z_min):
            way = way_out(np.where(missing(first), np.nan, first), source, target) or way
        raise BadCamera(
            f"{where}: the bank is for another camera: {differing(source, target, 'bank')}{way}"
        )
    if first.shape != source.shape:
        raise BadImage(f"a frame has shape {first.shape}; the camera makes {source.shape}")
    bed = middle_depth(first)
    if window is not None and float(target.z_min) <= bed <= float(target.z_max):
        return View(source, target, window)
    return View(source, target, None, _middle(target) - bed)


def view_beside(
    view: View,
    first: np.ndarray,
    camera: Camera,
    frame: np.ndarray,
    *,
    reproject: bool = False,
    where: str = "frame",
) -> View:
    """The view of a second frame: of the same camera, or a part of it, from the same distance.

    Of another camera that is looked at again, the middles of both beds are taken to be equally
    high, since nothing says how the two cameras stood.  Depth ranges may differ.  `view` and
    `first` (what the target sees, metres) are those of the first frame; `camera` took `frame`.

    Raises BadImage and BadCamera as `view_of`.
    """
    source = view.source
    ranged = replace(camera, z_min=source.z_min, z_max=source.z_max)
    if not differing(ranged, source, ""):
        return view
    if view.window is None and (window_of(ranged, source) or window_of(source, ranged)):
        return View(camera, view.target, None, view.rise)
    own = view_of(camera, view.target, frame, reproject=reproject, where=where)
    if own.window is not None and view.window is not None:
        return own
    seen = own.depth(frame, where)
    return View(camera, view.target, None, own.rise + middle_depth(first) - middle_depth(seen))


def middle_depth(frame: np.ndarray) -> float:
    """How far the bed is: the median depth over the middle half of a frame (H, W), metres.

    Raises:
      BadImage: nothing was seen there.
    """
    height, width = frame.shape
    middle = frame[height // 4 : height - height // 4, width // 4 : width - width // 4]
    seen = middle[~missing(middle)]
    if seen.size == 0:
        raise BadImage("no depth reading in the middle of the frame: where is the bed?")
    return float(np.median(seen))


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
    unit = depth_unit if np.asarray(depth).dtype.kind == "u" else None
    whole = metres
    if view is not None:
        metres = view.depth(whole, where)
        if view.window is None:
            nearer = "nearer" if view.rise < 0 else "farther"
            where = f"{where}, seen by the bank's camera from {abs(view.rise):.3f} m {nearer}"
        found = metres[~missing(metres)]
        if found.size and outside_range(found, camera).mean() > MAX_CLAMPED:
            hint = view.hint(whole)
    check_depth(metres, camera, where, unit, least_inside=1 - MAX_CLAMPED, hint=hint)
    try:
        metres, filled = fill_missing(metres, limit=max_missing, where=where)
    except MissingDepth as problem:
        if view is None or view.window is not None or (shown := view.shown()) > 1 - max_missing:
            raise
        height, width = view.source.shape
        raise MissingDepth(
            f"{problem}; the frames show only {shown:.0%} of what the bank's camera would see: "
            f"without --reproject, --window 0,0,{width}x{height} plans on what they show"
        ) from None
    clamped = int(outside_range(metres, camera).sum())
    level = camera.luminance(metres, quantize=False)
    return Seen(np.asarray(metric.weigh(level, camera)), filled, clamped)


def plannable(depth: np.ndarray, camera: Camera, *, own: bool = False) -> str | None:
    """Why `jshape plan` would refuse a frame (metres) with a bundled bank; None: it would not.

    `own`: it is what `--window` holds, which is planned on as it is.
    """
    try:
        target = camera if own else PAPER_BOX
        image_of_depth(
            depth, target, view=view_of(camera, target, depth, reproject=not own), where="the bed"
        )
    except BadImage as problem:
        return f"jshape plan would refuse it: {problem}"
    return None


def _relief(depth: np.ndarray) -> float:
    """Between the nearest and the farthest hundredth of the readings, metres; 0 without any."""
    seen = depth[~missing(depth)]
    return float(np.ptp(np.percentile(seen, (1, 99)))) if seen.size else 0.0


def _middle(camera: Camera) -> float:
    """Depth in the middle of a camera's range, metres."""
    return (float(camera.z_min) + float(camera.z_max)) / 2
