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

from jshape._typing import Array, ArrayLike, Key
from jshape.sim import check
from jshape.sim.bed import Bed
from jshape.sim.hands import Agent
from jshape.sim.inputs import check_place, half_sides, read_bed, read_material, read_stroke
from jshape.sim.material import Material
from jshape.sim.slide import slide
from jshape.sim.tools import Stroke, heading, lengthened, repetition, underside

WINDOW = 0.28
"""Side of the window that an action may change, metres."""
STEPS = 16
"""Steps along the path."""
SLIDES = 4
"""Rounds of sliding after every step."""
SETTLE = 40
"""Rounds of sliding after the hand has left."""
LONG_WINDOW = 0.36
"""The window of a stroke that moves material: 0.16 m of way, the hand and what lies before it."""
HEAPS = 100
"""Rounds in which what was heaped up slides to its angle of repose."""


def apply_action(
    key: Key[Array, ""],
    bed: Bed,
    material: Material | str,
    action: Stroke | tuple[str, str | Agent] | str,
    xy: ArrayLike | Sequence[float],
    strength: float | Array = 1.0,
    yaw: float | Array = 0.0,
    spread: float | Array = 1.0,
    length: float | Array | None = None,
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
      strength: how much deeper than the agent's nominal depth; of a `pour` how much more.
      yaw: turn of the hand from x towards y, radians.
      spread: factor on the agent's variability; 0 repeats the nominal stroke exactly.
      length: how many times as long as the agent's own the hand's way is; None for its own.

    Returns:
      The bed after; what was taken out of it or brought is counted in its `stock`.

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
    if length is not None:
        check.number("length", length, above=0.0)
        action = lengthened(action, length)
    # The name is static: without this each material would compile its own kernel.
    material = replace(material, name="")
    return _act(key, bed, material, action, jnp.asarray(xy, jnp.float32), strength, yaw, spread)


@jax.jit
def _act(key, bed, material, stroke, xy, strength, yaw, spread):
    """The kernel behind `apply_action`: cut a window out, act in it, put it back."""
    # A place at the wall may be off by float32's rounding; NaN is outside too.
    in_box = (jnp.abs(xy) <= jnp.asarray(half_sides(bed), jnp.float32) + 0.01 * bed.cell).all()
    xy = jnp.where(in_box, xy, 0.0)
    side = 2 * round((WINDOW if stroke.load is None else LONG_WINDOW) / bed.cell / 2)
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
    new_height, new_mass, taken = _press(
        window(height), window(mass), window(inside), material, made, x, y, bed.cell
    )
    height = jax.lax.dynamic_update_slice(height, new_height, (corner_y, corner_x))
    mass = jax.lax.dynamic_update_slice(mass, new_mass, (corner_y, corner_x))
    crop = (slice(half, half + rows), slice(half, half + columns))
    height = jnp.where(in_box, height[crop], bed.height)
    mass = jnp.where(in_box, mass[crop], bed.mass)
    stock = bed.stock + jnp.where(in_box, taken, 0.0) * bed.cell**2
    return replace(bed, height=height, mass=mass, stock=stock)


def _press(height, mass, inside, material, stroke, x, y, cell):
    """Move the hand through a window.  All fields (side, side).

    Returns height, mass, and what left the bed, as the sum of its loose height over the cells.
    """
    load = stroke.load
    cos, sin = jnp.cos(stroke.yaw), jnp.sin(stroke.yaw)
    from_x, from_y = (x, y) if load is None else _from_reach(stroke, x, y)
    below = jnp.abs(cos * from_x + sin * from_y) <= stroke.reach[0]
    below &= jnp.abs(cos * from_y - sin * from_x) <= stroke.reach[1]
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
        height, mass, under_before, untouched, base, taken = carry
        ends_before, ends = ends_pair
        under = reference + underside(stroke, ends, x, y)
        if load is not None:
            under = jnp.where(load.gives > 0, jnp.inf, under)
        free = jnp.where(jnp.isinf(under), inside, 0.0)
        above = inside * jnp.maximum(height - jnp.maximum(under, 0.0), 0.0)
        above = jnp.where(jnp.isfinite(under), above, 0.0)
        # What the hand meets by going down, as against what it meets by moving sideways.
        down = jnp.where(jnp.isfinite(under_before), under_before - under, 0.0)
        down = jnp.clip(down, 0.0, above)
        if load is not None:
            # A nose that moves on comes lower over every place: its own way down counts.
            way_down = jnp.maximum((ends_before - ends)[..., 2].max(), 0.0)
            down = jnp.minimum(down, way_down)
            down = down + load.under * (above - down)
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
        if load is not None:
            held = load.takes * (sunk + swept)
            fallen = _fall(stroke, material, height, ends, x, y, inside)
            sunk, swept = (1.0 - load.takes) * sunk, (1.0 - load.takes) * swept
            base = jnp.minimum(base, height - held - sunk - swept)
            height = height - held + material.bulk * fallen
            mass = mass - held * packing + fallen
            taken = taken + (held * packing - fallen).sum()
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
        steepest = material.steepest if load is None else jnp.tan(material.repose)
        height, mass = slide(height, mass, free, steepest * cell, SLIDES, base)
        return (height, mass, under, untouched * free, base, taken), None

    start = reference + underside(stroke, ends[0], x, y)
    base = None if load is None else height
    (new_height, new_mass, _, _, base, taken), _ = jax.lax.scan(
        step, (height, mass, start, inside, base, jnp.float32(0.0)), (ends[:-1], ends[1:])
    )
    if load is not None:
        given = slide(new_height, new_mass, inside, material.steepest * cell, SETTLE)
        return *slide(*given, inside, jnp.tan(material.repose) * cell, HEAPS, base), taken
    new_height = (1.0 - material.elastic) * new_height + material.elastic * height
    new_mass = (1.0 - material.elastic) * new_mass + material.elastic * mass
    return *slide(new_height, new_mass, inside, material.steepest * cell, SETTLE), taken


def _from_reach(stroke, x, y):
    """Coordinates from the middle of `stroke.reach`."""
    used = (stroke.radius > 0).astype(jnp.float32)[:, None, None]
    start = (stroke.path[0, ..., :2] * used).sum((0, 1)) / (2.0 * used.sum())
    middle = stroke.load.begins * start
    return x - middle[0], y - middle[1]


def _fall(stroke, material, height, ends, x, y, inside):
    """What falls from between the fingers' `ends` in one step, loose height (side, side), metres.

    It fills the bed up to a paraboloid below them, c - k r², whatever the bed's shape; k is that of
    a whole handful V on a level bed that has the angle of repose at its foot, R = (4 V / (pi tan
    repose))^(1/3), or is as wide as the hand.
    """
    volume = jnp.maximum(material.bulk * stroke.load.gives, 1e-12)
    foot = jnp.cbrt(4.0 * volume / (jnp.pi * jnp.tan(material.repose)))
    foot = jnp.maximum(foot, stroke.radius.max())
    used = (stroke.radius > 0).astype(jnp.float32)
    metre = replace(stroke, radius=used, rise=used, flat=0.0 * used)
    off2 = underside(metre, ends.at[..., 2].set(0.0), x, y)
    lowest = jnp.where(inside > 0, height + 2.0 * volume / (jnp.pi * foot**4) * off2, 1e3)
    wanted = volume / (x[0, 1] - x[0, 0]) ** 2 / STEPS

    def halve(_, bounds):
        low, high = bounds
        level = (low + high) / 2
        less = jnp.maximum(level - lowest, 0.0).sum() < wanted
        return jnp.where(less, level, low), jnp.where(less, high, level)

    bounds = lowest.min(), lowest.min() + wanted
    fill = jnp.maximum(jax.lax.fori_loop(0, 30, halve, bounds)[1] - lowest, 0.0)
    return fill * (stroke.load.gives / volume) * (wanted / jnp.maximum(fill.sum(), 1e-9))


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
