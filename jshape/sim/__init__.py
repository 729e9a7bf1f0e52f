"""A simulated bed of soft material, hands that press it, and a depth camera that looks at it.

`apply_action(key, bed, FLOUR, ("knock", "robot"), xy)` gives the bed after, and
`render(bed, PAPER_BOX)` its depth image.  Pure JAX: jitted, batched with `jax.vmap`; no disk, no
clock.
"""

from jshape.sim.act import apply_action
from jshape.sim.bed import (
    CELL,
    DEPTH,
    SIZE,
    Bed,
    curved_bed,
    flat_bed,
    irregular_bed,
    loose_bed,
    mass,
    volume,
)
from jshape.sim.hands import ACTIONS, AGENTS, MOVING, Agent, actions_of, stroke
from jshape.sim.inputs import read_material
from jshape.sim.material import DOUGH, FLOUR, KINETIC_SAND, MATERIALS, Material
from jshape.sim.slide import relax
from jshape.sim.tools import Load, Stroke, cut, lengthened, path_mm, scaled, way
from jshape.sim.view import SURFACE, Z_FLOOR, position_to_xy, render, sensor, to_uint16

__all__ = [
    "ACTIONS",
    "AGENTS",
    "CELL",
    "DEPTH",
    "DOUGH",
    "FLOUR",
    "KINETIC_SAND",
    "MATERIALS",
    "MOVING",
    "SIZE",
    "SURFACE",
    "Z_FLOOR",
    "Agent",
    "Bed",
    "Load",
    "Material",
    "Stroke",
    "actions_of",
    "apply_action",
    "curved_bed",
    "cut",
    "flat_bed",
    "irregular_bed",
    "lengthened",
    "loose_bed",
    "mass",
    "path_mm",
    "position_to_xy",
    "read_material",
    "relax",
    "render",
    "scaled",
    "sensor",
    "stroke",
    "to_uint16",
    "volume",
    "way",
]
