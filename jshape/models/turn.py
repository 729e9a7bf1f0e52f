"""Maps turned around their middle: what a hand does when the wrist is turned.

Arrays are `[v, u]`; a turn goes from u towards v, as seen by the camera.
"""

from typing import Any

import numpy as np

from jshape._typing import Array, Float
from jshape.camera import namespace


def turn(
    fields: Float[Any, "*B n m"],
    yaw: float | Array | np.ndarray | np.floating,
    shape: tuple[int, int],
    outside: float | Float[Any, "*B"] = 0.0,
) -> Float[Any, "*B rows columns"]:
    """Maps turned by `yaw` radians around their middle node (n // 2, m // 2), interpolated.

    Args:
      fields: the maps.
      yaw: how far.
      shape: rows and columns of the result, whose node (rows // 2, columns // 2) is the middle.
      outside: what is beyond the maps' edges.
    """
    xp = namespace(fields, yaw, outside)
    yaw = xp.asarray(yaw, np.float32)
    fields = xp.asarray(fields)
    n, m = fields.shape[-2:]
    edge = [(0, 0)] * (fields.ndim - 2) + [(1, 1)] * 2
    beyond = np.pad(np.zeros((n, m), bool), 1, constant_values=True)
    framed = xp.where(
        beyond, xp.asarray(outside, fields.dtype)[..., None, None], xp.pad(fields, edge)
    )
    y = (np.arange(shape[0]) - shape[0] // 2).astype(np.float32)[:, None]
    x = (np.arange(shape[1]) - shape[1] // 2).astype(np.float32)[None, :]
    cos, sin = xp.cos(yaw), xp.sin(yaw)
    row = xp.clip(cos * y - sin * x + (n // 2 + 1), 0.0, n + 1.0)
    column = xp.clip(cos * x + sin * y + (m // 2 + 1), 0.0, m + 1.0)
    top = xp.minimum(row.astype(np.int32), n)
    left = xp.minimum(column.astype(np.int32), m)
    down, right = row - top.astype(np.float32), column - left.astype(np.float32)
    above = (1 - right) * framed[..., top, left] + right * framed[..., top, left + 1]
    below = (1 - right) * framed[..., top + 1, left] + right * framed[..., top + 1, left + 1]
    return (1 - down) * above + down * below


def square(roi: tuple[int, int]) -> tuple[int, int]:
    """The size of ROI that holds an action in every direction: as wide and high as its longer side.

    What a turned effect has in the corners of its rectangle falls out; ROIs have margins there.
    """
    return max(roi), max(roi)
