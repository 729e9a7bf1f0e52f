"""What depth cameras that stand anywhere saw of a bed, as one other camera would have seen it.

And what each of them gave to a height map: where it stands, how much it sees, how it errs.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jshape._typing import Float
from jshape.camera import Camera, matrix
from jshape.errors import BadCamera, BadImage
from jshape.height_map import HeightMap
from jshape.reproject import between, reproject

RELIEF = 0.25
"""What is farther from the bed's plane, metres, is none of it: floor, arm, walls."""
GAP_MM = 6.0
"""Gaps narrower than this are filled: a pixel or two without a reading, or an edge."""
NOISE = 2.2e-3
"""Noise of a look, metres per square metre of depth, seen from straight above: a D435's is 0.45 mm
at 0.45 m."""
APART = 5e-3
"""Metres by which two looks at one bed may differ in the median: more is a wrong pose."""
POINTS = 20_000
"""Pixels that the plane and the extent are taken from."""
BLOCK = 32
"""Images are reprojected in multiples of so many pixels: beds of about one size compile once."""


class Look(NamedTuple):
    """What one camera saw, and from where."""

    depth: Float[np.ndarray, "H W"]
    """Metres, NaN where there is no reading: the mean over its frames."""
    camera: Camera

    @property
    def to_common(self) -> Float[np.ndarray, "4 4"]:
        """From the camera's frame to the one that all share."""
        return matrix(self.camera.pose)


def check_poses(cameras: Sequence[Camera], names: Sequence[str]) -> None:
    """Refuse several cameras of which one, called by its name, has no pose, or another's.

    Raises BadCamera: there is one.
    """
    for k, (camera, name) in enumerate(zip(cameras, names, strict=True)):
        if len(cameras) > 1 and camera.pose is None:
            raise BadCamera(
                f"{name}: has no pose; several cameras need one each, in one frame, best the arm's "
                "base (jshape calibrate finds it, jshape setup --base keeps it)"
            )
        poses = [other.pose for other in cameras[:k]]
        if camera.pose in poses:
            raise BadCamera(
                f"{name}: camera {k + 1} has the same pose as camera {poses.index(camera.pose) + 1}"
                "; each needs its own"
            )


def some_of(look: Look) -> tuple[np.ndarray, Camera]:
    """About `POINTS` pixels of a look, and the camera that has only those."""
    step, camera = max(1, int(np.sqrt(look.depth.size / POINTS))), look.camera
    size = {name: -(-getattr(camera, name) // step) for name in ("width", "height")}
    optics = {name: getattr(camera, name) / step for name in ("fx", "fy", "u0", "v0")}
    return look.depth[::step, ::step], replace(camera, **size, **optics)


def points_of(
    look: Look, depth: np.ndarray, camera: Camera, to: np.ndarray
) -> Float[np.ndarray, "P 3"]:
    """Points of a look, metres, in the frame that (4, 4) `to` leads to from the common one."""
    x, y = (np.broadcast_to(a, depth.shape) for a in camera.rays())
    there = np.isfinite(depth)
    z = depth[there].astype(float)
    x, y = x[there] * z, y[there] * z
    # Row by row: for such slim matrices the threads of a BLAS cost more than they save.
    return np.stack([r[0] * x + r[1] * y + r[2] * z + r[3] for r in (to @ look.to_common)[:3]], -1)


def seen_from(
    looks: Sequence[Look],
    target: Camera,
    where: str = "depth",
    each: Sequence[np.ndarray] | None = None,
) -> Float[np.ndarray, "h w"]:
    """What a camera would see of the bed that others see: metres, NaN where none of them does.

    `each` is what `reprojected` gave of every look, if it was asked already.

    Raises:
      BadImage: nothing of it.
      BadCamera: looks that do not agree.
    """
    each = [reprojected(look, target) for look in looks] if each is None else each
    seen = _mean_of(looks, each, target, where)
    middle = (float(target.z_min) + float(target.z_max)) / 2
    found = _without_gaps(seen, float(target.scale(middle)[0]))
    if not np.isfinite(found).any():
        raise BadImage(f"{where}: the camera sees nothing of the bed that is looked for")
    return found


def reprojected(look: Look, target: Camera) -> Float[np.ndarray, "h w"]:
    """What the target would see of one look; NaN where the look does not show it."""
    z = points_of(look, *some_of(look), np.linalg.inv(matrix(target.pose)))[:, 2]
    middle = (float(target.z_min) + float(target.z_max)) / 2
    z = z[np.abs(z - middle) < RELIEF]
    if not z.size:
        return np.full(target.shape, np.float32(np.nan))
    near, far = np.percentile(z, (0.05, 99.95))
    room = max(5e-3, 0.1 * (far - near))
    span = np.array([near - room, far + room], np.float32)
    size = {name: -(-getattr(target, name) // BLOCK) * BLOCK for name in ("width", "height")}
    seen = reproject(look.depth, look.camera, replace(target, **size), span)
    return np.asarray(seen)[: target.height, : target.width].copy()


def noise_of(look: Look, target: Camera, depth: np.ndarray) -> Float[np.ndarray, "h w"]:
    """Standard deviation of the target's depths (metres) that a look gave, metres.

    It grows with the square of the depth, as a stereo camera's does, and as the bed is seen
    flatter: by 1 / cos of the angle between the look's ray and the target's axis.
    """
    to_look = between(look.camera, target)
    centre = np.linalg.inv(to_look)[:3, 3]
    x, y = target.rays(depth)
    own = to_look[2, 0] * x + to_look[2, 1] * y + to_look[2, 2] * depth + to_look[2, 3]
    away = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (depth - centre[2]) ** 2)
    return (NOISE * own**2 * away / np.maximum(np.abs(depth - centre[2]), 1e-3)).astype(np.float32)


def _mean_of(
    looks: Sequence[Look], seen: Sequence[np.ndarray], target: Camera, where: str
) -> Float[np.ndarray, "h w"]:
    """One image of several: each pixel the mean, weighted by 1 / noise^2.

    Where looks disagree by more than `APART`, as at edges, the least noisy one holds.

    Raises BadCamera: two of them do not agree on most of what both see.
    """
    if len(seen) == 1:
        return seen[0]
    for k, one in enumerate(seen[1:], 2):
        both = np.isfinite(seen[0]) & np.isfinite(one)
        gap = float(np.median(np.abs(seen[0] - one)[both])) if both.any() else np.nan
        if not gap <= APART:
            said = "see nothing in common" if np.isnan(gap) else f"differ by {1e3 * gap:.1f} mm"
            raise BadCamera(
                f"{where}: cameras 1 and {k} {said} (median, at most {1e3 * APART:g} mm); is the "
                "pose of one wrong, or did it move?"
            )
    depths = np.stack(seen)
    there, whole = np.isfinite(depths), np.nan_to_num(depths)
    noise = np.stack([noise_of(look, target, d) for look, d in zip(looks, whole, strict=True)])
    noise = np.where(there, noise, np.inf)
    best = np.take_along_axis(depths, noise.argmin(0)[None], 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = np.where(np.abs(depths - best) <= APART, noise**-2.0, 0.0)
        return ((weight * whole).sum(0) / weight.sum(0)).astype(np.float32)


def _without_gaps(depth: np.ndarray, per_metre: float) -> np.ndarray:
    """An image with its narrow gaps filled; what is wide, or lies at the edge, stays NaN."""
    known = np.isfinite(depth)
    if known.all() or not known.any():
        return depth
    import cv2  # not above: a plan on images needs none

    side = 2 * max(1, round(1e-3 * GAP_MM * per_metre / 2)) + 1
    # A closing by a square: what it covers is narrower than the square.
    square, beyond = np.ones((side, side), np.uint8), {"borderType": 0, "borderValue": (0,)}
    closed = cv2.morphologyEx(known.view(np.uint8), cv2.MORPH_CLOSE, square, **beyond)
    rows, columns = np.divmod(np.flatnonzero(closed > known), depth.shape[1])
    whole = np.pad(depth, 1, constant_values=np.nan)
    flat, wide = whole.reshape(-1), whole.shape[1]
    here = (rows + 1) * wide + columns + 1
    beside = here + np.array([[1], [-1], [wide], [-wide]])
    for _ in range(4 * side):  # the mean of the neighbours: Laplace's equation
        around = flat[beside]
        there = np.isfinite(around)
        total, count = np.where(there, around, 0).sum(0), there.sum(0)
        flat[here] = np.where(count > 0, total / np.maximum(count, 1), np.nan)  # known a step later
    return whole[1:-1, 1:-1]


class Stand(NamedTuple):
    """A camera over a bed, and what it saw of the bed's map."""

    tilt_deg: float
    """Of its axis against the plane's normal."""
    distance: float
    """To the plane along its axis, metres."""
    seen: float
    """Share of the map's nodes that it saw."""
    noise_mm: float
    """Expected standard deviation of a height from all of its frames, the median over its nodes."""
    frames: int


class MapReport(NamedTuple):
    """What is to be said of a map."""

    cameras: tuple[Stand, ...]
    seen: float
    """Share of the nodes that are known, narrow gaps filled."""
    noise_mm: float
    """Expected standard deviation of a height, the median over the nodes."""
    low_mm: float
    high_mm: float
    """Heights that all but one node in 100 lie above, and below."""


def map_report(
    looks: Sequence[Look],
    frames: Sequence[int],
    found: HeightMap,
    target: Camera,
    each: Sequence[np.ndarray],
) -> MapReport:
    """The report on a map.

    The mean of n frames is taken to have a noise of 1/sqrt(n): what comes anew with each.  What a
    camera errs by in all of them, as its own waviness, stays.  `frames` says how many each look is
    the mean of, `target` is the map's camera, `each` what that sees of each look: see `together`.
    """
    frame = matrix(found.frame)
    stands, precision = [], np.zeros(target.shape)
    for look, count, depth in zip(looks, frames, each, strict=True):
        there = np.isfinite(depth)
        noise = noise_of(look, target, np.nan_to_num(depth, nan=1.0)) / np.sqrt(count)
        precision += np.where(there, noise.astype(float) ** -2, 0.0)
        to_map = np.linalg.inv(frame) @ look.to_common
        down = float(-to_map[2, 2])
        stands.append(
            Stand(
                float(np.degrees(np.arccos(np.clip(down, -1.0, 1.0)))),
                float(to_map[2, 3]) / down,
                float(there.mean()),
                1e3 * float(np.median(noise[there])) if there.any() else float("nan"),
                int(count),
            )
        )
    known = np.asarray(found.heights)[found.mask]
    low, high = np.percentile(1e3 * known, (1, 99))
    noise = 1e3 * float(np.median(precision[precision > 0] ** -0.5))
    return MapReport(tuple(stands), float(found.mask.mean()), noise, float(low), float(high))
