"""From the depth frames of cameras that stand anywhere to one height map of the bed."""

from collections.abc import Sequence

import numpy as np

from jshape._typing import ArrayLike, Float
from jshape.camera import Camera, check_camera, check_pose
from jshape.data.depth import check_shape, check_unit, to_metres
from jshape.data.fusion import (
    NOISE,
    RELIEF,
    Look,
    check_poses,
    points_of,
    reprojected,
    seen_from,
    some_of,
)
from jshape.data.missing import median_of
from jshape.data.moved import GRAIN, averaged, moved
from jshape.data.planes import LEAST_SURFACE, NEAR, bed_in, fit_plane, off_plane
from jshape.errors import BadCamera, BadImage, JShapeError, quoted
from jshape.height_map import Frame, HeightMap, as_frame, camera_above, check_map, map_of

LEAST_PLANE = 0.5
"""Least share of that surface's readings that lies in the bed's plane."""
PLANES = (NEAR, 0.03, 0.06)
"""What is so near, metres, lies in the plane: a bed all of hills and hollows is no better one."""
LEAST_UNLIKE = 2e-3
"""Metres by which means of blocks of two frames of a resting bed never differ."""
MOST_UNLIKE = 0.01
"""Share of such blocks above which frames are not of one resting bed."""
MOST_NODES = 1024
"""Most nodes along a side of a map: a wider bed has coarser ones."""


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
      pitch: metres between nodes; None is a pixel of the first camera in the middle of its view,
        or as coarse as the bed needs for `MOST_NODES`.
      window: (left, top, width, height) of the first camera's image that holds the bed, pixels.
      where: what to call the frames in errors.

    Returns:
      The map.  Nodes that no camera saw are NaN, but for gaps narrower than `GAP_MM`.

    Raises:
      BadImage: frames of another size or type, without readings, or no plane in them.
      BadCamera: cameras without a pose, or poses that do not agree.
      JShapeError: a pitch that is too fine for the bed.
    """
    looks = taken(depths, cameras, depth_unit, window, where)
    return together(looks, like=like, frame=frame, pitch=pitch, where=where)[0]


def together(
    looks: Sequence[Look],
    *,
    like: HeightMap | None = None,
    frame: ArrayLike | None = None,
    pitch: float | None = None,
    where: str = "depth",
    before: str = "the look before",
) -> tuple[HeightMap, Camera, list[np.ndarray]]:
    """The height map of looks that were taken, its camera, and what that sees of each look.

    See `heightmap`; `before` names `like` in errors.
    """
    if like is None:
        target, of = camera_over(looks, frame, pitch, where)
    else:
        target, of = check_map(like, "like").camera(), like.frame
    each = [reprojected(look, target) for look in looks]
    found = map_of(seen_from(looks, target, where, each), target, of)
    if like is not None:
        check_still(found, like, where, before)
    return found, target, each


def taken(
    depths: ArrayLike | Sequence[ArrayLike],
    cameras: Camera | Sequence[Camera],
    depth_unit: float = 0.001,
    window: tuple[int, int, int, int] | None = None,
    where: str = "depth",
    names: Sequence[str] = (),
) -> list[Look]:
    """The looks of cameras, checked; frames of a resting bed are averaged.

    Errors name the frames of each of several cameras by `names`, if they are given.

    Raises BadImage, BadCamera: as for `heightmap`.
    """
    several = not isinstance(cameras, Camera)
    every = list(cameras) if isinstance(cameras, Sequence) else [cameras]
    frames: list[ArrayLike] = list(depths) if several else [depths]  # type: ignore[arg-type]
    if not every or len(frames) != len(every):
        raise BadCamera(f"{where}: {len(frames)} looks of {len(every)} cameras; one each is needed")
    names = names or [f"{where} of camera {k}" for k in range(1, len(every) + 1)]
    names = names if len(every) > 1 else [where]
    for camera, name in zip(every, names, strict=True):
        if not isinstance(camera, Camera):
            raise BadCamera(f"{name}: camera is {quoted(camera)}; expected a Camera")
        check_camera(camera, name)
    check_poses(every, names)
    looks = []
    for raw, camera, name in zip(frames, every, names, strict=True):
        stack = to_metres(raw, depth_unit, name)
        stack = stack[None] if stack.ndim == 2 else stack
        for one in stack if stack.ndim == 3 else [stack]:
            check_shape(one, camera, name)
        depth = stack[0] if len(stack) == 1 else _mean(stack)
        if not np.isfinite(depth).any():
            away = "; does the camera's pose look away from the bed?" if camera.pose else ""
            raise BadImage(f"{name}: no pixel has a reading{away}")
        unit = depth_unit if np.asarray(raw).dtype.kind == "u" else None
        check_unit(depth, camera, name, unit)
        if window is not None and not looks:  # the first
            camera.crop(*window)  # refuses what leaves the image
            left, top, width, height = window
            outside = np.ones(depth.shape, bool)
            outside[top : top + height, left : left + width] = False
            depth[outside] = np.nan
        looks.append(Look(depth, camera))
    return looks


def unlike(stack: Float[np.ndarray, "T H W"], camera: Camera) -> tuple[float, float]:
    """How far frames of one camera, metres, are from showing one resting bed.

    Returns:
      The largest share of blocks of `GRAIN` of a frame that are as far from the first frame as
      noise never is, and that distance, mm: six times a D435's noise, and `LEAST_UNLIKE`.
    """
    z = median_of(np.where(stack[0] > 0, stack[0], np.nan))
    step = max(1, round(GRAIN * float(camera.scale(z)[0]))) if np.isfinite(z) else 1
    far = max(6 * NOISE * z**2, LEAST_UNLIKE)
    first, shares = averaged(stack[0], step), [0.0]
    for later in stack[1:]:
        gap = np.abs(averaged(later, step) - first)
        known = np.isfinite(gap)
        shares.append(float((gap[known] > far).mean()) if known.any() else 0.0)
    return max(shares), 1e3 * far


def _mean(stack: np.ndarray) -> np.ndarray:
    """The mean of frames (T, H, W) where at least half of them have a reading."""
    there = np.isfinite(stack)
    count = there.sum(0)
    total = np.where(there, stack, 0).sum(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(2 * count >= len(stack), total / count, np.nan).astype(np.float32)


def plane_frame(look: Look, where: str = "depth") -> Float[np.ndarray, "4 4"]:
    """From the frame of a map on the plane that most of a look lies in to the common frame.

    Its z is the plane's normal towards the camera, the origin lies where the optical axis meets
    the plane, x runs along the image's u.

    Raises BadImage: there is no such plane before the camera.
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

    Raises BadImage: there is none.
    """
    depth, camera = bed_of(look)
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


def bed_of(look: Look) -> tuple[np.ndarray, Camera]:
    """Some pixels of what a look shows, NaN where they are not the bed's, and their camera."""
    depth, camera = some_of(look)
    return np.where(bed_in(depth, camera), depth, np.float32(np.nan)), camera


def camera_over(
    looks: Sequence[Look],
    frame: ArrayLike | None = None,
    pitch: float | None = None,
    where: str = "depth",
) -> tuple[Camera, Frame]:
    """The camera that sees all of the looks' bed from straight above, and the frame of its map.

    Raises BadImage, BadCamera, JShapeError: as for `heightmap`.
    """
    first = looks[0]
    if frame is not None:
        check_pose(frame, where, "frame")
    to_common = plane_frame(first, where) if frame is None else np.asarray(frame, float)
    away = float((np.linalg.inv(first.to_common) @ to_common)[2, 3])
    to_map = np.linalg.inv(to_common)
    shown = np.concatenate([points_of(look, *bed_of(look), to_map) for look in looks])
    shown = shown[np.abs(shown[:, 2]) < RELIEF]
    if len(shown) < 100:
        raise BadImage(f"{where}: no reading lies within {RELIEF:g} m of the bed's plane")
    low, high = np.percentile(shown[:, :2], (0.2, 99.8), axis=0)
    side = float(max(high - low))
    finest = side / (MOST_NODES - 1)
    if pitch is None:
        pitch = max(1.0 / float(first.camera.scale(max(away, 0.05))[0]), finest)
    elif not pitch >= finest:
        raise JShapeError(
            f"{where}: nodes {1e3 * pitch:.3g} mm apart are too many for a bed of {1e3 * side:.0f} "
            f"mm; {1e3 * finest + 5e-3:.2f} mm or more, or a window that holds less of it"
        )
    half = np.maximum((high - low) / 2, pitch)
    columns, rows = (2 * half / pitch + 1e-6).astype(int) + 1
    x, y = (low + high) / 2 - half
    grid = (int(columns), int(rows)), float(pitch), (float(x), float(y))
    return camera_above(to_common, *grid), as_frame(to_common)


def check_still(found: HeightMap, like: HeightMap, where: str, of: str) -> None:
    """Refuse a look from which the bed lies elsewhere, as a whole, than in a map `of` one before.

    As far as `moved` tells it, from nodes averaged over `GRAIN`.

    Raises BadCamera: the camera moved.
    """
    camera = like.camera(found)
    now, before = found.depth(camera), like.depth(camera)
    if not (np.isfinite(now) & np.isfinite(before)).any():
        raise BadCamera(f"{where}: sees nothing of {of}: did the camera move?")
    step = max(1, round(GRAIN / float(like.pitch)))
    how = moved(averaged(before, step), averaged(now, step), camera, step)
    if how is not None:
        raise BadCamera(f"{where}: {how.said(of)}: did the camera move?")
