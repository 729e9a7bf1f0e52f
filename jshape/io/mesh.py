"""What a camera sees of a mesh: the depth of the nearest face along every pixel's ray.

Pixels are `(u, v)`, arrays `[v, u]`; the mesh is in the camera's frame, metres.
"""

import os

import numpy as np

from jshape._typing import Float, Int
from jshape.camera import Camera
from jshape.errors import BadFile

_CHUNK = 2_000_000
_MOST = 2_000_000_000


def depth_of_faces(
    points: Float[np.ndarray, "P 3"],
    faces: Int[np.ndarray, "F 3"],
    camera: Camera,
    where: str | os.PathLike = "mesh",
) -> Float[np.ndarray, "H W"]:
    """Depth (H, W) in metres of the nearest face at every pixel's centre, NaN where there is none.

    Faces that reach behind the camera are left out.  Exact: 1/z of a plane is linear in the image.

    Raises BadFile: so many large faces that drawing them would take minutes.
    """
    corners = points[faces].astype(np.float64)
    corners = corners[(corners[..., 2] > 1e-6).all(1)]
    nearness = 1.0 / corners[..., 2]
    u = float(camera.fx) * corners[..., 0] * nearness + float(camera.u0)
    v = float(camera.fy) * corners[..., 1] * nearness + float(camera.v0)
    # The pixels that a face can reach, first and how many, clipped to the image.
    left, wide = _span(u, camera.width)
    top, high = _span(v, camera.height)
    # Faces of like size are drawn together, in rectangles of powers of two.
    wide, high = _power(wide), _power(high)
    if (wide * high).sum() > _MOST:
        raise BadFile(f"{where}: its faces are too many and too large to be drawn; simplify it")
    nearest = np.zeros(camera.height * camera.width)
    for columns, rows in np.unique(np.stack([wide, high], -1), axis=0):
        if columns == 0 or rows == 0:
            continue
        alike = np.flatnonzero((wide == columns) & (high == rows))
        step = max(_CHUNK // (int(columns) * int(rows)), 1)
        for start in range(0, len(alike), step):
            k = alike[start : start + step]
            x = (left[k, None] + np.arange(columns))[:, None, :]
            y = (top[k, None] + np.arange(rows))[:, :, None]
            value = _nearness(u[k], v[k], nearness[k], x, y)
            value[np.broadcast_to((x >= camera.width) | (y >= camera.height), value.shape)] = 0
            hit = np.nonzero(value)
            place = (y * camera.width + x)[hit]
            np.maximum.at(nearest, place, value[hit])
    with np.errstate(divide="ignore"):
        depth = np.where(nearest > 0, 1.0 / nearest, np.nan)
    return depth.reshape(camera.shape).astype(np.float32)


def _span(where: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """First pixel and number of pixels between the corners (F, 3), inside an image's side."""
    first = np.clip(np.ceil(where.min(1) - 1e-6), 0, count)
    last = np.clip(np.floor(where.max(1) + 1e-6), -1, count - 1)
    return first.astype(int), np.maximum(last - first + 1, 0).astype(int)


def _power(count: np.ndarray) -> np.ndarray:
    """The next power of two, and 0 of 0."""
    return np.where(count > 0, 2 ** np.ceil(np.log2(np.maximum(count, 1))).astype(int), 0)


def _nearness(
    u: np.ndarray, v: np.ndarray, nearness: np.ndarray, x: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """1/z of faces with corners u, v (f, 3) at pixels x (f, 1, w), y (f, h, 1); 0 outside them."""
    u, v, nearness = (a.T[:, :, None, None] for a in (u, v, nearness))
    area = (u[1] - u[0]) * (v[2] - v[0]) - (u[2] - u[0]) * (v[1] - v[0])
    safe = np.where(area == 0, 1.0, area)
    first = ((u[1] - x) * (v[2] - y) - (u[2] - x) * (v[1] - y)) / safe
    second = ((u[2] - x) * (v[0] - y) - (u[0] - x) * (v[2] - y)) / safe
    third = 1.0 - first - second
    # A little beyond the edge, so that no pixel between two faces is lost to rounding.
    inside = (np.minimum(np.minimum(first, second), third) >= -1e-6) & (area != 0)
    value = first * nearness[0] + second * nearness[1] + third * nearness[2]
    return np.where(inside, np.maximum(value, 0.0), 0.0)
