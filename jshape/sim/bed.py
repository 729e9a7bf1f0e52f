"""The bed: a height field in a box with walls, over a metric grid seen from straight above.

Arrays are `[y, x]` (row, column), float32, metres.  The origin of the bed's frame is the middle of
the box, on the camera's optical axis; x points along image columns u, y along image rows v.  The
edge of the grid is the wall of the box: nothing passes it.
"""

import math
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Array, ArrayLike, Float, Key
from jshape.errors import JShapeError
from jshape.sim import check

CELL = 0.0025
"""Default side of a cell, metres."""
SIZE = (0.56, 0.46)
"""Default width (x) and length (y) of the box, metres: what `PAPER_BOX` sees down to 0.5 m."""
DEPTH = 0.06
"""Default depth of the material, metres."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Bed:
    """A bed of material.  A pytree: the arrays are traced, the size of a cell is static."""

    height: Float[Array, "*B Y X"]
    """Surface above the floor of the box, metres."""
    mass: Float[Array, "*B Y X"]
    """Material in the column, as the height that it would have if it were loose, metres."""
    cell: float = field(default=CELL, metadata={"static": True})
    """Side of a square cell, metres."""
    stock: Float[Array, "..."] | float = 0.0
    """What hands have taken out less what they have brought, as loose volume, m³; one per bed."""

    @property
    def packing(self) -> Float[Array, "*B Y X"]:
        """Density relative to the loose material; 1 where nothing has been pressed."""
        return self.mass / jnp.maximum(self.height, 1e-6)

    def axes(self) -> tuple[Float[Array, "X"], Float[Array, "Y"]]:
        """The x of every column and the y of every row (cell centres), metres."""
        rows, columns = self.height.shape[-2:]
        x = (jnp.arange(columns, dtype=jnp.float32) + 0.5 - columns / 2) * self.cell
        y = (jnp.arange(rows, dtype=jnp.float32) + 0.5 - rows / 2) * self.cell
        return x, y


def loose_bed(height: Float[ArrayLike, "*B Y X"], cell: float = CELL) -> Bed:
    """A bed of loose material with the given surface (metres above the floor, negative is 0).

    Raises:
      JShapeError: `height` is no image of finite numbers, or `cell` not positive.
    """
    check.number("cell", cell, above=0.0)
    try:
        numbers = check.known(height)
    except (TypeError, ValueError):
        raise JShapeError(f"height is {check.brief(height)}; it must be numbers, [y, x]") from None
    if numbers is not None and not (numbers.ndim >= 2 and np.isfinite(numbers).all()):
        raise JShapeError(
            f"height has shape {numbers.shape} and {np.isfinite(numbers).sum()} finite numbers; "
            "it must be [y, x] and all finite"
        )
    height = jnp.maximum(jnp.asarray(height, jnp.float32), 0.0)
    return Bed(height, height, cell, jnp.zeros(height.shape[:-2], jnp.float32))


def flat_bed(
    depth: float | Array = DEPTH, *, size: tuple[float, float] = SIZE, cell: float = CELL
) -> Bed:
    """A level bed of the given depth; size is (x, y), metres.

    Raises:
      JShapeError: a size or the depth is not positive and finite, as for all beds below.
    """
    check.number("depth", depth, above=0.0)
    return loose_bed(jnp.full(_grid(size, cell), depth, jnp.float32), cell)


def irregular_bed(
    key: Key[Array, ""],
    std: float | Array = 0.010,
    *,
    sigma: float = 0.022,
    depth: float | Array = DEPTH,
    size: tuple[float, float] = SIZE,
    cell: float = CELL,
) -> Bed:
    """A bed with hills: Gaussian noise smoothed to `sigma` metres and scaled to `std` metres.

    The mean height is `depth` and the standard deviation `std`, except that no place is lower
    than 2 mm: hills of more than about a third of `depth` lose their deepest valleys.
    """
    for name, value in (("depth", depth), ("sigma", sigma)):
        check.number(name, value, above=0.0)
    check.number("std", std, at_least=0.0)
    rows, columns = _grid(size, cell)
    margin = math.ceil(3 * sigma / cell)
    noise = jax.random.normal(key, (rows + 2 * margin, columns + 2 * margin), jnp.float32)
    noise = blur_matrix(rows, margin, sigma / cell) @ noise
    noise = noise @ blur_matrix(columns, margin, sigma / cell).T
    noise = (noise - noise.mean()) / noise.std()
    return loose_bed(jnp.maximum(depth + std * noise, 0.002), cell)


def curved_bed(
    radius: float | Array = 0.15,
    *,
    crown: float = 0.012,
    drop: float = 0.03,
    depth: float | Array = DEPTH,
    size: tuple[float, float] = SIZE,
    cell: float = CELL,
) -> Bed:
    """A dome (`radius` > 0) or a bowl (`radius` < 0) in the middle of the bed, metres.

    The middle is `crown` above (below) `depth`; further out the sphere goes down (up) until it
    is `drop` away from the middle, where the bed stays level.
    """
    check.number("radius", radius)
    if check.known(radius) == 0:
        raise JShapeError("radius is 0; it must be positive (a dome) or negative (a bowl)")
    check.number("crown", crown)
    check.number("drop", drop, at_least=0.0)
    flat = flat_bed(depth, size=size, cell=cell)
    x, y = flat.axes()
    sphere = jnp.abs(radius)
    r2 = x[None, :] ** 2 + y[:, None] ** 2
    fall = sphere - jnp.sqrt(jnp.maximum(sphere**2 - r2, 0.0))
    height = crown - jnp.minimum(fall, drop)
    return loose_bed(depth + jnp.sign(radius) * height, cell)


def volume(bed: Bed) -> Float[Array, "*B"]:
    """Room that the material takes, cubic metres."""
    return bed.height.sum((-2, -1)) * bed.cell**2


def mass(bed: Bed) -> Float[Array, "*B"]:
    """Material in the box, as the volume that it would take if it were loose, cubic metres.

    No action changes the sum of this and `Bed.stock`.
    """
    return bed.mass.sum((-2, -1)) * bed.cell**2


def blur_matrix(count: int, margin: int, sigma: float) -> Float[Array, "M N"]:
    """(count, count + 2 margin) Gaussian weights: times a line with margins, it blurs the line."""
    line = jnp.arange(count + 2 * margin, dtype=jnp.float32)
    apart = line[None, :] - (line[:count, None] + margin)
    weight = jnp.exp(-0.5 * (apart / sigma) ** 2)
    return weight / weight.sum(1, keepdims=True)


def _grid(size: tuple[float, float], cell: float) -> tuple[int, int]:
    """(rows, columns) of a box of size (x, y) metres."""
    check.number("cell", cell, above=0.0)
    try:
        x, y = size
    except (TypeError, ValueError):
        raise JShapeError(f"size is {check.brief(size)}; it must be (x, y) in metres") from None
    for name, side in (("size along x", x), ("size along y", y)):
        check.number(name, side, above=0.0)
    rows, columns = round(y / cell), round(x / cell)
    if min(rows, columns) < 2:
        raise JShapeError(f"size is {check.brief(size)}; it must be 2 cells of {cell} m or more")
    return rows, columns
