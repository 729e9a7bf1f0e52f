"""What acts on the bed: rigid fingers, the path that they take and what they do with material.

A finger is a segment with a rounded underside.  All actions share one shape of arrays (`T`
waypoints of `F` fingers, unused ones of radius 0), so one compiled kernel serves all that press
and another all that move material.  Metres; x along image columns, y along image rows, z above the
*reference height*: the mean of the bed below the hand.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from jshape._typing import Array, Float, Key

NUM_FINGERS = 5
NUM_WAYPOINTS = 3
FORWARD = 2.0
"""Power of the forward half of the cosine: how narrowly a finger pushes ahead."""
SHOVEL = 6.0
"""The same for a hand that moves material, whose whole width pushes."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Load:
    """What a hand that moves material does with it.  Strokes without one press only."""

    under: float | Array = 0.0
    """Share of what the hand meets sideways that it presses down instead of pushing ahead."""
    takes: float | Array = 0.0
    """Share of what would be displaced that leaves the bed with the hand."""
    gives: float | Array = 0.0
    """Loose volume that falls along the path, m³; a hand that gives any touches nothing."""
    begins: float | Array = 0.0
    """Where `reach` has its middle: 0 at the place, 1 where the path begins."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Stroke:
    """One action of one agent.  A pytree of numbers only: no name, so nothing recompiles.

    Several, stacked leaf by leaf, are a batch for `vmap`: those that press, or those with a load.
    """

    path: Float[Array, "*B T F 2 3"]
    """Ends of every finger's lowest line at every waypoint, metres from place and reference."""
    times: Float[Array, "*B T"]
    """When the waypoints are reached, from 0 to 1."""
    radius: Float[Array, "*B F"]
    """Half width of a finger, metres; 0 for an unused one."""
    rise: Float[Array, "*B F"]
    """Height of the underside's edge above its lowest line, metres."""
    flat: Float[Array, "*B F"]
    """Shape of the underside: 0 a parabola, 1 flat in the middle with a round edge."""
    reach: Float[Array, "*B 2"]
    """Half sides (x, y) of the rectangle below the hand whose mean height is the reference, m."""
    yaw: float | Array
    """How far the hand is turned from x towards y, radians."""
    spread_xy: float | Array
    """A repetition is off by at most this along x and along y, uniformly, metres."""
    spread_yaw: float | Array
    """A repetition is turned by at most this, uniformly, radians."""
    spread_depth: float | Array
    """Standard deviation of the depth over repetitions, as a share of the depth."""
    spread_size: float | Array
    """Standard deviation of the hand's size over repetitions, as a share."""
    spread_finger: float | Array
    """Standard deviation of each finger on its own over repetitions, metres, along x, y and z."""
    load: Load | None = None
    """None: it presses.  Otherwise what was heaped up slides to the angle of repose."""


def scaled(stroke: Stroke, size: float | Array, depth: float | Array) -> Stroke:
    """The same stroke by a larger hand (x, y, radius) that goes deeper (z below the reference).

    One that gives material gives `depth` times as much.
    """
    z = stroke.path[..., 2]
    z = jnp.where(z < 0, z * depth, z)
    xy = stroke.path[..., :2] * size
    path = jnp.concatenate([xy, z[..., None]], axis=-1)
    load = stroke.load and replace(stroke.load, gives=stroke.load.gives * depth)
    return replace(
        stroke, path=path, radius=stroke.radius * size, reach=stroke.reach * size, load=load
    )


def lengthened(stroke: Stroke, length: float | Array) -> Stroke:
    """The same stroke with a way `length` times as long about the middle of its two ends."""
    xy = stroke.path[..., :2]
    middle = (xy[:1] + xy[-1:]) / 2
    return replace(stroke, path=stroke.path.at[..., :2].set(middle + length * (xy - middle)))


@jax.jit
def way(stroke: Stroke) -> Float[Array, "T 2"]:
    """(x, y) of the hand's middle at the waypoints, metres from the place."""
    used = (stroke.radius > 0).astype(jnp.float32)
    middles = stroke.path[..., :2].mean(2) * used[None, :, None]
    return middles.sum(1) / used.sum()


@jax.jit
def cut(stroke: Stroke, share: float | Array) -> Stroke:
    """The same stroke, ended where the hand has gone this share of its way along the bed.

    Of 0 it only goes down; one that goes nowhere along the bed stays whole.
    """
    steps = jnp.linalg.norm(jnp.diff(way(stroke), axis=0), axis=-1)
    gone = jnp.cumsum(steps) - steps
    left = share * steps.sum() - gone
    part = jnp.where(steps > 0, left / jnp.maximum(steps, 1e-9), jnp.sign(left) + 1.0)
    part = jnp.clip(part, 0.0, 1.0)
    end = stroke.times[0] + (part * jnp.diff(stroke.times)).sum()
    times = jnp.minimum(stroke.times, end)
    flat = stroke.path.reshape(len(stroke.times), -1)
    path = jax.vmap(lambda p: jnp.interp(times, stroke.times, p), 1, 1)(flat)
    return replace(stroke, path=path.reshape(stroke.path.shape), times=times)


def path_mm(stroke: Stroke) -> float:
    """Length of the way along which a stroke drags, mm; 0 of one that presses, takes or gives."""
    if stroke.load is None or stroke.load.takes > 0 or stroke.load.gives > 0:
        return 0.0
    gone = np.asarray(way(stroke))
    return round(1e3 * float(np.hypot(*(gone[-1] - gone[0]))), 3)


def repetition(
    key: Key[Array, ""],
    stroke: Stroke,
    strength: float | Array = 1.0,
    yaw: float | Array = 0.0,
    spread: float | Array = 1.0,
) -> Stroke:
    """One repetition: the nominal stroke moved, turned, scaled and bent at random.

    Args:
      key: consumed.
      stroke: the nominal stroke.
      strength: how much deeper than nominal.
      yaw: turn of the hand from x towards y, radians.
      spread: factor on all of the stroke's spreads; 0 gives the nominal stroke.

    Returns:
      A stroke whose path is final.
    """
    place, turn, deep, size, bend = jax.random.split(key, 5)
    size = 1.0 + spread * stroke.spread_size * jax.random.normal(size, (), jnp.float32)
    deep = 1.0 + spread * stroke.spread_depth * jax.random.truncated_normal(
        deep, -2.5, 2.5, (), jnp.float32
    )
    made = scaled(stroke, size, strength * deep)
    angle = yaw + spread * stroke.spread_yaw * jax.random.uniform(turn, (), jnp.float32, -1.0)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    x, y, z = made.path[..., 0], made.path[..., 1], made.path[..., 2]
    path = jnp.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)
    shift = spread * stroke.spread_xy * jax.random.uniform(place, (2,), jnp.float32, -1.0)
    path = path.at[..., :2].add(shift)
    bend = spread * stroke.spread_finger * jax.random.normal(bend, (NUM_FINGERS, 1, 3), jnp.float32)
    return replace(made, path=path + bend[None], yaw=angle)


def underside(
    stroke: Stroke,
    ends: Float[Array, "F 2 3"],
    x: Float[Array, "1 X"],
    y: Float[Array, "Y 1"],
) -> Float[Array, "Y X"]:
    """Lowest point of the hand above every place, metres; infinite where there is no finger.

    Args:
      stroke: gives the fingers' shapes.
      ends: the fingers' segments at this moment, metres.
      x: of the places, metres, in the frame of `ends`.
      y: likewise.
    """
    x, y = x[None], y[None]
    start, stop = ends[:, 0, :, None, None], ends[:, 1, :, None, None]
    along = stop - start
    length2 = along[:, 0] ** 2 + along[:, 1] ** 2
    dx, dy = x - start[:, 0], y - start[:, 1]
    share = jnp.clip((dx * along[:, 0] + dy * along[:, 1]) / (length2 + 1e-9), 0.0, 1.0)
    off2 = (dx - share * along[:, 0]) ** 2 + (dy - share * along[:, 1]) ** 2
    radius, rise, flat = (a[:, None, None] for a in (stroke.radius, stroke.rise, stroke.flat))
    q = off2 / (radius**2 + 1e-12)
    lowest = start[:, 2] + share * along[:, 2]
    under = lowest + rise * ((1.0 - flat) * q + flat * q**3)
    return jnp.where(q < 1.0, under, jnp.inf).min(0)


def _nearest(ends, x, y):
    """The points (F, 2, Y, X) of the fingers' segments that are nearest to every place."""
    start, along = (a[..., None, None] for a in (ends[:, 0, :2], (ends[:, 1] - ends[:, 0])[:, :2]))
    dot = (x - start[:, 0]) * along[:, 0] + (y - start[:, 1]) * along[:, 1]
    share = jnp.clip(dot / ((along**2).sum(1) + 1e-9), 0.0, 1.0)
    return start + share[:, None] * along


def heading(
    stroke: Stroke,
    before: Float[Array, "F 2 3"],
    ends: Float[Array, "F 2 3"],
    x: Float[Array, "1 X"],
    y: Float[Array, "Y 1"],
) -> Float[Array, "Y X"]:
    """How much every place lies ahead of the finger that is nearest to it, in [0, 1].

    1 straight ahead of a finger that moves sideways, 0 behind it, and 1 everywhere around a
    finger that goes straight down.
    """
    middle, power = ends.mean(1)[:, :2, None, None], FORWARD
    if stroke.load is not None:
        middle, power = _nearest(ends, x[None], y[None]), SHOVEL
    motion = (ends - before).mean(1)[:, :2]
    speed = jnp.linalg.norm(motion, axis=-1)
    toward = (motion / (speed[:, None] + 1e-9))[:, :, None, None]
    dx, dy = x[None] - middle[:, 0], y[None] - middle[:, 1]
    far2 = dx**2 + dy**2
    cosine = (dx * toward[:, 0] + dy * toward[:, 1]) / jnp.sqrt(far2 + 1e-8)
    moves = (speed > 1e-6)[:, None, None]
    ahead = jnp.where(moves, (0.5 + 0.5 * cosine) ** power, 1.0)
    used = (stroke.radius > 0)[:, None, None]
    # Softly the nearest finger: 0.012 m is about the distance between two fingers.
    weight = jnp.where(used, jnp.exp(-0.5 * far2 / 0.012**2) + 1e-12, 0.0)
    return (weight * ahead).sum(0) / weight.sum(0)
