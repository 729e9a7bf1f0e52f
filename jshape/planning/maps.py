"""Beds that a bank's camera did not see: looked at from above, and a bank for that camera."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from jshape import metric
from jshape._typing import Bool, Float
from jshape.camera import Camera, matrix, window_of
from jshape.data.missing import fill_missing
from jshape.data.view import View, cut_out, known_in_both, view_above, view_like
from jshape.errors import BadCamera, BadImage
from jshape.height_map import ABOVE, HeightMap, check_map
from jshape.models.bank import Bank
from jshape.planning.kernels import grid_of

RELIEF = 0.06
"""Relief of beds that the bundled banks were trained on, metres: the paper's range and a rim."""
SLOPE = 1.0
"""Rise over run of their steepest hundredth: walls that a press leaves stand at 45 degrees."""
SLOPE_OVER = 5e-3
"""Metres over which a slope is taken: over less it is noise."""


def over_bed(
    bank: Bank, source: Camera, frame: np.ndarray, where: str = "frame", *, again: bool = False
) -> tuple[View, Bank]:
    """How a bank sees the frames of a camera, and the bank for what it then sees.

    Its own image, if the frames hold it and the bed is in its range, unless it is to look `again`.
    Else the bed is looked at from above: in metres by banks that work on the ground, through their
    camera by those that work on images.

    Raises:
      BadCamera: a camera that makes no sense, or a bed that is smaller than an action.
      BadImage: a frame of another size, or no bed in it.
    """
    own = None if again else cut_out(source, bank.camera, frame)
    if own is not None:
        return own, bank
    on_ground = grid_of(bank) is not None
    if source.orthographic:  # a height map; banks that are images of one camera refuse it
        view = View(source, source, (0, 0))
    else:
        view = view_above(source, frame, None if on_ground else bank.camera, where)
    return view, bank_for(bank, view.target)


def bank_for(bank: Bank, target: Camera) -> Bank:
    """The bank for a camera above the bed, as `over_bed` has it.

    Raises:
      BadCamera: a bed that is smaller than an action.
    """
    if not target.orthographic or window_of(bank.camera, target) == (0, 0):
        return replace(bank, camera=target)  # its own, wherever it stands
    bank = bank.seen_by(target, ABOVE)
    pixel = 1e3 / float(target.scale(ABOVE)[0])
    for name, (w, h) in bank.rois.items():
        if w > target.width or h > target.height:
            raise BadCamera(
                f"{target.width * pixel:.0f} x {target.height * pixel:.0f} mm of bed are seen; "
                f"{name} changes {w * pixel:.0f} x {h * pixel:.0f} mm"
            )
    return bank


def over_beds(
    bank: Bank,
    cameras: Sequence[Camera],
    frames: Sequence[np.ndarray],
    names: Sequence[str],
    *,
    again: bool = False,
) -> tuple[View, View, Bank]:
    """As `over_bed`, of the bed now and of the bed wanted, which are seen alike."""
    view, seen_by = over_bed(bank, cameras[0], frames[0], names[0], again=again)
    if view.window is not None and view.target == bank.camera:
        beside = cut_out(cameras[1], bank.camera, frames[1])
        if beside is not None:
            return view, beside, bank
        view, seen_by = over_bed(bank, cameras[0], frames[0], names[0], again=True)
    return view, view_like(view, cameras[1], frames[1], names[1]), seen_by


def on_maps(
    now: Any, wanted: Any, bank: Bank
) -> tuple[Bank, Float[np.ndarray, "H W"], Float[np.ndarray, "H W"], Bool[np.ndarray, "H W"]]:
    """The bank for the camera above a map, the images of both maps, and which pixels count.

    Raises:
      BadImage: one of the two is no map, or they have too little in common.
      BadBank: predictors that are images of one camera.
    """
    for name, one in (("I0", now), ("Istar", wanted)):
        if not isinstance(one, HeightMap):
            raise BadImage(f"{name} is no HeightMap, and the other one is; give two of a kind")
        check_map(one, name)
    wanted = on_grid_of(now, wanted)
    camera = now.camera(wanted)
    depths = now.depth(camera), wanted.depth(camera)
    seen = known_in_both(*map(np.isfinite, depths), "I0", "Istar")
    first = image_of(depths[0], camera)
    goal = np.where(seen, image_of(depths[1], camera), first)
    return bank_for(bank, camera), first, goal, seen


def outside_domain(now: Any, wanted: Any, camera: Camera, seen: np.ndarray) -> tuple[str, ...]:
    """What of two images the bundled banks were not trained on, in words; empty: nothing.

    Args:
      now: (H, W) I of the bed now.
      wanted: of the bed wanted.
      camera: above the bed, with parallel rays.
      seen: (H, W) pixels that count.
    """
    said, pitch = [], 1.0 / float(camera.fx)
    apart = max(1, round(SLOPE_OVER / pitch))
    for name, image in (("now", now), ("wanted", wanted)):
        z = np.asarray(camera.depth(metric.unweigh(image, camera)))
        relief = float(np.ptp(np.percentile(z[seen], (1, 99))))
        if relief > RELIEF:
            said.append(
                f"the bed {name} has {1e3 * relief:.0f} mm of relief; the bundled banks know "
                f"{1e3 * RELIEF:.0f} mm"
            )
        slopes = [
            np.abs(one)[both]
            for one, both in (
                (z[apart:] - z[:-apart], seen[apart:] & seen[:-apart]),
                (z[:, apart:] - z[:, :-apart], seen[:, apart:] & seen[:, :-apart]),
            )
        ]
        steep = float(np.percentile(np.concatenate(slopes), 99)) / (apart * pitch)
        if steep > SLOPE:
            said.append(
                f"the bed {name} is up to {np.degrees(np.arctan(steep)):.0f} degrees steep; the "
                f"bundled banks know {np.degrees(np.arctan(SLOPE)):.0f}"
            )
    return tuple(said)


def check_frames(like: HeightMap, other: HeightMap, names: str, how: str) -> None:
    """Refuse two maps, `names`, in different frames; `how` the second is made like the first.

    Raises:
      BadImage: they are.
    """
    frames = [matrix(m.frame) for m in (like, other)]
    if like.frame is not None and other.frame is not None and not np.allclose(*frames, atol=1e-4):
        raise BadImage(
            f"{names}: the maps lie in different frames; make the second one like the first ({how})"
        )


def on_grid_of(like: HeightMap, other: HeightMap) -> HeightMap:
    """Another map of the same bed on the grid of the first; NaN where it does not reach.

    Raises:
      BadImage: maps in different frames.
    """
    check_frames(like, other, "I0 and Istar", "heightmap(..., like=first)")
    rows = (like.y - other.origin[1]) / float(other.pitch)
    columns = (like.x - other.origin[0]) / float(other.pitch)
    shape = np.shape(other.heights)
    if np.shape(like.heights) == shape and np.allclose(rows, np.arange(shape[0]), atol=1e-3):
        if np.allclose(columns, np.arange(shape[1]), atol=1e-3):
            heights = np.where(other.mask, np.asarray(other.heights, np.float32), np.nan)
            return HeightMap(heights, like.pitch, like.origin, other.mask, like.frame)
    heights = np.where(other.mask, np.asarray(other.heights, np.float32), np.float32(np.nan))
    at = np.meshgrid(rows, columns, indexing="ij")
    found = map_coordinates(heights, at, order=1, mode="constant", cval=np.nan)
    return HeightMap(found.astype(np.float32), like.pitch, like.origin, None, like.frame)


def image_of(depth: Float[np.ndarray, "H W"], camera: Camera) -> Float[np.ndarray, "H W"]:
    """The weighed image of a depth image (metres); what is not known is filled."""
    whole, _ = fill_missing(depth, limit=1.0, where="map")
    level = camera.luminance(whole, quantize=False)
    return np.asarray(metric.weigh(level, camera))
