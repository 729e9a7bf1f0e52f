"""Mold soft plastic material by looking at it: depth images in, a plan of actions out."""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jshape.actions import PAPER_ACTIONS, Action, ActionSet, grid
    from jshape.camera import D435_BAZAR, D435_NOMINAL, PAPER_BOX, Camera
    from jshape.data.looks import heightmap
    from jshape.data.pairs import Pairs
    from jshape.errors import JShapeError
    from jshape.height_map import HeightMap
    from jshape.io.banks import list_banks, load_bank, save_bank
    from jshape.io.datasets import load_pairs, save_pairs
    from jshape.learn.online import adapt
    from jshape.learn.validation import fit
    from jshape.metric import distance, r_matrix, ray_lengths, to_mm, unweigh, weigh
    from jshape.models.bank import Bank
    from jshape.planning.api import plan, plan_depth, rollout
    from jshape.planning.limit import Limit, limit
    from jshape.planning.many import plan_batch
    from jshape.planning.options import (
        PAPER,
        Constraints,
        SearchBudget,
        SearchSpace,
        StopCriteria,
        options,
    )
    from jshape.planning.plan import Plan
    from jshape.planning.search.base import Status

__version__ = "0.1.0"

__all__ = [
    "D435_BAZAR",
    "D435_NOMINAL",
    "PAPER",
    "PAPER_ACTIONS",
    "PAPER_BOX",
    "Action",
    "ActionSet",
    "Bank",
    "Camera",
    "Constraints",
    "HeightMap",
    "JShapeError",
    "Limit",
    "Pairs",
    "Plan",
    "SearchBudget",
    "SearchSpace",
    "Status",
    "StopCriteria",
    "adapt",
    "distance",
    "fit",
    "grid",
    "heightmap",
    "limit",
    "list_banks",
    "load_bank",
    "load_pairs",
    "options",
    "plan",
    "plan_batch",
    "plan_depth",
    "r_matrix",
    "ray_lengths",
    "rollout",
    "save_bank",
    "save_pairs",
    "to_mm",
    "unweigh",
    "weigh",
]

_HOMES = {
    "jshape.actions": ("PAPER_ACTIONS", "Action", "ActionSet", "grid"),
    "jshape.camera": ("D435_BAZAR", "D435_NOMINAL", "PAPER_BOX", "Camera"),
    "jshape.data.looks": ("heightmap",),
    "jshape.data.pairs": ("Pairs",),
    "jshape.errors": ("JShapeError",),
    "jshape.height_map": ("HeightMap",),
    "jshape.learn.online": ("adapt",),
    "jshape.learn.validation": ("fit",),
    "jshape.metric": ("distance", "r_matrix", "ray_lengths", "to_mm", "unweigh", "weigh"),
    "jshape.planning.search.base": ("Status",),
    "jshape.planning.api": ("plan", "plan_depth", "rollout"),
    "jshape.planning.many": ("plan_batch",),
    "jshape.planning.limit": ("Limit", "limit"),
    "jshape.planning.options": (
        "PAPER",
        "Constraints",
        "SearchBudget",
        "SearchSpace",
        "StopCriteria",
        "options",
    ),
    "jshape.planning.plan": ("Plan",),
    "jshape.models.bank": ("Bank",),
    "jshape.io.banks": ("list_banks", "load_bank", "save_bank"),
    "jshape.io.datasets": ("load_pairs", "save_pairs"),
}
"""Where each name is.  They are loaded when they are asked for: JAX takes a second, and neither
`jshape --help` nor a misspelt command needs it."""
_HOME = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
    elif not name.startswith("_") and find_spec(f"jshape.{name}") is not None:
        return import_module(f"jshape.{name}")  # which sets the attribute
    else:
        raise AttributeError(f"module 'jshape' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, *(name for name in globals() if name.startswith("__"))])
