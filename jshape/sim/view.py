"""What a depth camera sees of the bed: perspective, lens, noise, missing pixels.

Depth images are `[v, u]`, float32, metres along the optical axis; 0 means "no reading".
"""

import functools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from jshape._typing import Array, ArrayLike, Float, Key, Num
from jshape.camera import Camera, single
from jshape.sim.bed import DEPTH, Bed
from jshape.sim.inputs import half_sides

SURFACE = 0.45
"""Depth of the surface of a default flat bed, metres."""
Z_FLOOR = SURFACE + DEPTH
"""Default depth of the floor of the box, metres."""
STRIDE = 0.5
"""Shortest step of a ray across the bed, cells: only a crest thinner than this can be missed."""
MOST = 500
"""Most steps of a ray: only beds that are far higher than their cells are wide come near it."""
AIM = 6
"""Rounds of false position inside the last step, to well below a micrometre where it is smooth."""
MARGIN = 1e-5
"""Rays start this far above the highest place and end this far below the lowest one, metres."""
FLATTEST = 0.05
"""Rays that go down by less than this per metre across, 3 degrees, read nothing: they meet a level
bed nowhere, or where float32 no longer tells the depths apart."""


@jax.jit
def render(bed: Bed, camera: Camera, z_floor: float | Array = Z_FLOOR) -> Float[Array, "H W"]:
    """Depth image of a bed, metres, without noise.

    The bed's frame is that of a camera straight above its middle: x along u, y along v, z down.
    `camera.pose` leads to it from the camera's; without one the camera is that one.

    Every ray walks down from above the highest place until it is below the surface: the first
    surface it meets wins, as for a real camera.  A step is the gap to the surface, shortened by
    the steepest slope of this bed so that it cannot pass through anything, but at least `STRIDE`
    cells across the bed: a ray that grazes a crest may miss it by less than that.  False position
    inside the last step finishes, so that the result is always a point of the surface.  The number
    of steps follows the bed (rough and steep ones take more).  The bed ends at the wall of the box:
    rays that end beyond it read 0, as do those that do not go down (`FLATTEST`) or begin in the
    bed.  What is hidden behind the wall is hidden by material as high as the bed at the wall.
    """
    begin, along = camera.lines(None if camera.pose is None else single(camera.pose))
    across = jnp.sqrt(along[0] ** 2 + along[1] ** 2)
    down = jnp.where(along[2] > FLATTEST * across, along[2], jnp.nan)
    rise_x, rise_y = (jnp.abs(jnp.diff(bed.height, axis=a)).max() / bed.cell for a in (1, 0))
    fastest = down + jnp.hypot(rise_x, rise_y) * across  # of the gap's change along the ray
    top, bottom = z_floor - bed.height.max() - MARGIN, z_floor - bed.height.min() + MARGIN
    # A camera between the hills looks from where it is.
    top, bottom = jnp.maximum((top - begin[2]) / down, 0.0), (bottom - begin[2]) / down
    stride = STRIDE * bed.cell / jnp.maximum(across, 1e-6)
    stride = jnp.maximum(stride, (bottom - top) / MOST)

    def gap(t):
        x, y, z = (b + t * a for b, a in zip(begin, along, strict=True))
        # Rounding must not leave a ray above the bottom for ever.
        return jnp.where(t < bottom, z_floor - _sample(bed, x, y) - z, -MARGIN)

    def walk(state):
        low, left, high, left_high = state
        above = left_high > 0  # not through yet; the others wait
        low, left = jnp.where(above, high, low), jnp.where(above, left_high, left)
        further = jnp.minimum(low + jnp.maximum(left / fastest, stride), bottom)
        high = jnp.where(above, further, high)
        return low, left, high, gap(high)

    def aim(_, state):
        low, left, high, left_high, z, now, before = state
        above = now > 0
        # The Illinois rule: an end that stays twice counts half, or it would stay for ever.
        stays = jnp.where(above == before, 0.5, 1.0)
        low, left = jnp.where(above, z, low), jnp.where(above, now, stays * left)
        high, left_high = jnp.where(above, high, z), jnp.where(above, stays * left_high, now)
        z = low + (high - low) * left / (left - left_high)
        return low, left, high, left_high, z, gap(z), above

    start = jnp.broadcast_to(top, camera.shape)
    left = jnp.full(camera.shape, MARGIN, jnp.float32)
    state = jax.lax.while_loop(lambda s: (s[3] > 0).any(), walk, (start, left, start, left))
    state = (*state, state[2], state[3], state[3] <= 0)
    depth = jax.lax.fori_loop(0, AIM, aim, state)[4]
    over = z_floor - _sample(bed, *begin[:2]) - begin[2] > 0
    x, y = (abs(b + depth * a) for b, a in zip(begin[:2], along[:2], strict=True))
    half_x, half_y = half_sides(bed).tolist()  # weakly typed, also under 64 bits
    return jnp.where(over & (depth > 0) & (x <= half_x) & (y <= half_y), depth, 0.0)


def _sample(bed, x, y):
    """Bilinear height at places (metres), clamped at the walls."""
    rows, columns = bed.height.shape
    column = jnp.clip(x / bed.cell + (columns - 1) / 2, 0.0, columns - 1.0)
    row = jnp.clip(y / bed.cell + (rows - 1) / 2, 0.0, rows - 1.0)
    left = jnp.minimum(column.astype(jnp.int32), columns - 2)
    top = jnp.minimum(row.astype(jnp.int32), rows - 2)
    right, below = column - left.astype(column.dtype), row - top.astype(row.dtype)
    flat = bed.height.reshape(-1)
    first = top * columns + left
    upper = flat[first] * (1 - right) + flat[first + 1] * right
    lower = flat[first + columns] * (1 - right) + flat[first + columns + 1] * right
    return upper * (1 - below) + lower * below


@jax.jit(static_argnames=["sigma_px"])
def sensor(
    key: Key[Array, ""],
    depth: Float[ArrayLike, "H W"],
    noise: float | Array = 0.00045,
    hole_share: float | Array = 0.002,
    *,
    sigma_px: float = 2.3,
) -> Float[Array, "H W"]:
    """A depth image as a stereo camera reports it.

    Args:
      key: consumed.
      depth: metres; 0 and whatever is not a finite positive number is no reading.
      noise: standard deviation at 0.45 m, metres; grows with the square of the depth (stereo).
      hole_share: share of the pixels that go missing, in clumps; on average this on level
        bed, and three times as much where the depth jumps.
      sigma_px: the noise is white noise blurred by this many pixels, so that its correlation
        over a distance r is exp(-r² / 4 sigma_px²): 0.83 at 2 px, 0.47 at 4 px.

    Returns:
      Depth with noise, metres, positive; missing pixels are 0, and so is what noise would push
      to 0 or below.
    """
    depth = _readings(depth)
    for_noise, for_holes = jax.random.split(key)
    height, width = depth.shape
    error = smooth_noise(for_noise, (height, width), sigma_px)
    noisy = depth + noise * (depth / 0.45) ** 2 * error
    clumps = smooth_noise(for_holes, (height, width), sigma_px)
    steps = jnp.maximum(
        jnp.abs(jnp.diff(depth, axis=0, append=depth[-1:])),
        jnp.abs(jnp.diff(depth, axis=1, append=depth[:, -1:])),
    )
    share = jnp.where(steps > 0.003, jnp.minimum(3.0 * hole_share, 1.0), hole_share)
    holes = jax.scipy.stats.norm.cdf(clumps) < share
    return jnp.where(holes | (depth <= 0) | (noisy <= 0), 0.0, noisy)


def _readings(depth):
    """Depth as float32 with 0 for all that no camera can have read: NaN, infinite, negative."""
    depth = jnp.asarray(depth, jnp.float32)
    return jnp.where(jnp.isfinite(depth) & (depth > 0), depth, 0.0)


def smooth_noise(
    key: Key[Array, ""], shape: tuple[int, int], sigma_px: float
) -> Float[Array, "H W"]:
    """Gaussian noise of standard deviation 1, correlated over about 2 `sigma_px` pixels."""
    reach = max(1, math.ceil(3 * sigma_px))
    taps = jnp.exp(-0.5 * (jnp.arange(-reach, reach + 1, dtype=jnp.float32) / sigma_px) ** 2)
    taps = taps / jnp.sqrt((taps**2).sum())
    white = jax.random.normal(key, (shape[0] + 2 * reach, shape[1] + 2 * reach), jnp.float32)
    rows = [taps[k] * white[k : k + shape[0]] for k in range(2 * reach + 1)]
    white = functools.reduce(jnp.add, rows)
    columns = [taps[k] * white[:, k : k + shape[1]] for k in range(2 * reach + 1)]
    return functools.reduce(jnp.add, columns)


def to_uint16(
    depth: Float[ArrayLike, "*B H W"], depth_unit: float = 0.0001
) -> Num[Array, "*B H W"]:
    """Raw 16-bit counts of `depth_unit` metres.  8 bits: `camera.luminance`.

    No reading (0, NaN, infinite, negative) is 0.  Depths beyond 65535 counts (6.55 m in tenths of
    a millimetre) become 65535.
    """
    counts = jnp.round(_readings(depth) / depth_unit)
    return jnp.clip(counts, 0, 65535).astype(jnp.uint16)


def position_to_xy(
    camera: Camera, uv: ArrayLike | Sequence, z: float | Array = SURFACE
) -> Float[Array, "*B 2"]:
    """The place in the bed's frame under pixel (u, v) at depth z, metres."""
    uv = jnp.asarray(uv, jnp.float32)
    return jnp.stack(camera.at(uv[..., 0], uv[..., 1], z), axis=-1)
