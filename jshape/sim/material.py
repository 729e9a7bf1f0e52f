"""What the bed is made of: numbers that say how it yields, piles up, packs and springs back.

The constants of flour and kinetic sand are fitted to material-point samples (docs/simulator.md
says how close they get); those of dough are set by hand, since no such sample of dough exists.
"""

import math
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from jshape._typing import Array, Float

STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Material:
    """A soft plastic material.  A pytree: the name is static, every number is traced."""

    name: str = field(metadata=STATIC)
    """What a person calls it."""
    repose: float | Array
    """Angle of repose of the loose material, radians."""
    cohesion: float | Array
    """Slope (rise over run) that a wall keeps on top of the angle of repose, because it sticks."""
    compressibility: float | Array
    """Share of what a wide descending tool displaces that packs down below it, [0, 1]."""
    packing_max: float | Array
    """Densest packing relative to the loose bed, > 1; packing stops there."""
    elastic: float | Array
    """Share of the whole displacement that springs back when the tool leaves, in [0, 1)."""
    ahead: float | Array
    """How far a finger that moves sideways pushes material ahead: standard deviation, metres."""
    pile: float | Array
    """Height of a mound at which it is e times harder to raise than to widen, metres."""
    near: float | Array
    """How far a descending tool piles material up beside it: standard deviation, metres."""
    far: float | Array
    """How far a descending tool heaves the bed around it: standard deviation, metres."""
    far_share: float | Array
    """Share of what a descending tool moves that heaves the bed instead of piling up, [0, 1]."""

    bulk: float | Array = 1.16
    """Volume of poured material over that of the loose bed, at least 1."""

    @property
    def steepest(self) -> Float[Array, ""]:
        """Steepest slope (rise over run) that stands: tan(repose) + cohesion."""
        return jnp.tan(self.repose) + self.cohesion


FLOUR = Material(
    name="flour",
    repose=math.radians(40.0),
    cohesion=4.1,
    compressibility=1.0,
    packing_max=1.6,
    elastic=0.016,
    ahead=0.0091,
    pile=0.0095,
    near=0.0079,
    far=0.031,
    far_share=0.69,
)
"""Wheat flour: packs down a lot and stands nearly upright."""

KINETIC_SAND = Material(
    name="sand",
    repose=math.radians(35.0),
    cohesion=2.2,
    compressibility=0.62,
    packing_max=1.3,
    elastic=0.0,
    ahead=0.0087,
    pile=0.0136,
    near=0.0095,
    far=0.045,
    far_share=0.62,
    bulk=1.1,
)
"""Kinetic sand: packs less than flour, piles up more around the hand."""

DOUGH = Material(
    name="dough",
    repose=math.radians(30.0),
    cohesion=4.0,
    compressibility=0.0,
    packing_max=1.01,
    elastic=0.25,
    ahead=0.011,
    pile=0.012,
    near=0.01,
    far=0.035,
    far_share=0.6,
    bulk=1.05,
)
"""Bread dough: keeps its volume, stands steep, springs back."""

MATERIALS = {material.name: material for material in (FLOUR, KINETIC_SAND, DOUGH)}
"""The materials by name."""
