"""Depths as coloured pictures and as surfaces in 3-D."""

from typing import NamedTuple

import matplotlib
import numpy as np

from jshape._typing import Float
from jshape.camera import Camera
from jshape.data.missing import missing

HEIGHTS, DIFFERENCES = "viridis", "RdBu_r"
"""Colour maps: higher is brighter; too high is red, too low is blue."""
NOTHING = (110, 110, 110)
"""Colour of pixels without a reading."""
MOST_NODES = 60_000
"""Most points of a surface: the paper's 480x395 image at every second pixel is 47,520."""


def height_colours(depth: np.ndarray, range_m: tuple[float, float]) -> np.ndarray:
    """(H, W, 3) uint8 of depths (H, W); `range_m`, nearest and farthest, is the whole scale."""
    near, far = range_m
    return _coloured(np.where(missing(depth), np.nan, (far - depth) / (far - near)), HEIGHTS)


def difference_colours(too_high_mm: np.ndarray, reach_mm: float) -> np.ndarray:
    """(H, W, 3) uint8 of differences (H, W) in mm, white where there is none."""
    return _coloured(0.5 + too_high_mm / (2 * reach_mm), DIFFERENCES)


def _coloured(share: np.ndarray, name: str) -> np.ndarray:
    table = matplotlib.colormaps[name](np.linspace(0, 1, 256))[:, :3]
    table = np.rint(255 * table).astype(np.uint8)
    known = np.isfinite(share)
    level = np.rint(255 * np.clip(np.where(known, share, 0.0), 0.0, 1.0)).astype(np.intp)
    return np.where(known[..., None], table[level], np.array(NOTHING, np.uint8))


class Surface(NamedTuple):
    """A bed as triangles that face the camera."""

    points: np.ndarray
    """(P, 3) camera frame, metres."""
    faces: np.ndarray
    """(F, 3) numbers of points."""
    normals: np.ndarray
    """(P, 3) of length 1, towards the camera."""
    pixels: tuple[np.ndarray, np.ndarray]
    """(P,) rows v and (P,) columns u that the points are of."""


def surface(
    depth: Float[np.ndarray, "H W"],
    camera: Camera,
    *,
    level: float,
    exaggeration: float = 1.0,
    most: int = MOST_NODES,
) -> Surface:
    """The surface of a depth image, thinned to at most `most` points; no faces across gaps.

    Args:
      depth: metres, NaN or 0 = no reading.
      camera: that took it.
      level: depth that stays in its place when heights are exaggerated, metres.
      exaggeration: factor on heights; places across the bed stay.
      most: points.
    """
    height, width = depth.shape
    stride = 1
    while -(-height // stride) * -(-width // stride) > most:
        stride += 1
    v, u = np.mgrid[0:height:stride, 0:width:stride]
    z = np.where(missing(depth), np.nan, depth)[v, u].astype(np.float64)
    x, y = (np.asarray(ray, np.float64) for ray in camera.rays())
    shown = level + exaggeration * (z - level)
    points = np.stack([x[0, u] * z, y[v, 0] * z, shown], -1)
    along = [np.gradient(points, axis=axis) for axis in (1, 0)]
    normals = np.cross(along[1], along[0])
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    facing = np.isfinite(length) & (length > 0)
    normals = np.where(facing, normals / np.where(facing, length, 1.0), [0.0, 0.0, -1.0])

    number = np.arange(v.size).reshape(v.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))])
    known = np.isfinite(z).reshape(-1)
    faces = faces[known[faces].all(1)]
    points = np.where(known[:, None], points.reshape(-1, 3), [0.0, 0.0, level])
    return Surface(
        points.astype(np.float32), faces.astype(np.int32),
        normals.reshape(-1, 3).astype(np.float32), (v.reshape(-1), u.reshape(-1)),
    )  # fmt: skip
