"""Slopes that are too steep slide down, and nothing is lost."""

from dataclasses import replace

import jax
import jax.numpy as jnp

from jshape._typing import Array, Float
from jshape.sim.bed import Bed
from jshape.sim.material import Material


def slide(
    height: Float[Array, "Y X"],
    mass: Float[Array, "Y X"],
    free: Float[Array, "Y X"],
    steepest: float | Array,
    rounds: int,
    base: Float[Array, "Y X"] | None = None,
) -> tuple[Float[Array, "Y X"], Float[Array, "Y X"]]:
    """Let slopes slide that are steeper than `steepest` (metres of drop per cell).

    Each pair of the eight neighbours exchanges a share of the drop in excess, the same amount
    seen from both sides, so nothing is lost; cells with `free` 0 neither give nor take, and what
    lies below `base` stays.
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
        loose = None if base is None else jnp.pad(jnp.maximum(height - base, 0.0), 1)
        for i, j in shifts:
            there = (slice(i, i + rows), slice(j, j + columns))
            diagonal = i != 1 and j != 1
            limit = steepest * (2**0.5 if diagonal else 1.0)
            drop = padded[there] - height
            excess = jnp.maximum(jnp.abs(drop) - limit, 0.0) * free[there] * free[1:-1, 1:-1]
            # Shares 0.16 and 0.08 keep every mode stable (checkerboard: 1 - 8 * 0.16).
            if loose is None:
                most = jnp.maximum(padded[there], height)
            else:
                most = jnp.where(drop > 0, loose[there], loose[1:-1, 1:-1])
            flow = jnp.minimum((0.08 if diagonal else 0.16) * excess, 0.1 * most)
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
