"""Height maps of any size as depth images of a camera: shapes that others measured or drew."""

from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from jshape._typing import Float
from jshape.camera import Camera
from jshape.errors import BadImage


def depth_of_relief(
    relief: np.ndarray, camera: Camera, *, scale: float = 1.0, middle: float | None = None
) -> Float[np.ndarray, "H W"]:
    """The depth image of a relief laid over the whole view of a camera.

    The relief is stretched to the image, so its horizontal size is what the camera sees; `scale`
    sets how high it is.  Perspective within the relief is left out: at 0.45 m, 25 mm of height
    move a point at the edge of the paper's box by 6 %.

    Args:
      relief: (rows, columns) of depth against its mean: positive is farther away; NaN unknown.
      camera: whose image to fill.
      scale: metres of depth per unit of the relief.
      middle: depth of relief 0, metres; None is the middle of the camera's range.

    Returns:
      (H, W) float32, metres; NaN where the relief is unknown.

    Raises:
      BadImage: not a two-dimensional map of real numbers.
    """
    relief = np.asarray(relief)
    if relief.ndim != 2 or min(relief.shape, default=0) < 2 or relief.dtype.kind not in "fiu":
        raise BadImage(
            f"a relief has shape {relief.shape} and type {relief.dtype}; "
            "expected (rows, columns) of numbers, at least 2 x 2"
        )
    if middle is None:
        middle = (float(camera.z_min) + float(camera.z_max)) / 2
    size = (camera.width, camera.height)
    stretched = cv2.resize(relief.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return (middle + scale * stretched).astype(np.float32)


def top_of_points(
    xy: Float[np.ndarray, "P 2"], height: Float[np.ndarray, "P"], cell: float, *, margin: int = 0
) -> Float[np.ndarray, "rows columns"]:
    """The highest points of a cloud in every cell of a grid; small gaps take their nearest cell.

    Args:
      xy: of the points.
      height: of the points.
      cell: side of a cell, in the points' unit.
      margin: empty cells around.

    Returns:
      (rows, columns) of (y, x); NaN in cells more than two cells away from any point.

    Raises:
      BadImage: the points are so far apart that the grid has more than ten million cells.
    """
    place = np.floor((xy - xy.min(0)) / cell).astype(int) + margin
    columns, rows = (int(n) for n in place.max(0) + margin + 1)
    if rows * columns > 1e7:
        raise BadImage(f"{len(xy)} points are too far apart: {columns} x {rows} cells")
    top = np.full((rows, columns), -np.inf)
    np.maximum.at(top, (place[:, 1], place[:, 0]), height)
    found: Any = ndimage.distance_transform_edt(np.isinf(top), return_indices=True)
    apart, nearest = found
    return np.where(apart <= 2, top[tuple(nearest)], np.nan)
