"""Push the bed with a hand: cut, pack, carry, slide, spring back.  Conservative by construction.

At every step of the path the hand's underside s(x, y) cuts the surface.  What stood above it
partly packs the column (mass stays, height goes) and is otherwise carried to free cells around
with weights that add up to one per source; then slopes that are too steep slide, never into the
hand nor through a wall.  Only a window around the place is touched, so the cost does not depend
on the size of the box.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp

from jshape._typing import Array, ArrayLike, Float, Key
from jshape.sim import check
from jshape.sim.bed import Bed
from jshape.sim.inputs import check_place, half_sides, read_bed, read_material, read_stroke
from jshape.sim.material import Material
from jshape.sim.tools import Agent, Stroke, heading, repetition, underside

WINDOW = 0.28
"""Side of the window that an action may change, metres."""
STEPS = 16
"""Steps along the path."""
SLIDES = 4
"""Rounds of sliding after every step."""
SETTLE = 40
"""Rounds of sliding after the hand has left."""


def apply_action(
    key: Key[Array, ""],
    bed: Bed,
    material: Material | str,
    action: Stroke | tuple[str, str | Agent] | str,
    xy: ArrayLike | Sequence[float],
    strength: float | Array = 1.0,
    yaw: float | Array = 0.0,
    spread: float | Array = 1.0,
) -> Bed:
    """The bed after one action.

    A thin wrapper that turns names into numbers; under `vmap` and `jit` pass a `Material` and
    what you like of the rest.  Over beds, keys and places:
    `jax.vmap(lambda k, b, p: apply_action(k, b, FLOUR, ("knock", "robot"), p))(keys, beds, xys)`.

    Args:
      key: for the agent's variability; consumed.
      bed: before.
      material: a material or its name.
      action: a `Stroke`, or (action name, agent or its name), or an action's name (the robot's).
      xy: place of the action in the bed's frame, metres.  A traced place outside the box changes
        nothing.
      strength: how much deeper than the agent's nominal depth.
      yaw: turn of the hand from x towards y, radians.
      spread: factor on the agent's variability; 0 repeats the nominal stroke exactly.

    Returns:
      The bed after.

    Raises:
      UnknownName: no such material, action or agent.
      BadPosition: `xy` is known (not traced) and no place in the box.
      JShapeError: something of the wrong kind or shape, cells too coarse for a finger, or a known
        number that makes no sense.
    """
    material, action = read_material(material), read_stroke(action)
    bed = read_bed(bed)
    check_place(bed, xy)
    check.number("strength", strength, above=0.0)
    check.number("yaw", yaw)
    check.number("spread", spread, at_least=0.0)
    # The name is static: without this each material would compile its own kernel.
    material = replace(material, name="")
    return _act(key, bed, material, action, jnp.asarray(xy, jnp.float32), strength, yaw, spread)


@jax.jit
def _act(key, bed, material, stroke, xy, strength, yaw, spread):
    """The kernel behind `apply_action`: cut a window out, act in it, put it back."""
    # A place at the wall may be off by float32's rounding; NaN is outside too.
    in_box = (jnp.abs(xy) <= jnp.asarray(half_sides(bed), jnp.float32) + 0.01 * bed.cell).all()
    xy = jnp.where(in_box, xy, 0.0)
    side = 2 * round(WINDOW / bed.cell / 2)
    half = side // 2
    rows, columns = bed.height.shape
    height, mass = (jnp.pad(a, half) for a in (bed.height, bed.mass))
    inside = jnp.pad(jnp.ones(bed.height.shape, jnp.float32), half)

    middle = xy / bed.cell + jnp.array([columns / 2, rows / 2], jnp.float32)
    corner = jnp.floor(middle + 0.5).astype(jnp.int32)  # padding shifts it by half a window
    corner = jnp.clip(corner, 0, jnp.array([columns, rows], jnp.int32))
    corner_x, corner_y = corner[0], corner[1]

    def window(a):
        return jax.lax.dynamic_slice(a, (corner_y, corner_x), (side, side))

    grid = jnp.arange(side, dtype=jnp.float32) + 0.5 - half
    start = corner.astype(jnp.float32) - middle
    x = ((grid + start[0]) * bed.cell)[None, :]
    y = ((grid + start[1]) * bed.cell)[:, None]
    made = repetition(key, stroke, strength, yaw, spread)
    new_height, new_mass = _press(
        window(height), window(mass), window(inside), material, made, x, y, bed.cell
    )
    height = jax.lax.dynamic_update_slice(height, new_height, (corner_y, corner_x))
    mass = jax.lax.dynamic_update_slice(mass, new_mass, (corner_y, corner_x))
    crop = (slice(half, half + rows), slice(half, half + columns))
    height = jnp.where(in_box, height[crop], bed.height)
    return replace(bed, height=height, mass=jnp.where(in_box, mass[crop], bed.mass))


def _press(height, mass, inside, material, stroke, x, y, cell):
    """Move the hand through a window.  All fields (side, side); returns height and mass."""
    cos, sin = jnp.cos(stroke.yaw), jnp.sin(stroke.yaw)
    below = jnp.abs(cos * x + sin * y) <= stroke.reach[0]
    below &= jnp.abs(cos * y - sin * x) <= stroke.reach[1]
    below = jnp.where(below, inside, 0.0)
    # A narrow hand may have no cell below it: then the bed around it has to serve.
    below = jnp.where((below > 0).any(), below, inside)
    reference = (height * below).sum() / jnp.maximum(below.sum(), 1.0)
    moments = jnp.arange(STEPS + 1, dtype=jnp.float32) / STEPS
    flat_path = stroke.path.reshape(stroke.path.shape[0], -1)
    ends = jax.vmap(lambda p: jnp.interp(moments, stroke.times, p), 1, 1)(flat_path)
    ends = ends.reshape(STEPS + 1, *stroke.path.shape[1:])
    kernels = [
        _gaussian(height.shape[0], sigma / cell)
        for sigma in (material.near, material.far, material.ahead)
    ]

    def step(carry, ends_pair):
        height, mass, under_before, untouched = carry
        ends_before, ends = ends_pair
        under = reference + underside(stroke, ends, x, y)
        free = jnp.where(jnp.isinf(under), inside, 0.0)
        above = inside * jnp.maximum(height - jnp.maximum(under, 0.0), 0.0)
        above = jnp.where(jnp.isfinite(under), above, 0.0)
        # What the hand meets by going down, as against what it meets by moving sideways.
        down = jnp.where(jnp.isfinite(under_before), under_before - under, 0.0)
        down = jnp.clip(down, 0.0, above)
        # Material packs where it cannot escape: below a wide tool, not below a thin one.
        near, far, ahead = kernels
        room_near = near @ free @ near
        confined = jnp.clip(1.0 - room_near, 0.0, 1.0)
        loose = (material.packing_max - mass / jnp.maximum(height, 1e-6)) / (
            material.packing_max - 1.0
        )
        packed = material.compressibility * confined * jnp.clip(loose, 0.0, 1.0) * down
        packed = jnp.clip(packed, 0.0, jnp.maximum(height - mass / material.packing_max, 0.0))
        height = height - packed

        packing = mass / jnp.maximum(height, 1e-6)
        sunk, swept = down - packed, above - down
        share = material.far_share
        # A mound that is high already is harder to raise further: it grows in width instead.
        lower = jnp.exp(-((jnp.maximum(height - reference, 0.0) / material.pile) ** 2))
        front = free * untouched * lower * heading(stroke, ends_before, ends, x, y)
        plans = (
            ((near, 1.0 - share), (far, share), free, sunk),
            ((ahead, 1.0), None, front, swept),
        )
        for first, second, target, lost in plans:
            lost, gained, gained_mass = _carry(first, second, target, lost, packing)
            height = height - lost + gained
            mass = mass - lost * packing + gained_mass
        height, mass = slide(height, mass, free, material.steepest * cell, SLIDES)
        return (height, mass, under, untouched * free), None

    start = reference + underside(stroke, ends[0], x, y)
    (new_height, new_mass, *_), _ = jax.lax.scan(
        step, (height, mass, start, inside), (ends[:-1], ends[1:])
    )
    new_height = (1.0 - material.elastic) * new_height + material.elastic * height
    new_mass = (1.0 - material.elastic) * new_mass + material.elastic * mass
    return slide(new_height, new_mass, inside, material.steepest * cell, SETTLE)


def _carry(first, second, target, lost, packing):
    """Spread `lost` (metres of height per cell) over the cells of `target`.

    What a source cell x' loses arrives at x with weight G(x - x') target(x) / Σ_x G(x - x')
    target(x): the weights of a source add up to one.  G is a sum of Gaussians, given as (matrix,
    share) each.

    Returns:
      What really leaves (nothing where no target is in reach), the height and the mass gained.
    """
    parts = [part for part in (first, second) if part is not None]
    room = sum(share * (g @ target @ g) for g, share in parts)
    lost = jnp.where(room > 1e-20, lost, 0.0)
    per_room = lost / jnp.maximum(room, 1e-20)
    fields = jnp.stack([per_room, per_room * packing])
    gained = target[None] * sum(share * (g @ fields @ g) for g, share in parts)
    return lost, gained[0], gained[1]


def _gaussian(side, sigma):
    """(side, side) symmetric matrix of Gaussian weights between the cells of a line, sum 1."""
    line = jnp.arange(side, dtype=jnp.float32)
    weight = jnp.exp(-0.5 * ((line[:, None] - line[None, :]) / sigma) ** 2)
    return weight / (sigma * (2.0 * jnp.pi) ** 0.5)


def slide(
    height: Float[Array, "Y X"],
    mass: Float[Array, "Y X"],
    free: Float[Array, "Y X"],
    steepest: float | Array,
    rounds: int,
) -> tuple[Float[Array, "Y X"], Float[Array, "Y X"]]:
    """Let slopes slide that are steeper than `steepest` (metres of drop per cell).

    Each pair of the eight neighbours exchanges a share of the drop in excess, the same amount
    seen from both sides, so nothing is lost; cells with `free` 0 neither give nor take.
    """
    rows, columns = height.shape
    free = jnp.pad(free, 1)
    shifts = [(i, j) for i in (0, 1, 2) for j in (0, 1, 2) if (i, j) != (1, 1)]

    def one_round(_, state):
        height, mass = state
        padded = jnp.pad(height, 1)
        density = jnp.pad(mass / jnp.maximum(height, 1e-6), 1)
        gain = jnp.zeros_like(height)
        gain_mass = jnp.zeros_like(height)
        for i, j in shifts:
            there = (slice(i, i + rows), slice(j, j + columns))
            diagonal = i != 1 and j != 1
            limit = steepest * (2**0.5 if diagonal else 1.0)
            drop = padded[there] - height
            excess = jnp.maximum(jnp.abs(drop) - limit, 0.0) * free[there] * free[1:-1, 1:-1]
            # Shares 0.16 and 0.08 keep every mode stable (checkerboard: 1 - 8 * 0.16).
            flow = jnp.minimum(
                (0.08 if diagonal else 0.16) * excess, 0.1 * jnp.maximum(padded[there], height)
            )
            gain = gain + jnp.sign(drop) * flow
            source = jnp.where(drop > 0, density[there], density[1:-1, 1:-1])
            gain_mass = gain_mass + jnp.sign(drop) * flow * source
        return height + gain, mass + gain_mass

    return jax.lax.fori_loop(0, rounds, one_round, (height, mass))


@jax.jit(static_argnames=["rounds"])
def relax(bed: Bed, material: Material, rounds: int = 200) -> Bed:
    """The bed after its too steep slopes have slid down."""
    free = jnp.ones_like(bed.height)
    height, mass = slide(bed.height, bed.mass, free, material.steepest * bed.cell, rounds)
    return replace(bed, height=height, mass=mass)
