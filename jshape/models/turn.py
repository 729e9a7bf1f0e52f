"""Maps turned around their middle: what a hand does when the wrist is turned.

Arrays are `[v, u]`; a turn goes from u towards v, as seen by the camera.
"""

import jax.numpy as jnp

from jshape._typing import Array, Float


def turn(
    field: Float[Array, "n m"], yaw: float | Array, shape: tuple[int, int], outside: float = 0.0
) -> Float[Array, "rows columns"]:
    """A map turned by `yaw` radians around its middle node (n // 2, m // 2), linearly interpolated.

    Args:
      field: the map.
      yaw: how far.
      shape: rows and columns of the result, whose node (rows // 2, columns // 2) is the middle.
      outside: what is beyond the map's edge.
    """
    n, m = field.shape
    framed = jnp.pad(field, 1, constant_values=outside)
    y = (jnp.arange(shape[0]) - shape[0] // 2)[:, None]
    x = (jnp.arange(shape[1]) - shape[1] // 2)[None, :]
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    row = jnp.clip(cos * y - sin * x + n // 2 + 1, 0.0, n + 1.0)
    column = jnp.clip(cos * x + sin * y + m // 2 + 1, 0.0, m + 1.0)
    top = jnp.minimum(row.astype(jnp.int32), n)
    left = jnp.minimum(column.astype(jnp.int32), m)
    down, right = row - top, column - left
    above = (1 - right) * framed[top, left] + right * framed[top, left + 1]
    below = (1 - right) * framed[top + 1, left] + right * framed[top + 1, left + 1]
    return (1 - down) * above + down * below


def square(roi: tuple[int, int]) -> tuple[int, int]:
    """The size of ROI that holds an action in every direction: as wide and high as its longer side.

    What a turned effect has in the corners of its rectangle falls out; ROIs have margins there.
    """
    return max(roi), max(roi)
