"""Height maps as what a search takes: images of a camera above them, and a bank for that camera."""

from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from jshape import metric
from jshape._typing import Bool, Float
from jshape.camera import Camera
from jshape.data.missing import fill_missing
from jshape.errors import BadImage
from jshape.height_map import HeightMap, check_map
from jshape.models.bank import Bank

LEAST_SEEN = 0.2
"""Least share of a map that must be known, of the bed now and of the bed wanted."""


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
    seen = np.isfinite(depths[0]) & np.isfinite(depths[1])
    share = float(seen.mean())
    if share < LEAST_SEEN:
        raise BadImage(
            f"I0 and Istar: {share:.1%} of the map is known in both; at least {LEAST_SEEN:.0%} is "
            "needed"
        )
    middle = float(np.median(depths[0][seen]))
    first = image_of(depths[0], camera)
    goal = np.where(seen, image_of(depths[1], camera), first)
    return bank.seen_by(camera, middle), first, goal, seen


def on_grid_of(like: HeightMap, other: HeightMap) -> HeightMap:
    """Another map of the same bed on the grid of the first; NaN where it does not reach.

    Raises:
      BadImage: maps in different frames.
    """
    frames = [np.eye(4) if m.frame is None else np.array(m.frame) for m in (like, other)]
    if like.frame is not None and other.frame is not None and not np.allclose(*frames, atol=1e-4):
        raise BadImage(
            "I0 and Istar: the maps lie in different frames; make the second one like the first "
            "(heightmap(..., like=first))"
        )
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
