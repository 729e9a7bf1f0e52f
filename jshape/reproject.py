"""What one depth camera would have seen of what another one saw, wherever the two stand.

The other may be a pinhole of any lens and pose; so may the one imitated, or it looks from straight
above with parallel rays: then the result is a height map.  Arrays are `[v, u]`, depths in metres.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jshape._typing import Array, Float
from jshape.camera import Camera

HALVINGS = 6
"""Halvings of the range of depths before Newton's steps: 64 parts of 200 mm are 3 mm each."""
STEPS = 2
"""Newton's steps: they leave 1 um on beds of 20 mm relief, seen from up to 45 degrees."""
STRIDE = 1e-3
"""Metres along which the image of a ray is taken to be straight."""
LEAST_SLOPE = 0.05
"""Least change of the gap to the surface per metre: less is a surface seen from its edge."""
STEEP = 8.0
"""Four pixels whose depths differ by more than so many times a pixel's width at that depth are no
surface but its edge: at 7 degrees against the surface no depth camera measures any more."""
OFF = 2e-3
"""Metres that a point found may be off the surface: more is an edge."""


@partial(jax.jit, static_argnames=("halvings", "steps"))
def reproject(
    depth: Float[Any, "H W"],
    source: Camera,
    target: Camera,
    span: Float[Any, "2"],
    *,
    halvings: int = HALVINGS,
    steps: int = STEPS,
) -> Float[Array, "h w"]:
    """The depth image of `target` from one that `source` took.

    Along a ray of the target a point is in front of what the source saw until it reaches the
    surface, or the shadow of what hides it; beyond that it stays behind, since a bed has no
    overhangs.  So halving finds the one change, and Newton's method its depth.  Where the depths
    around it differ by more than a surface's would, it is the edge of what hides the ray's end.

    Args:
      depth: metres along the source's axis, NaN: no reading.
      source: that took it; without a pose its own frame is the common one.
      target: to imitate; likewise.
      span: least and greatest depth of the target that there can be, metres.
      halvings: of that span, before Newton's steps.
      steps: Newton's.

    Returns:
      Metres along the target's axis, NaN where the source did not see.
    """
    depth = jnp.asarray(depth, jnp.float32)
    flat, (height, width) = depth.reshape(-1), depth.shape
    base, ray = target.lines(_between(source, target))

    def seen_at(t):
        """Pixel (u, v) of the source, and depth from it, of the points at depths t."""
        px, py, pz = (b + t * r for b, r in zip(base, ray, strict=True))
        u, v = source.pixel(px, py, pz)
        return u, v, pz

    def behind(t):
        u, v, z = seen_at(t)
        column = jnp.clip(jnp.round(u), 0, width - 1).astype(jnp.int32)
        row = jnp.clip(jnp.round(v), 0, height - 1).astype(jnp.int32)
        return flat[row * width + column] <= z  # NaN is not

    def surface(t):
        """The gap to the surface, its change with t, and the depths of the four pixels around."""
        u, v, z = seen_at(t)
        left = jnp.clip(jnp.floor(u), 0, width - 2)
        top = jnp.clip(jnp.floor(v), 0, height - 2)
        at = top.astype(jnp.int32) * width + left.astype(jnp.int32)
        a, b, c, d = (flat[at + off] for off in (0, 1, width, width + 1))
        right, down = jnp.clip(u - left, 0.0, 1.0), jnp.clip(v - top, 0.0, 1.0)
        upper, lower = a + right * (b - a), c + right * (d - c)
        here = upper + down * (lower - upper)
        by_u = (b - a) + down * ((d - c) - (b - a))
        by_v = (c - a) + right * ((d - b) - (c - a))
        further_u, further_v, further_z = seen_at(t + STRIDE)
        change = by_u * (further_u - u) + by_v * (further_v - v) - (further_z - z)
        return here - z, change / STRIDE, (a, b, c, d)

    def halve(_, ends):
        near, far = ends
        middle = 0.5 * (near + far)
        through = behind(middle)
        return jnp.where(through, near, middle), jnp.where(through, middle, far)

    span = jnp.asarray(span, jnp.float32)
    ends = jnp.full(target.shape, span[0]), jnp.full(target.shape, span[1])
    near, far = lax.fori_loop(jnp.int32(0), jnp.int32(halvings), halve, ends)
    start, part = 0.5 * (near + far), (span[1] - span[0]) / 2.0**halvings

    def closer(_, t):
        gap, change, _ = surface(t)
        step = gap / jnp.where(-change > LEAST_SLOPE, change, -jnp.inf)
        return jnp.clip(t - step, start - 1.5 * part, start + 1.5 * part)

    t = lax.fori_loop(jnp.int32(0), jnp.int32(steps), closer, start)
    u, v, z = seen_at(t)
    gap, _, around = surface(t)
    least = jnp.minimum(jnp.minimum(*around[:2]), jnp.minimum(*around[2:]))
    most = jnp.maximum(jnp.maximum(*around[:2]), jnp.maximum(*around[2:]))
    inside = (jnp.abs(u - (width - 1) / 2) <= width / 2) & (z > 0)
    inside = inside & (jnp.abs(v - (height - 1) / 2) <= height / 2)
    seen = inside & (most - least <= STEEP / source.scale(z)[0]) & (jnp.abs(gap) <= OFF)
    return jnp.where(seen, t, jnp.nan)


def between(source: Camera, target: Camera) -> Float[np.ndarray, "4 4"]:
    """The transform from the target's frame to the source's, metres (host)."""
    one, other = (np.eye(4) if c.pose is None else np.array(c.pose) for c in (source, target))
    return np.linalg.inv(one) @ other


def _between(source: Camera, target: Camera) -> Float[Array, "3 4"]:
    one, other = (
        jnp.eye(4, dtype=jnp.float32) if c.pose is None else jnp.asarray(c.pose, jnp.float32)
        for c in (source, target)
    )
    back = one[:3, :3].T  # a rotation's inverse
    turn = jnp.matmul(back, other[:3, :3], precision="highest")
    move = jnp.matmul(back, other[:3, 3] - one[:3, 3], precision="highest")
    return jnp.concatenate([turn, move[:, None]], 1)
