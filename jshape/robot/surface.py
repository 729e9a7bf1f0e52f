"""Where a place of a plan is on the bed."""

import numpy as np

from jshape._typing import ArrayLike, Float
from jshape.actions import PAPER_Z
from jshape.camera import Camera

AROUND = 3
"""The surface at a place is the median over so many pixels to each side."""


def surface_point(
    depth: Float[np.ndarray, "H W"],
    camera: Camera,
    position: ArrayLike,
    *,
    place_depth: float = PAPER_Z,
    beside: ArrayLike = (0.0, 0.0),
) -> Float[np.ndarray, "3"]:
    """The point of the surface under a place, metres, in the frame of the bank's camera.

    A place (u, v) is the pixel of a point at one depth for all (Hypothesis 3), which gives its x
    and y.  The surface there may be nearer or farther, and is then seen at another pixel.

    Args:
      depth: what the bank's camera sees, metres, without gaps.
      camera: the bank's.
      position: (u, v) pixels, whole or not.
      place_depth: depth at which places are meant, metres.
      beside: (x, y) from the place to where the surface is looked up instead, metres: there a hand
        that goes along a path goes down.
    """
    u, v = np.asarray(position, np.float64)
    x, y = camera.at(u, v, place_depth)
    z, (dx, dy) = place_depth, np.asarray(beside, np.float64)
    for _ in range(4):  # the surface's slope is well below 1: each round halves the error
        column, row = (int(np.rint(at)) for at in camera.pixel(x + dx, y + dy, z))
        column, row = min(max(column, 0), camera.width - 1), min(max(row, 0), camera.height - 1)
        rows, columns = (slice(max(at - AROUND, 0), at + AROUND + 1) for at in (row, column))
        z = float(np.median(depth[rows, columns]))
    return np.array([x, y, z])
