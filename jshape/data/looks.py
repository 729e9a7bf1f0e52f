"""From the depth frames of cameras that stand anywhere to one height map of the bed."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jshape._typing import ArrayLike, Float
from jshape.camera import Camera, check_camera, check_pose, matrix
from jshape.data.depth import check_unit, to_metres, wrong_shape
from jshape.data.planes import LEAST_SURFACE, NEAR, bed_in, fit_plane, off_plane
from jshape.errors import BadCamera, BadImage, JShapeError, quoted
from jshape.height_map import Frame, HeightMap, as_frame, camera_above, check_map, map_of
from jshape.reproject import between, reproject

RELIEF = 0.25
"""What is farther from the bed's plane, metres, is none of it: floor, arm, walls."""
LEAST_PLANE = 0.5
"""Least share of that surface's readings that lies in the bed's plane."""
PLANES = (NEAR, 0.03, 0.06)
"""What is so near, metres, lies in the plane: a bed all of hills and hollows is no better one."""
MOST_NODES = 1024
"""Most nodes along a side of a map."""
GAP_MM = 6.0
"""Gaps narrower than this are filled: a pixel or two without a reading, or an edge."""
NOISE = 2.2e-3
"""Noise of a look, metres per square metre of depth, seen from straight above: a D435's is 0.45 mm
at 0.45 m."""
APART = 5e-3
"""Metres by which two looks at one bed may differ in the median: more is a wrong pose."""
_POINTS = 20_000
"""Pixels that the plane and the extent are taken from."""


class Look(NamedTuple):
    """What one camera saw, and from where."""

    depth: Float[np.ndarray, "H W"]
    """Metres, NaN where there is no reading: the mean over its frames."""
    camera: Camera
    to_common: np.ndarray
    """(4, 4) from the camera's frame to the one that all share."""


def heightmap(
    depths: ArrayLike | Sequence[ArrayLike],
    cameras: Camera | Sequence[Camera],
    *,
    depth_unit: float = 0.001,
    like: HeightMap | None = None,
    frame: ArrayLike | None = None,
    pitch: float | None = None,
    window: tuple[int, int, int, int] | None = None,
    where: str = "depth",
) -> HeightMap:
    """The bed from straight above, as one or several cameras see it from anywhere.

    The bed's plane is found in what the first camera sees, unless `like` or `frame` states it.

    Args:
      depths: of one camera a frame (H, W) or several of a resting bed (T, H, W), of which the mean
        is taken; of several cameras one such entry each.  Metres as floats, or uint16 counts.
      cameras: that took them.  Several need a `pose` each.
      depth_unit: metres per count of integer frames.
      like: a map of an earlier look of the same cameras: the new one has its grid and frame.
      frame: (4, 4) from the map's frame to the cameras' common one; its z is up.
      pitch: metres between nodes; None is a pixel of the first camera in the middle of its view.
      window: (left, top, width, height) of the first camera's image that holds the bed, pixels.
      where: what to call the frames in errors.

    Returns:
      The map.  Nodes that no camera saw are NaN, but for gaps narrower than `GAP_MM`.

    Raises:
      BadImage: frames of another size or type, without readings, or no plane in them.
      BadCamera: cameras without a pose, or poses that do not agree.
    """
    looks = taken(depths, cameras, depth_unit, window, where)
    return together(looks, like=like, frame=frame, pitch=pitch, where=where)


def together(
    looks: Sequence[Look],
    *,
    like: HeightMap | None = None,
    frame: ArrayLike | None = None,
    pitch: float | None = None,
    where: str = "depth",
) -> HeightMap:
    """The height map of looks that were taken: see `heightmap`."""
    if like is None:
        target, frame = camera_over(looks, frame, pitch, where)
        return map_of(seen_from(looks, target, where), target, frame)
    check_map(like, "like")
    target = like.camera()
    found = map_of(seen_from(looks, target, where), target, like.frame)
    _check_still(found, like, where)
    return found


def taken(
    depths: ArrayLike | Sequence[ArrayLike],
    cameras: Camera | Sequence[Camera],
    depth_unit: float = 0.001,
    window: tuple[int, int, int, int] | None = None,
    where: str = "depth",
) -> list[Look]:
    """The looks of cameras, checked; frames of a resting bed are averaged.

    Raises:
      BadImage, BadCamera: as for `heightmap`.
    """
    several = not isinstance(cameras, Camera)
    every = list(cameras) if isinstance(cameras, Sequence) else [cameras]
    frames: list[ArrayLike] = list(depths) if several else [depths]  # type: ignore[arg-type]
    if not every or len(frames) != len(every):
        raise BadCamera(f"{where}: {len(frames)} looks of {len(every)} cameras; one each is needed")
    looks = []
    for number, (raw, camera) in enumerate(zip(frames, every, strict=True)):
        name = where if len(every) == 1 else f"{where} of camera {number + 1}"
        if not isinstance(camera, Camera):
            raise BadCamera(f"{name}: camera is {quoted(camera)}; expected a Camera")
        check_camera(camera, name)
        if len(every) > 1 and camera.pose is None:
            raise BadCamera(
                f"{name}: has no pose; several cameras need one each, in one common frame (jshape "
                "calibrate finds it)"
            )
        stack = to_metres(raw, depth_unit, name)
        stack = stack[None] if stack.ndim == 2 else stack
        if stack.ndim != 3 or stack.shape[1:] != camera.shape:
            raise BadImage(wrong_shape(name, stack.shape[-2:] or stack.shape, camera))
        depth = _mean(stack)
        if not np.isfinite(depth).any():
            raise BadImage(f"{name}: no pixel has a reading")
        unit = depth_unit if np.asarray(raw).dtype.kind == "u" else None
        check_unit(depth, camera, name, unit)
        if window is not None and number == 0:
            left, top, width, height = window
            camera.crop(left, top, width, height)
            outside = np.ones(depth.shape, bool)
            outside[top : top + height, left : left + width] = False
            depth[outside] = np.nan
        pose = matrix(camera.pose)
        looks.append(Look(depth, camera, pose))
    return looks


def _mean(stack: np.ndarray) -> np.ndarray:
    """The mean of frames (T, H, W) where at least half of them have a reading."""
    if len(stack) == 1:
        return stack[0].copy()
    there = np.isfinite(stack)
    count = there.sum(0)
    total = np.where(there, stack, 0).sum(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(2 * count >= len(stack), total / count, np.nan).astype(np.float32)


def plane_frame(look: Look, where: str = "depth") -> Float[np.ndarray, "4 4"]:
    """From the frame of a map on the plane that most of a look lies in to the common frame.

    Its z is the plane's normal towards the camera, the origin lies where the optical axis meets
    the plane, x runs along the image's u.

    Raises:
      BadImage: there is no such plane before the camera.
    """
    plane = _plane(look, where)
    if not plane[2] > 1e-6:
        raise BadImage(f"{where}: the bed's plane is seen from its edge")
    z = -plane / np.linalg.norm(plane)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    frame = np.eye(4)
    frame[:3, :3] = np.stack([x, np.cross(z, x), z], 1)
    frame[:3, 3] = 0.0, 0.0, 1.0 / plane[2]
    return look.to_common @ frame


def _plane(look: Look, where: str) -> np.ndarray:
    """The plane that most readings of the bed that a look shows lie in.

    Raises:
      BadImage: there is none.
    """
    depth, camera = _bed(look)
    there = np.isfinite(depth)
    if not there.any():
        raise BadImage(f"{where}: no pixel has a reading")
    all_of_it = np.isfinite(look.depth).mean() * depth.size
    share, missed = there.sum() / all_of_it, f"{where}: the bed's plane is not found: "
    hint = "; look at the levelled bed first, or cut it out with a window"
    if share < LEAST_SURFACE:
        raise BadImage(
            f"{missed}the largest surface without a step holds {share:.0%} of the readings, at "
            f"least {LEAST_SURFACE:.0%} are needed{hint}"
        )
    for near in PLANES:
        try:
            plane = fit_plane(depth, camera, near)
        except JShapeError as problem:
            raise BadImage(f"{missed}{problem}") from None
        off, _ = off_plane(depth, camera, plane)
        share = float(np.mean(np.abs(off[there]) < 1e3 * near))
        if share >= LEAST_PLANE:
            return plane
    raise BadImage(
        f"{missed}{share:.0%} of the bed lies within {1e3 * near:g} mm of one, at least "
        f"{LEAST_PLANE:.0%} must{hint}"
    )


def _bed(look: Look) -> tuple[np.ndarray, Camera]:
    """Some pixels of what a look shows, NaN where they are not the bed's, and their camera."""
    depth, camera = _some(look)
    return np.where(bed_in(depth, camera), depth, np.float32(np.nan)), camera


def _some(look: Look) -> tuple[np.ndarray, Camera]:
    """About `_POINTS` pixels of a look, and the camera that has only those."""
    step, camera = max(1, int(np.sqrt(look.depth.size / _POINTS))), look.camera
    size = {name: -(-getattr(camera, name) // step) for name in ("width", "height")}
    optics = {name: getattr(camera, name) / step for name in ("fx", "fy", "u0", "v0")}
    return look.depth[::step, ::step], replace(camera, **size, **optics)


def camera_over(
    looks: Sequence[Look],
    frame: ArrayLike | None = None,
    pitch: float | None = None,
    where: str = "depth",
) -> tuple[Camera, Frame]:
    """The camera that sees all of the looks' bed from straight above, and the frame of its map.

    Raises:
      BadImage, BadCamera: as for `heightmap`.
    """
    first = looks[0]
    if frame is None:
        to_common = plane_frame(first, where)
    else:
        check_pose(frame, where, "frame")
        to_common = np.asarray(frame, float)
    away = float((np.linalg.inv(first.to_common) @ to_common)[2, 3])
    pitch = 1.0 / float(first.camera.scale(max(away, 0.05))[0]) if pitch is None else pitch
    to_map = np.linalg.inv(to_common)
    shown = np.concatenate([_points(look, *_bed(look), to_map) for look in looks])
    shown = shown[np.abs(shown[:, 2]) < RELIEF]
    if len(shown) < 100:
        raise BadImage(f"{where}: no reading lies within {RELIEF:g} m of the bed's plane")
    low, high = np.percentile(shown[:, :2], (0.2, 99.8), axis=0)
    half = np.clip((high - low) / 2, pitch, pitch * (MOST_NODES - 1) / 2)
    columns, rows = (2 * half / pitch).astype(int) + 1
    x, y = (low + high) / 2 - half
    size, origin = (int(columns), int(rows)), (float(x), float(y))
    return camera_above(to_common, size, float(pitch), origin), as_frame(to_common)


def _points(
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
    looks: Sequence[Look], target: Camera, where: str = "depth"
) -> Float[np.ndarray, "h w"]:
    """What a camera would see of the bed that others see: metres, NaN where none of them does.

    Raises:
      BadImage: nothing of it.
      BadCamera: looks that do not agree.
    """
    seen = _fused(looks, [reprojected(look, target) for look in looks], target, where)
    middle = (float(target.z_min) + float(target.z_max)) / 2
    found = _without_gaps(seen, float(target.scale(middle)[0]))
    if not np.isfinite(found).any():
        raise BadImage(f"{where}: the camera sees nothing of the bed that is looked for")
    return found


def reprojected(look: Look, target: Camera) -> Float[np.ndarray, "h w"]:
    """What the target would see of one look; NaN where the look does not show it."""
    pose = matrix(target.pose)
    z = _points(look, *_some(look), np.linalg.inv(pose))[:, 2]
    middle = (float(target.z_min) + float(target.z_max)) / 2
    z = z[np.abs(z - middle) < RELIEF]
    if not z.size:
        return np.full(target.shape, np.float32(np.nan))
    near, far = np.percentile(z, (0.05, 99.95))
    room = max(5e-3, 0.1 * (far - near))
    span = np.array([near - room, far + room], np.float32)
    return np.array(reproject(look.depth, look.camera, target, span))


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


def _fused(
    looks: Sequence[Look], seen: Sequence[np.ndarray], target: Camera, where: str
) -> Float[np.ndarray, "h w"]:
    """One image of several: each pixel the mean, weighted by 1 / noise^2.

    Where looks disagree by more than `APART`, as at edges, the least noisy one holds.

    Raises:
      BadCamera: two of them do not agree on most of what both see.
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
    square, border = np.ones((side, side), np.uint8), {"borderType": 0, "borderValue": (0,)}
    closed: np.ndarray = known.astype(np.uint8)
    for step in (cv2.dilate, cv2.erode):
        closed = np.asarray(step(closed, square, **border))  # type: ignore[call-overload]
    rows, columns = (at + 1 for at in np.nonzero((closed > 0) & ~known))
    whole = np.pad(depth, 1, constant_values=np.nan)
    flat, wide = whole.reshape(-1), whole.shape[1]
    here = rows * wide + columns
    beside = here + np.array([[1], [-1], [wide], [-wide]])
    for _ in range(4 * side):  # the mean of the neighbours: Laplace's equation
        around = flat[beside]
        there = np.isfinite(around)
        total, count = np.where(there, around, 0).sum(0), there.sum(0)
        flat[here] = np.where(count > 0, total / np.maximum(count, 1), np.nan)  # known a step later
    return whole[1:-1, 1:-1]


def _check_still(found: HeightMap, like: HeightMap, where: str) -> None:
    """Refuse a look from which the bed lies elsewhere, as a whole, than in the one before.

    Molding lowers some of the bed and raises some: what it changes is no plane, what a camera does
    that moves is one.

    Raises:
      BadCamera: the camera moved.
    """
    step = max(1, int(np.sqrt(found.mask.size / _POINTS)))
    some = np.s_[::step, ::step]
    gap = (np.asarray(found.heights) - np.asarray(like.heights))[some]
    both = (found.mask & like.mask)[some]
    if not both.any():
        raise BadCamera(f"{where}: sees nothing that the look before saw: did the camera move?")
    gap, off = gap[both], float(np.median(np.abs(gap[both])))
    if off <= APART:
        return
    terms = np.stack([*np.nonzero(both), np.ones(gap.size, int)], 1).astype(np.float32)
    plane = np.linalg.lstsq(terms, gap, rcond=None)[0]
    if np.median(np.abs(gap - terms @ plane)) < off / 2:
        raise BadCamera(
            f"{where}: the bed lies {1e3 * off:.1f} mm from where the look before saw it (median, "
            f"at most {1e3 * APART:g} mm): did the camera move?"
        )
