"""Maps stretched along the hand's path: what a hand does that is dragged farther, or less far.

Arrays are `[v, u]`; the path runs along u, its middle is the maps' middle node.
"""

from typing import Any

import numpy as np

from jshape._typing import Array, Float
from jshape.camera import namespace


def stretch(
    fields: Float[Any, "*B n m"],
    length: float | Array | np.floating,
    path: float | Array | np.floating,
    columns: int,
    outside: float | Float[Any, "*B"] = 0.0,
) -> Float[Any, "*B n columns"]:
    """Maps of a path that is `length` times as long, interpolated along u; traceable in numbers.

    What lies before and behind the path moves with its ends, as it is; between them it is stretched
    evenly.  A furrow keeps its walls, and gets longer.

    Args:
      fields: the maps, with the middle of the path at column m // 2.
      length: of the new path, as a multiple of the old one's; above 0.
      path: length of the old one, nodes.
      columns: of the result, whose column `columns` // 2 is the middle.
      outside: what is beyond the maps' edges.
    """
    xp = namespace(fields, length, path, outside)
    fields, length = xp.asarray(fields), xp.asarray(length, np.float32)
    m, half = fields.shape[-1], xp.asarray(path, np.float32) * length / 2
    beyond = xp.asarray(outside, fields.dtype)[..., None, None]
    edge = xp.broadcast_to(beyond, (*fields.shape[:-1], 1))
    framed = xp.concatenate([edge, fields, edge], -1)
    x = (np.arange(columns) - columns // 2).astype(np.float32)
    inside = xp.clip(x, -half, half)
    column = xp.clip(x - inside + inside / length + (m // 2 + 1), 0.0, m + 1.0)
    left = xp.minimum(column.astype(np.int32), m)
    right = (column - left.astype(np.float32)).reshape(*[1] * (fields.ndim - 1), -1)
    return (1 - right) * framed[..., left] + right * framed[..., left + 1]


def widened(size: int, by: float) -> int:
    """A window's size that is at least `by` larger, or smaller, its middle in the same place."""
    whole = int(np.ceil(by / 2 - 1e-3))  # a pitch in float32 must not add a node
    return max(size + 2 * whole, 2 - size % 2)
