"""What `apply_action` is given, turned into what its kernel takes, or refused."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from jshape.errors import BadPosition, JShapeError, UnknownName
from jshape.sim import check
from jshape.sim.bed import Bed
from jshape.sim.hands import Agent, stroke
from jshape.sim.material import MATERIALS, Material
from jshape.sim.tools import Stroke

COARSEST = 0.01
"""Largest cell that an action accepts, metres: the thinnest finger has a radius of about 9 mm."""


def read_material(material: Any) -> Material:
    """The material that was meant."""
    if isinstance(material, Material):
        return material
    if not isinstance(material, str):
        raise JShapeError(
            f"material is {check.brief(material)}; give a Material or one of {', '.join(MATERIALS)}"
        )
    if material not in MATERIALS:
        raise UnknownName("material", material, MATERIALS)
    return MATERIALS[material]


def read_stroke(action: Any) -> Stroke:
    """The stroke that was meant."""
    if isinstance(action, Stroke):
        return action
    names = (action, "robot") if isinstance(action, str) else action
    pair = isinstance(names, tuple | list) and len(names) == 2
    if not (pair and isinstance(names[0], str) and isinstance(names[1], str | Agent)):
        raise JShapeError(
            f"action is {check.brief(action)}; give a Stroke, an action's name or (action, agent)"
        )
    return stroke(*names)


def read_bed(bed: Any) -> Bed:
    """The bed in float32, refused if it is no bed or its cells are too coarse for a finger."""
    if not isinstance(bed, Bed):
        raise JShapeError(f"bed is {check.brief(bed)}; give a Bed, such as flat_bed()")
    shape, mass_shape = np.shape(bed.height), np.shape(bed.mass)
    if len(shape) != 2:
        raise JShapeError(f"bed.height has shape {shape}; use jax.vmap for batches")
    if shape != mass_shape:
        raise JShapeError(f"bed.height has shape {shape} but bed.mass {mass_shape}")
    check.number("bed.cell", bed.cell, above=0.0)
    if bed.cell > COARSEST:
        raise JShapeError(f"bed.cell is {bed.cell} m; it must be at most {COARSEST} m")
    arrays = {name: getattr(bed, name) for name in ("height", "mass", "stock")}
    return replace(bed, **{name: jnp.asarray(a, jnp.float32) for name, a in arrays.items()})


def check_place(bed: Bed, xy: Any) -> None:
    """Refuse a place outside the box when its numbers are known (not traced)."""
    half = half_sides(bed)
    try:
        place = check.known(xy)
    except (TypeError, ValueError):
        raise BadPosition(f"xy is {check.brief(xy)}; it must be two numbers, metres") from None
    if place is None:
        return
    if place.shape != (2,) or not (np.abs(place) <= half).all():
        raise BadPosition(
            f"xy is {check.brief(place.tolist())}; it must be two numbers within ±{half[0]:.3f} "
            f"and ±{half[1]:.3f} m of the middle of the box"
        )


def half_sides(bed: Bed) -> np.ndarray:
    """Half sides (x, y) of the box, metres."""
    rows, columns = bed.height.shape
    return np.array([columns, rows]) * bed.cell / 2
