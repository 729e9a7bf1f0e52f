"""From a raw depth frame of any camera to the weighed image of a bank's camera."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from jshape import metric
from jshape._typing import ArrayLike, Bool, Float, Num
from jshape.camera import PAPER_BOX, Camera, check_camera, differing, matrix, window_of
from jshape.data.depth import check_depth, check_shape, outside_range, to_metres
from jshape.data.fusion import Look, seen_from
from jshape.data.looks import camera_over, plane_frame
from jshape.data.missing import fill_missing, missing
from jshape.errors import BadCamera, BadImage, JShapeError, MissingDepth, quoted
from jshape.height_map import ABOVE, as_frame, looking_down
from jshape.reproject import between

_ABOVE_HINT = (
    "; --window or --depth-range says which part of the frames is the bed, and a bank that works "
    "in metres (pressed-flour-robot) sees any relief"
)
MAX_CLAMPED = 0.1
"""Largest share of a frame's readings that may lie beyond the camera's depth range."""
LEAST_SEEN = 0.2
"""Least share of what a camera above the bed would see that must be known."""


@dataclass(frozen=True)
class View:
    """How the frames of one camera become those of another: cut a window out, or look again."""

    source: Camera
    """The camera that takes the frames."""
    target: Camera
    """The one that a bank or a map is for."""
    window: tuple[int, int] | None = None
    """(left, top) of the target's image in the source's; None: it looks again, from its pose."""

    @property
    def above(self) -> bool:
        """Whether the target looks at the bed from above, where parts of it may be hidden."""
        return self.window is None or self.target.orthographic

    @property
    def to_source(self) -> Float[np.ndarray, "4 4"]:
        """The transform from the target's frame to the source's, metres."""
        return np.eye(4) if self.window is not None else between(self.source, self.target)

    def depth(
        self, depth: np.ndarray, where: str, others: Sequence[Look] = ()
    ) -> Float[np.ndarray, "h w"]:
        """A frame (H, W) in metres as the target would see it; NaN where it has no reading.

        Looks of `others`, whose poses are in one frame with the source's, add what they see.

        Raises:
          BadImage: another size than the source's, or no reading at all.
          BadCamera: looks that do not agree, or a target that only cuts a window out of one.
        """
        check_shape(depth, self.source, where)
        if self.window is None:
            return seen_from([look_of(depth, self.source), *others], self.target, where)
        if others:
            raise BadCamera(f"{where}: several cameras see a bed from above, not as one of them")
        left, top = self.window
        return depth[top : top + self.target.height, left : left + self.target.width]

    def pixels(
        self, positions: np.ndarray, depth: ArrayLike | None = None
    ) -> Num[np.ndarray, "N 2"]:
        """Where positions (N, 2) of (u, v) in the target's image are in the source's, whole pixels.

        `depth` (N,) is the surface's there, metres; None: the middle of the target's range.
        """
        if self.window is not None:
            return positions + np.array(self.window)
        z = middle_of(self.target) if depth is None else np.asarray(depth)
        u, v = np.asarray(positions, float).T
        x, y = self.target.at(u, v, z)
        points = np.stack(np.broadcast_arrays(x, y, z, 1.0), -1) @ self.to_source.T
        return np.rint(np.stack(self.source.pixel(*points[:, :3].T), -1)).astype(int)

    def drawing(
        self, drawn: np.ndarray, depth: np.ndarray | None = None
    ) -> Float[np.ndarray, "h w"]:
        """A drawing on the source's image (H, W) as it lies at the target's depth; NaN: beside."""
        v, u = (at.reshape(-1) for at in np.indices(self.target.shape))
        at = self.pixels(np.stack([u, v], 1), None if depth is None else depth.reshape(-1))
        rows, columns = drawn.shape
        inside = np.all((at >= 0) & (at < np.array([columns, rows])), axis=1)
        at = np.where(inside[:, None], at, 0)
        found = np.where(inside, drawn[at[:, 1], at[:, 0]].astype(float), np.nan)
        return found.reshape(self.target.shape).astype(np.float32)

    def positions(self, pixels: np.ndarray, depth: ArrayLike) -> Float[np.ndarray, "N 2"]:
        """Where pixels (N, 2) of the source are in the target's image, not rounded.

        `depth` is the surface's there, metres from the source.
        """
        u, v = np.asarray(pixels, float).T
        x, y = self.source.at(u, v, depth)
        points = np.stack(np.broadcast_arrays(x, y, depth, 1.0), -1)
        points = points @ np.linalg.inv(self.to_source).T
        return np.stack(self.target.pixel(*points[:, :3].T), -1)


def look_of(depth: np.ndarray, camera: Camera) -> Look:
    """A frame (H, W) in metres as a look of its camera."""
    seen = np.where(missing(depth), np.nan, depth).astype(np.float32)
    return Look(seen, camera)


def tilt_deg(depth: np.ndarray, camera: Camera) -> float:
    """Angle of the bed's plane against the image, degrees; 0 where none is found."""
    try:
        frame = plane_frame(look_of(depth, camera))
    except BadImage:
        return 0.0
    axis = matrix(camera.pose)
    return math.degrees(math.acos(min(1.0, abs(float(axis[:3, 2] @ frame[:3, 2])))))


def cut_of(source: Camera, target: Camera) -> tuple[int, int]:
    """(left, top) of a bank's image in the frames of a camera.

    Raises BadCamera: they do not hold it.
    """
    check_camera(source)
    at = window_of(target, source)
    if at is None:
        raise BadCamera(f"the bank is for another camera: {differing(source, target, 'bank')}")
    return at


def cut_out(source: Camera, target: Camera, frame: np.ndarray) -> View | None:
    """The view that cuts a bank's image out of the frames, if it is in them and in its range."""
    at = window_of(target, source)
    if at is None or frame.shape != source.shape:
        return None
    view = View(source, target, at)
    seen = view.depth(frame, "frame")
    seen = seen[~missing(seen)]
    return view if seen.size and outside_range(seen, target).mean() <= MAX_CLAMPED else None


def view_above(
    source: Camera,
    frame: np.ndarray,
    target: Camera | None = None,
    where: str = "frame",
    others: Sequence[Look] = (),
) -> View:
    """The view from straight above a bed that a camera sees from anywhere.

    Args:
      source: the camera.
      frame: (H, W) metres that it took; the bed's plane is found in it.
      target: to look through, at the middle of its range over the bed; None: parallel rays, one
        pixel of the source a pixel, as far as the bed reaches.
      where: what to call the frame in errors.
      others: looks of more cameras, whose bed parallel rays reach too.

    Raises:
      BadCamera: a camera that makes no sense.
      BadImage: another size than the camera's, or no bed in it.
    """
    check_camera(source, where)
    check_shape(frame, source, where)
    look = look_of(frame, source)
    if target is None:
        whole, _ = camera_over([look, *others], where=where)
        return View(source, whole)
    above = plane_frame(look, where) @ looking_down(middle_of(target))
    return View(source, replace(target, pose=as_frame(above)))


def view_like(view: View, source: Camera, frame: np.ndarray, where: str = "frame") -> View:
    """The view of a second frame, of another camera, onto the same target.

    Unless both cameras have a pose, the planes of both beds are taken to be the same one, since
    nothing says how the cameras stood.

    Raises BadCamera, BadImage: as `view_above`.
    """
    check_camera(source, where)
    check_shape(frame, source, where)
    cut = window_of(view.target, source)
    if view.window is not None and cut is not None:
        return View(source, view.target, cut)
    if view.window is None and (
        _same_place(view.source, source) or None not in (view.source.pose, source.pose)
    ):
        return View(source, view.target)
    distance = ABOVE if view.target.orthographic else middle_of(view.target)
    above = plane_frame(look_of(frame, source), where) @ looking_down(distance)
    return View(source, replace(view.target, pose=as_frame(above)))


def _same_place(one: Camera, other: Camera) -> bool:
    """Whether one is the other, or a part of its image, whatever their ranges are."""
    ranged = replace(other, z_min=one.z_min, z_max=one.z_max)
    return bool(window_of(ranged, one) or window_of(one, ranged))


def middle_of(camera: Camera) -> float:
    """Depth in the middle of a camera's range, metres."""
    return (float(camera.z_min) + float(camera.z_max)) / 2


class Seen(NamedTuple):
    """A weighed image made from a raw depth frame."""

    image: np.ndarray
    """(H, W) I of the bank's camera."""
    filled: int
    """Pixels without a reading."""
    clamped: int
    """Pixels beyond the camera's depth range, taken for its end."""
    known: Bool[np.ndarray, "H W"]
    """Which pixels have a reading."""


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

    What a camera above the bed looks at again may be hidden in any part, up to 1 - `LEAST_SEEN`.

    Raises:
      MissingDepth: too many pixels without a reading.
      BadImage: wrong shape or type, or more than `MAX_CLAMPED` beyond the camera's depth range.
      JShapeError: a share that is none.
    """
    if not (np.ndim(max_missing) == 0 and 0 <= max_missing <= 1):
        raise JShapeError(f"max_missing is {quoted(max_missing)}; it must be a share from 0 to 1")
    metres = to_metres(depth, depth_unit, where)
    unit = depth_unit if np.asarray(depth).dtype.kind == "u" else None
    if view is not None:
        metres = view.depth(metres, where)
    hint = _ABOVE_HINT if view is not None and view.window is None else None
    check_depth(metres, camera, where, unit, least_inside=1 - MAX_CLAMPED, hint=hint)
    known = ~missing(metres)
    if above(camera) or (view is not None and view.above):
        if known.mean() < LEAST_SEEN:
            raise MissingDepth(
                f"{where}: {known.mean():.1%} of the bed is seen; at least {LEAST_SEEN:.0%} must be"
                "; do camera and goal lie in one frame?"
            )
        max_missing = 1.0
    metres, filled = fill_missing(metres, limit=max_missing, where=where)
    clamped = int(outside_range(metres, camera).sum())
    level = camera.luminance(metres, quantize=False)
    return Seen(np.asarray(metric.weigh(level, camera)), filled, clamped, known)


def known_in_both(
    now: Bool[np.ndarray, "H W"], wanted: Bool[np.ndarray, "H W"], *names: str
) -> Bool[np.ndarray, "H W"]:
    """What is known of the bed now and of the one wanted: all that a distance counts.

    Raises BadImage: less than `LEAST_SEEN`; the `names` are of the two.
    """
    both = now & wanted
    if (share := float(both.mean())) < LEAST_SEEN:
        raise BadImage(
            f"{' and '.join(names)}: {share:.1%} of the bed is known in both; at least "
            f"{LEAST_SEEN:.0%} is needed"
        )
    return both


def above(camera: Camera) -> bool:
    """Whether a bank's camera is one that was put above a bed: only those have a pose."""
    return camera.orthographic or camera.pose is not None


def plannable(depth: np.ndarray, camera: Camera) -> str | None:
    """Why `jshape plan` would refuse a frame (metres) with a bundled bank; None: it would not."""
    try:
        view = cut_out(camera, PAPER_BOX, depth) or view_above(camera, depth)
        image_of_depth(depth, view.target, view=view, where="the bed")
    except JShapeError as problem:
        return f"jshape plan would refuse it: {problem}"
    return None
