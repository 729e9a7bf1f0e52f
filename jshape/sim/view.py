"""What a depth camera straight above the bed sees: perspective, noise, missing pixels.

Depth images are `[v, u]`, float32, metres along the optical axis; 0 means "no reading".
"""

import functools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp

from jshape._typing import Array, ArrayLike, Float, Key, Num
from jshape.camera import Camera
from jshape.sim.bed import DEPTH, Bed

SURFACE = 0.45
"""Depth of the surface of a default flat bed, metres."""
Z_FLOOR = SURFACE + DEPTH
"""Default depth of the floor of the box, metres."""
STEEPEST = 3.0
"""Slopes up to this are rendered exactly; the inside of steeper walls is approximate."""
WALK, AIM = 12, 4
"""Careful steps along a ray, then secant steps to the surface."""


@jax.jit
def render(bed: Bed, camera: Camera, z_floor: float | Array = Z_FLOOR) -> Float[Array, "H W"]:
    """Depth image of a bed, metres, without noise.

    Every ray walks down from the highest point of the bed by its gap to the surface, shortened
    so that it cannot step over a wall no steeper than `STEEPEST`: the first surface it meets wins,
    as for a real camera.  A few secant steps finish.  Outside the box the bed goes on as at its
    wall.
    """
    x, y = camera.rays()
    fastest = 1.0 + STEEPEST * jnp.sqrt(x**2 + y**2)  # of the gap's change along the ray

    def gap(z):
        return z_floor - _sample(bed, x * z, y * z) - z

    def walk(_, state):
        z, left, _ = state
        step = left / fastest
        return z + step, gap(z + step), (left, step)

    def aim(_, state):
        z, left, (left_before, step) = state
        slope = (left_before - left) / jnp.where(jnp.abs(step) > 1e-7, step, 1e-7)
        step = left / jnp.clip(slope, 0.2, fastest)
        return z + step, gap(z + step), (left, step)

    z = jnp.full(camera.shape, z_floor - bed.height.max(), jnp.float32)
    left = gap(z)
    state = (z, left, (left, jnp.zeros_like(z)))
    state = jax.lax.fori_loop(0, WALK, walk, state)
    return jax.lax.fori_loop(0, AIM, aim, state)[0]


def _sample(bed, x, y):
    """Bilinear height at places (metres), clamped at the walls."""
    rows, columns = bed.height.shape
    column = jnp.clip(x / bed.cell + (columns - 1) / 2, 0.0, columns - 1.0)
    row = jnp.clip(y / bed.cell + (rows - 1) / 2, 0.0, rows - 1.0)
    left = jnp.minimum(column.astype(jnp.int32), columns - 2)
    top = jnp.minimum(row.astype(jnp.int32), rows - 2)
    right, below = column - left, row - top
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
      depth: metres, 0 for no reading.
      noise: standard deviation at 0.45 m, metres; grows with the square of the depth (stereo).
      hole_share: share of the pixels that go missing, in clumps; on level ground exactly this,
        and three times more likely where the depth jumps.
      sigma_px: the noise is white noise blurred by this many pixels, so that its correlation
        over a distance r is exp(-r² / 4 sigma_px²): 0.83 at 2 px, 0.47 at 4 px.

    Returns:
      Depth with noise, metres; missing pixels are 0.
    """
    depth = jnp.asarray(depth, jnp.float32)
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
    return jnp.where(holes | (depth <= 0), 0.0, noisy)


def smooth_noise(
    key: Key[Array, ""], shape: tuple[int, int], sigma_px: float
) -> Float[Array, "H W"]:
    """Gaussian noise of standard deviation 1, correlated over about 2 `sigma_px` pixels."""
    reach = max(1, math.ceil(3 * sigma_px))
    taps = jnp.exp(-0.5 * (jnp.arange(-reach, reach + 1) / sigma_px) ** 2)
    taps = taps / jnp.sqrt((taps**2).sum())
    white = jax.random.normal(key, (shape[0] + 2 * reach, shape[1] + 2 * reach))
    rows = [taps[k] * white[k : k + shape[0]] for k in range(2 * reach + 1)]
    white = functools.reduce(jnp.add, rows)
    columns = [taps[k] * white[:, k : k + shape[1]] for k in range(2 * reach + 1)]
    return functools.reduce(jnp.add, columns)


def to_uint16(
    depth: Float[ArrayLike, "*B H W"], depth_unit: float = 0.0001
) -> Num[Array, "*B H W"]:
    """Raw 16-bit counts of `depth_unit` metres; no reading stays 0.  8 bits: `camera.luminance`."""
    counts = jnp.round(jnp.asarray(depth, jnp.float32) / depth_unit)
    return jnp.clip(jnp.nan_to_num(counts), 0, 65535).astype(jnp.uint16)


def position_to_xy(
    camera: Camera, uv: ArrayLike | Sequence, z: float | Array = SURFACE
) -> Float[Array, "*B 2"]:
    """The place in the bed's frame under pixel (u, v) at depth z, metres."""
    uv = jnp.asarray(uv, jnp.float32)
    x = (uv[..., 0] - camera.u0) / camera.fx * z
    y = (uv[..., 1] - camera.v0) / camera.fy * z
    return jnp.stack([x, y], axis=-1)
